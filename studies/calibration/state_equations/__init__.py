"""Equations of the model's states, learned from its simulations."""
