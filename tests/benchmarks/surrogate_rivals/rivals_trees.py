"""Principal coordinates and, for each, gradient-boosted trees (scikit-learn's histogram form)."""

import itertools
from dataclasses import dataclass

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Clock, Features, Fitted, Principal
from surrogate_rivals.problems import Data

LEFT_OUT = 1e-4  # of the variance: a hundredth of what the trees leave
RATES, LEAVES, LEAST_ROWS, TRUNKS = (0.05, 0.1), (4, 12), (5, 20), (0, 1, 2)
N_COMPARED = 2  # leading coordinates by which settings are chosen
FEW_ROWS = 1024  # from which settings are chosen
MOST_TREES, PATIENCE = 1000, 25
ALPHAS = np.logspace(-6, 3, 19)


@dataclass(frozen=True)
class _Settings:
    """What is chosen: the trees, and the degree of the polynomial whose residuals they learn (0 for none)."""

    trunk: int
    learning_rate: float
    max_leaf_nodes: int
    min_samples_leaf: int


class _Coordinate:
    """One coordinate: a polynomial by ridge regression and trees on its residuals."""

    def __init__(
        self,
        settings: _Settings,
        known: tuple[FloatArray, FloatArray],
        validation: tuple[FloatArray, FloatArray],
        seed: int,
    ) -> None:
        x, z = known
        self._trunk = None
        if settings.trunk:
            polynomial = PolynomialFeatures(settings.trunk, include_bias=False)
            self._trunk = make_pipeline(polynomial, RidgeCV(ALPHAS)).fit(x, z)
        self._trees = HistGradientBoostingRegressor(
            learning_rate=settings.learning_rate,
            max_leaf_nodes=settings.max_leaf_nodes,
            min_samples_leaf=settings.min_samples_leaf,
            max_iter=MOST_TREES,
            early_stopping=True,
            n_iter_no_change=PATIENCE,
            random_state=seed,
        )
        self._trees.fit(
            x, z - self._base(x), X_val=validation[0], y_val=validation[1] - self._base(validation[0])
        )

    def __call__(self, x: FloatArray) -> FloatArray:
        """Predict. Shape (n,)."""
        return np.asarray(self._base(x) + self._trees.predict(x))

    def _base(self, x: FloatArray) -> FloatArray:
        return np.zeros(len(x)) if self._trunk is None else np.asarray(self._trunk.predict(x))


def boosted_trees(data: Data, seed: int) -> Fitted:
    """Choose rate, leaves and trunk by the validation set (24 combinations), which also says when to stop.

    Trees alone know nothing of slopes; on the residuals of a linear or quadratic regression they may.
    """
    features, principal = Features.of(data.space), Principal.of(data, LEFT_OUT)
    x, z = features.both(data.theta), principal.coordinates(data.y)
    x_validation, z_validation = features.both(data.validation[0]), principal.coordinates(data.validation[1])

    def learnt(settings: _Settings, j: int, rows: int) -> _Coordinate:
        return _Coordinate(settings, (x[:rows], z[:rows, j]), (x_validation, z_validation[:, j]), seed)

    def score(settings: _Settings) -> float:
        wrong = [
            learnt(settings, j, FEW_ROWS)(x_validation) - z_validation[:, j]
            for j in range(min(N_COMPARED, z.shape[1]))
        ]
        return float(np.square(wrong).sum())

    chosen = min((_Settings(*one) for one in itertools.product(TRUNKS, RATES, LEAVES, LEAST_ROWS)), key=score)
    clock = Clock()
    coordinates = [learnt(chosen, j, len(z)) for j in range(z.shape[1])]
    fit_s = clock.s

    def predict(theta: FloatArray) -> FloatArray:
        rows = features.both(theta)
        return principal.outputs(np.stack([one(rows) for one in coordinates], axis=1))

    said = f"trunk of degree {chosen.trunk}, rate {chosen.learning_rate}, {chosen.max_leaf_nodes} leaves"
    return Fitted(predict, fit_s, said)
