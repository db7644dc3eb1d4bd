"""A linear network of hidden states, fitted to the simulations of a model without visible ones.

States are the outputs and three hidden ones, as temperatures of a room and its walls. Capacities,
conductances and gains are constants times powers of the parameters; what each input may drive follows from
its unit (inputs.py, model.py). Most powers are zero, so the fit charges each for its size (fit.py). Steps
of the linear network are exact (steps.py). `HiddenNetwork` (search.py) fits the network again after each
simulation, and proposes the lowest minima of its error within the bounds, until six rounds in a row have
gained nothing.
"""
