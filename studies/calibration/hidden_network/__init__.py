"""A linear network of hidden states, fitted to the simulations of a model that shows no states.

    C_i dx_i/dt = sum_j G_ij (x_j - x_i) + sum_k H_ik (p_k - x_i) + sum_l F_il q_l.

The outputs are the first states; inputs in their unit are potentials p, others sources q (inputs.py). Every
capacity C, conductance G or H and gain F is a constant times powers of the parameters (model.py). Over a step
inputs are constant, so states move by a matrix exponential, with its slopes (steps.py; Higham 2005,
doi:10.1137/04061101X). Constants and powers are fitted to all outputs by damped Gauss-Newton steps with
geodesic acceleration (fit.py; Transtrum and Sethna 2012, arXiv:1201.5885). Few powers differ from zero, so
each costs the logarithm of its size (Candès, Wakin and Boyd 2008, doi:10.1007/s00041-008-9045-x). The optimum
of the network is simulated next, as long as errors fall (search.py).
"""
