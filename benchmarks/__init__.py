"""Measures the method beside baselines, in one run on one machine: `make bench`."""
