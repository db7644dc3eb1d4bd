"""Linear networks of states under recorded inputs, solved exactly; NumPy and numba, no torch.

    dx/dt = A x + B u,    y = C x + D u,

with inputs u that are constant over each communication step and matrices that change with the pattern of the
switches (drive.py). Over a step of length h states move by

    x[t + 1] = E x[t] + I B u[t],    E = exp(A h),    I = the integral of exp(A s) from 0 to h,

which is exact (kernels.py; Higham 2005, doi:10.1137/04061101X). What E, I and x owe to A, B and the first
states comes from the adjoint of each formula, in the time of some three solutions.

A, B, C and D are made of elements, each a constant times powers of the parameters (form.py): capacities,
conductances and gains of a network of stores, as heat in a building, or decay rates and frequencies of modes.
"""
