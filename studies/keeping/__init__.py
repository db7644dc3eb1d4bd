"""Living with the stores: whether they are sound, what may go, and how a study moves to another place."""
