"""The search on the model alone: which points it simulates next, and when it ends."""
