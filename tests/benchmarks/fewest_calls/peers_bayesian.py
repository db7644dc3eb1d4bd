"""BoTorch: composite Bayesian optimization, the processes on the residuals and not on the error.

Astudillo and Frazier 2019, "Bayesian optimization of composite functions" (arXiv 1906.01537), with the
logarithmic form of expected improvement (arXiv 2310.20708).
"""

import warnings

import numpy as np

from fewest_calls.counted import Asked
from simulation.arrays import FloatArray
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.first_design import latin_hypercube

# What far rows vary in most is not all that near ones do.
MOST_COMPONENTS = 12
EXPLAINED = 0.99999
N_DRAWS = 64


def botorch_composite(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Expected improvement of the squared norm of residuals that Gaussian processes predict."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    asked, rng = Asked(problem), np.random.default_rng(seed)
    u = latin_hypercube(max(10, asked.n_parameters), asked.n_parameters, rng)
    residuals = np.array([asked.residuals(row) for row in u])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(max_calls):
            point = _propose(u, residuals, seed)
            if float(np.abs(u - point).max(axis=1).min()) < 1e-6:
                point = rng.random(asked.n_parameters)
            u = np.vstack([u, point])
            residuals = np.vstack([residuals, asked.residuals(point)])


def _propose(u: FloatArray, residuals: FloatArray, seed: int) -> FloatArray:
    """Return the next point. Shape (p,). [1]."""
    import torch
    from botorch.acquisition import qLogExpectedImprovement
    from botorch.acquisition.objective import GenericMCObjective
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Standardize
    from botorch.optim import optimize_acqf
    from botorch.sampling import SobolQMCNormalSampler
    from gpytorch.mlls import ExactMarginalLogLikelihood

    centre = residuals.mean(axis=0)
    _, values, directions = np.linalg.svd(residuals - centre, full_matrices=False)
    shares = np.cumsum(values**2) / np.sum(values**2)
    n = min(int(np.searchsorted(shares, EXPLAINED)) + 1, MOST_COMPONENTS)
    basis = directions[:n]
    z = (residuals - centre) @ basis.T
    # What the components leave out of a residual's square: the part of the mean that none of them changes.
    rest = float(np.sum((centre - basis.T @ (basis @ centre)) ** 2))
    shift = torch.tensor(basis @ centre)
    at, seen = torch.tensor(u), torch.tensor(z)
    model = SingleTaskGP(
        at, seen, train_Yvar=1e-6 * seen.var(dim=0).expand_as(seen), outcome_transform=Standardize(n)
    )
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))

    def worth(samples: torch.Tensor, X: torch.Tensor | None = None) -> torch.Tensor:
        return -torch.log(((samples + shift) ** 2).sum(dim=-1) + rest)

    acquisition = qLogExpectedImprovement(
        model,
        best_f=worth(seen).max(),
        sampler=SobolQMCNormalSampler(torch.Size([N_DRAWS]), seed=seed),
        objective=GenericMCObjective(worth),
    )
    bounds = torch.stack([torch.zeros(u.shape[1]), torch.ones(u.shape[1])]).double()
    found, _ = optimize_acqf(
        acquisition,
        bounds,
        q=1,
        num_restarts=4,
        raw_samples=128,
        options={"maxiter": 100, "sample_around_best": True},
    )
    return np.asarray(found.detach().numpy()[0])
