"""Principal coordinates and sparse polynomial chaos (OpenTURNS) by least angle regression (scikit-learn)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import openturns as ot
from sklearn.linear_model import lars_path_gram

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Clock, Features, Fitted, Principal, error
from surrogate_rivals.problems import Data

# Rows from which the basis is chosen, and from which its terms are.
FEW_ROWS, MOST_ROWS = 512, 1024
LEFT_OUT = 1e-4  # of the variance: a hundredth of what the polynomials leave
KINDS = ("linear", "logarithmic", "both")
NORMS = (0.4, 0.7, 1.0)
SIZES = (200, 800)
PENALTIES = (1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
MOST_STEPS = 300  # along the path
N_COMPARED = 3  # leading coordinates by which a basis is chosen


@dataclass(frozen=True)
class _Basis:
    """Products of Legendre polynomials, the first ones of a hyperbolic enumeration.

    Attributes:
        kind: Features.
        norm: Of the exponents: the smaller, the fewer products of several features.
        size: Terms to choose from.
        is_full: Whether all terms are used and none is chosen.
    """

    kind: str
    norm: float
    size: int
    is_full: bool = False


def sparse_chaos(data: Data, seed: int) -> Fitted:
    """Choose features, norm and size of the basis, and where to stop on the path, by the validation set.

    OpenTURNS' own least angles, stopped by corrected leave-one-out, were tried: worse (1.05 against 0.80 K on
    the office at n = 64) and slower. Where there are twice as many rows as terms, all terms in a ridge
    regression are a choice too. At most 512 rows choose the basis, 1,024 the terms; coefficients come from
    all rows.
    """
    del seed  # nothing is drawn
    features, principal = Features.of(data.space), Principal.of(data, LEFT_OUT)
    z, z_validation = principal.coordinates(data.y), principal.coordinates(data.validation[1])
    few = min(FEW_ROWS, len(z))

    def terms(basis: _Basis, theta: FloatArray) -> FloatArray:
        return _terms(basis, 2.0 * getattr(features, basis.kind)(theta))

    def learnt(basis: _Basis, rows: int, most: int, leading: slice) -> tuple[FloatArray, float]:
        """Return coefficients of all terms, most of them zero, and their error in validation."""
        known, checked = terms(basis, data.theta[:rows]), terms(basis, data.validation[0])
        wanted = z_validation[:, leading]
        if basis.is_full:
            found = _regressed(known, z[:rows, leading], checked, wanted)
            return found, error(checked @ found, wanted)
        gram = known[:most].T @ known[:most]
        found = np.zeros((basis.size, wanted.shape[1]))
        for j, target in enumerate(z[:rows, leading].T):
            guess = _path(gram, known[:most], target[:most], checked, wanted[:, j])
            used = np.flatnonzero(guess)
            again = np.zeros(basis.size)
            again[used] = _regressed(known[:, used], target[:, None], checked[:, used], wanted[:, [j]])[:, 0]
            found[:, j] = min(
                guess, again, key=lambda one: float(((checked @ one - wanted[:, j]) ** 2).sum())
            )
        return found, error(checked @ found, wanted)

    def score(basis: _Basis) -> float:
        return learnt(basis, len(z) if basis.is_full else few, few, slice(N_COMPARED))[1]

    chosen = min(_bases(len(z)), key=score)
    clock = Clock()
    coefficients, _ = learnt(chosen, len(z), MOST_ROWS, slice(None))
    fit_s = clock.s

    def predict(theta: FloatArray) -> FloatArray:
        return principal.outputs(terms(chosen, theta) @ coefficients)

    n_terms = int((coefficients != 0.0).sum(axis=0).max())
    said = f"{chosen.kind}, norm {chosen.norm:g}, at most {n_terms} of {chosen.size} terms"
    return Fitted(predict, fit_s, said)


def _bases(n: int) -> Iterator[_Basis]:
    for kind in KINDS:
        for norm in NORMS:
            for size in SIZES:
                yield _Basis(kind, norm, size)
                if n >= 2 * size:
                    yield _Basis(kind, norm, size, is_full=True)


def _family(basis: _Basis, n_features: int) -> ot.OrthogonalProductPolynomialFactory:
    enumeration = ot.HyperbolicAnisotropicEnumerateFunction(n_features, basis.norm)
    return ot.OrthogonalProductPolynomialFactory([ot.LegendreFactory()] * n_features, enumeration)


def _terms(basis: _Basis, x: FloatArray) -> FloatArray:
    """Return the values of all terms. Shape (n, size)."""
    family = _family(basis, x.shape[1])
    exponents = np.array([list(family.getEnumerateFunction()(i)) for i in range(basis.size)])
    degrees = np.arange(exponents.max() + 1)
    legendre = np.polynomial.legendre.legvander(x, degrees[-1]) * np.sqrt(2.0 * degrees + 1.0)
    found = np.ones((len(x), basis.size))
    for feature, powers in enumerate(exponents.T):
        occurs = powers > 0
        found[:, occurs] *= legendre[:, feature, powers[occurs]]
    return found


def _regressed(known: FloatArray, z: FloatArray, checked: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return coefficients of ridge regressions, penalties chosen by validation. Shape (terms, q)."""
    left, values, right = np.linalg.svd(known, full_matrices=False)
    turned = left.T @ z
    shrinks = [values / (values**2 + penalty * len(z)) for penalty in PENALTIES]
    tried = np.stack([right.T @ (turned * shrink[:, None]) for shrink in shrinks])
    best = ((checked @ tried - wanted) ** 2).sum(axis=1).argmin(axis=0)
    return np.asarray(tried[best, :, np.arange(z.shape[1])].T)


def _path(
    gram: FloatArray, known: FloatArray, z: FloatArray, checked: FloatArray, wanted: FloatArray
) -> FloatArray:
    """Return the point of the lasso's path that is best in validation. Shape (size,)."""
    _, _, path = lars_path_gram(
        known.T @ z, gram, n_samples=len(z), max_iter=min(MOST_STEPS, len(z) - 1), method="lasso"
    )
    return np.asarray(path[:, int(((checked @ path - wanted[:, None]) ** 2).sum(axis=0).argmin())])
