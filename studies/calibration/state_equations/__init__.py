"""State equations of a model, learnt from a few of its simulations and solved in its place.

    dx_j/dt = sum_k a_jk(theta) f_jk(x, u),    y_l = sum_k c_lk(theta) g_lk(x, u).

An FMU shows its states x and their derivatives beside its outputs y (states.py). The terms f and g are chosen
among states, inputs, their differences, products and functions by orthogonal least squares (terms.py,
term_choice.py; Chen, Billings and Luo 1989, doi:10.1080/00207178908953472). Least squares give each row's
coefficients, and these are sought as formulas of the parameters: products of powers 1 and -1 and sums of such
(coefficient.py, product_forms.py). Weather inside the FMU becomes inputs (hidden_inputs.py), and variables of
two values become states with thresholds (switch_positions.py, switch_rules.py).

Linear equations are solved by matrix exponentials, others by Runge-Kutta steps of fourth order (flow.py). The
lowest error by the equations is sought by Gauss-Newton walks from many points, and simulated (optimum.py).
Equations are trusted as far as solved rows match simulated ones (belief.py). `learner.py` does all this for
one experiment, `learned_ode.py` puts experiments together, and `experiments_ode.py` learns in few of them.
"""
