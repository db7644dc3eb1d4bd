"""Peers that see one number per call: Nelder-Mead, differential evolution, Py-BOBYQA, CMA-ES, Optuna."""

import warnings

import numpy as np

from fewest_calls.counted import Asked
from simulation.arrays import FloatArray
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.first_design import latin_hypercube

N_SCREENED = 10


def nelder_mead(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """SciPy's Nelder-Mead with dimension-adapted coefficients, from the best of ten points; restarted."""
    from scipy.optimize import minimize

    asked, rng = Asked(problem), np.random.default_rng(seed)
    p = asked.n_parameters
    for _ in range(max_calls):
        start = _screened(asked, rng)
        # A simplex that points to the box's inside and is large enough to look around.
        away = np.where(start < 0.5, 0.25, -0.25)
        simplex = np.vstack([start, start + np.diag(away)])
        minimize(
            asked.log_mse,
            start,
            method="Nelder-Mead",
            bounds=[(0.0, 1.0)] * p,
            options={
                "initial_simplex": simplex,
                "adaptive": True,
                "maxfev": 10 * max_calls,
                "maxiter": 10 * max_calls,
                "xatol": 1e-4,
                "fatol": 1e-6,
            },
        )


def differential_evolution(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """SciPy's differential evolution, greedy and with a small population, without its hidden polish."""
    from scipy.optimize import differential_evolution as peer

    asked = Asked(problem)
    peer(
        asked.log_mse,
        [(0.0, 1.0)] * asked.n_parameters,
        popsize=3,
        strategy="best1bin",
        mutation=(0.4, 0.9),
        recombination=0.9,
        init="latinhypercube",
        tol=1e-8,
        maxiter=max_calls,
        polish=False,
        rng=np.random.default_rng(seed),
    )


def bobyqa(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Py-BOBYQA (doi 10.1145/3338517) from the best of ten points; again when it has converged."""
    import pybobyqa as peer

    asked, rng = Asked(problem), np.random.default_rng(seed)
    bounds = (np.zeros(asked.n_parameters), np.ones(asked.n_parameters))
    for _ in range(max_calls):
        start = np.clip(_screened(asked, rng), 0.1, 0.9)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            peer.solve(
                asked.log_mse,
                start,
                bounds=bounds,
                rhobeg=0.1,
                rhoend=1e-5,
                maxfun=max_calls,
                do_logging=False,
            )


def cma_es(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """CMA-ES (pycma) over the unit cube, restarted with twice the population."""
    import cma

    asked, rng = Asked(problem), np.random.default_rng(seed)
    p = asked.n_parameters
    size = 4 + int(3 * np.log(p))
    for _ in range(max_calls):
        settings = {
            "bounds": [0.0, 1.0],
            "popsize": size,
            "seed": int(rng.integers(1, 2**31)),
            "verbose": -9,
            "tolx": 1e-6,
            "maxfevals": 100 * max_calls,
        }
        strategy = cma.CMAEvolutionStrategy(rng.uniform(0.2, 0.8, p), 0.25, settings)
        while not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, [asked.log_mse(np.asarray(point)) for point in points])
        size *= 2


def optuna_tpe(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Optuna's TPE with the dependence between parameters."""
    import optuna

    sampler = optuna.samplers.TPESampler(multivariate=True, n_startup_trials=N_SCREENED, seed=seed)
    _optuna(sampler, problem, max_calls)


def optuna_gp(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Optuna's Gaussian process sampler on the logarithm of the error."""
    import optuna

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sampler = optuna.samplers.GPSampler(
            deterministic_objective=True, n_startup_trials=N_SCREENED, seed=seed
        )
    _optuna(sampler, problem, max_calls)


def optuna_cma_es(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Optuna's CMA-ES."""
    import optuna

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sampler = optuna.samplers.CmaEsSampler(sigma0=0.25, seed=seed)
    _optuna(sampler, problem, max_calls)


def _optuna(sampler: object, problem: CalibrationProblem, max_calls: int) -> None:
    import optuna

    asked = Asked(problem)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=sampler)  # type: ignore[arg-type]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(max_calls):
            trial = study.ask()
            u = np.array([trial.suggest_float(f"u{i:02d}", 0.0, 1.0) for i in range(asked.n_parameters)])
            study.tell(trial, asked.log_mse(u))


def _screened(asked: Asked, rng: np.random.Generator) -> FloatArray:
    """Return the best of ten Latin hypercube points. Shape (p,). [1]."""
    design = latin_hypercube(N_SCREENED, asked.n_parameters, rng)
    return np.asarray(design[int(np.argmin([asked.mse(u) for u in design]))])
