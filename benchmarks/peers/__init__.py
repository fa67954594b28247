"""Peer programs of the benchmark: the same rolling problems, solved otherwise."""
