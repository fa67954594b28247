"""Many random motions: distributions, statistics, stores, sensitivity."""
