"""Optuna studies: which surrogate is trained next, by whom, and what is kept of it."""
