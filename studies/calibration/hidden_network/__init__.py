"""A linear network of hidden states, fitted to the simulations of a model without visible ones."""
