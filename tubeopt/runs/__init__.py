"""Studies: a file, the question that it asks, and its answer; sweeps of them."""
