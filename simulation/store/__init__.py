"""Keeping every simulated row once."""
