"""The search on the model alone: which points it simulates next, and when it ends.

`Adaptive.minimize` (adaptive.py) is the door. The search is a loop: `next_move` (adaptive_search.py) reads
the records of a `SearchState` and returns a move (moves.py) or an `Ending` (ending.py).

The first design is a Latin hypercube. Then search phases follow. In each round `Surrogates` fits Gaussian
processes to the residuals of all `Rows`. The expected objective is minimized inside a `TrustRegion` around
the phase's best point, and its minimum is simulated (proposals.py). A `SearchPhase` that gains too little
ends. Restarts then begin farther along the valley or near another local minimum (restart.py). Tests
simulate minima of functions drawn from the posterior, and a `Confirmation` counts what both have gained.

Learned state equations replace the processes' proposals while they are believed (equations.py), and so does
a hidden network. Where the model explains too little, a `TruncatedWindow` is compared first. `Failures`
keeps the search away from where simulations fail.
"""
