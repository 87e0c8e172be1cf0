"""Pages for people: one look, figures in it, everything in one file that opens offline."""
