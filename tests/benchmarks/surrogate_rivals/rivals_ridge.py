"""Principal coordinates and kernel ridge regression (scikit-learn), tuned."""

import itertools

import numpy as np
from sklearn.kernel_ridge import KernelRidge
from sklearn.metrics.pairwise import pairwise_kernels

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Clock, Features, Fitted, Principal, error
from surrogate_rivals.problems import Data

# Rows from which the kernel is chosen.
MOST_ROWS = 1024
ALPHAS = np.logspace(-10, 1, 23)
KERNELS = ("rbf", "laplacian", "polynomial")
WIDTHS = np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0])
POWERS = (0.0, 0.25, 0.5, 0.75)


def kernel_ridge(data: Data, seed: int) -> Fitted:
    """Choose features, their weights, kernel, width and penalty by the validation set; 4,416 combinations.

    The weights are powers of each feature's part in a linear regression, so that a kernel with a single width
    shows what matters. One eigendecomposition serves all penalties.
    """
    del seed  # nothing is drawn
    features, principal = Features.of(data.space), Principal.of(data)
    z, z_validation = principal.coordinates(data.y), principal.coordinates(data.validation[1])
    few = slice(min(MOST_ROWS, len(z)))
    best: tuple[float, str, float, str, float, float] = (np.inf, "", 0.0, "", 0.0, 0.0)
    for how, power in itertools.product(("logarithmic", "both"), POWERS):
        x = getattr(features, how)(data.theta)
        weights = _weights(x, z) ** power
        x, x_validation = x * weights, getattr(features, how)(data.validation[0]) * weights
        for kernel, width in itertools.product(KERNELS, WIDTHS):
            for alpha, score in _scores(x[few], z[few], x_validation, z_validation, kernel, width):
                best = min(best, (score, how, power, kernel, width, alpha))
    _, how, power, kernel, width, alpha = best
    clock = Clock()
    x = getattr(features, how)(data.theta)
    weights = _weights(x, z) ** power
    model = KernelRidge(alpha=alpha, kernel=kernel, **_settings(kernel, width)).fit(x * weights, z)

    def predict(theta: FloatArray) -> FloatArray:
        return principal.outputs(model.predict(getattr(features, how)(theta) * weights))

    said = f"{how}, weights^{power:g}, {kernel}, width {width:g}, alpha {alpha:.0e}"
    return Fitted(predict, clock.s, said)


def _weights(x: FloatArray, z: FloatArray) -> FloatArray:
    """Return each feature's part in a ridge regression, relative to their mean. Shape (f,)."""
    centred = x - x.mean(axis=0)
    gram = centred.T @ centred
    slopes = np.linalg.solve(gram + 1e-2 * np.trace(gram) / len(gram) * np.eye(len(gram)), centred.T @ z)
    part = np.sqrt((slopes**2).sum(axis=1)) + 1e-12
    return np.asarray(part / np.sqrt((part**2).mean()))


def _settings(kernel: str, width: float) -> dict[str, float]:
    if kernel == "polynomial":
        return {"degree": 2.0 if width < 0.1 else 3.0, "gamma": 10.0 * width, "coef0": 1.0}
    return {"gamma": width}


def _scores(
    x: FloatArray,
    z: FloatArray,
    x_validation: FloatArray,
    z_validation: FloatArray,
    kernel: str,
    width: float,
) -> list[tuple[float, float]]:
    """Return penalties and their validation errors."""
    settings = _settings(kernel, width)
    values, vectors = np.linalg.eigh(pairwise_kernels(x, metric=kernel, **settings))
    across = pairwise_kernels(x_validation, x, metric=kernel, **settings) @ vectors
    turned = vectors.T @ z
    return [
        (float(alpha), error(across @ (turned / (values.clip(0.0) + alpha)[:, None]), z_validation))
        for alpha in ALPHAS
    ]
