"""The published search written straight from its paper, in C++ and in numpy."""
