"""Studies: a file, its question, and its answer; sweeps of them."""
