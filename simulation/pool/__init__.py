"""A pool of supervised processes, here or on a cluster: what an FMU does to its process costs one row."""
