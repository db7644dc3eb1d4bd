"""Simulating in supervised processes: here, on any executor, on a cluster."""
