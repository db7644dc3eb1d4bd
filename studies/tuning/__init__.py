"""Tuning: Optuna studies of the surrogate's hyperparameters. Optuna owns the trials."""
