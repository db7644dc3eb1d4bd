"""A store that holds every simulated row once."""
