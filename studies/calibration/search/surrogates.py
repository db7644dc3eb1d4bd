"""The Gaussian processes of a search: each fit begins with the hyperparameters of the one before."""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.growing_rows import GrowingBasis
from studies.calibration.problem import CalibrationProblem
from studies.calibration.processes.groups import Part, ProcessGroups, is_refitted
from studies.calibration.processes.process import Features
from studies.calibration.search.expected_objective import ExpectedObjective
from studies.calibration.search.failures import Failures
from studies.calibration.search.rows import Rows


class Surrogates:
    """Fits of the residuals, and of which simulations fail."""

    def __init__(self, problem: CalibrationProblem) -> None:
        """Begin without a fit."""
        self._prior = problem.prior
        self._features = Features.of(problem.space)
        self._parts = Part.parts_of(problem)
        # By the place of the part: its residuals in the window as coordinates, and its last hyperparameters.
        self._bases = dict[int, GrowingBasis]()
        self._hyper = dict[int, tuple[FloatArray, ...]]()
        self._failed_hyper: FloatArray | None = None
        self._n_fitted = self._n_failures_fitted = 0

    def forget_window(self) -> None:
        """Forget coordinates of residuals in a window that has changed."""
        self._bases, self._n_fitted = {}, 0

    def fit(self, rows: Rows) -> ProcessGroups:
        """Fit the residuals in the window.

        Raises:
            numpy.linalg.LinAlgError: There is no fit to such rows.
        """
        good, fitted = rows.sane, list[ProcessGroups]()
        output_of, n_known = rows.window.seen_of, rows.n_known
        # Rows of a warm start do not count: new ones matter as much as without them.
        n_new = int(good[n_known:].sum())
        refits = is_refitted(n_new, self._n_fitted)
        if refits:
            self._n_fitted = n_new
        for place, part in enumerate(self._parts):
            is_its = np.isin(output_of, part.outputs)
            # A truncated window may have nothing of an experiment.
            if not is_its.any():
                continue
            basis = self._bases.setdefault(place, GrowingBasis(int(is_its.sum())))
            basis.add(rows.window.seen(rows.residuals[basis.n_rows :])[:, is_its])
            process = ProcessGroups.fit(
                part.features,
                rows.u[good],
                basis.coordinates[good],
                self._hyper.get(place, ()),
                # A search in a truncated window has to explain large components first.
                balance=not rows.window.was_needed,
                # Beside hundreds of rows from everywhere within the
                # bounds, errors near the best row would pass for noise.
                n_noisy=int(good[:n_known].sum()) if n_known else None,
                n_residuals=int(is_its.sum()),
                refits=refits,
            )
            self._hyper[place] = process.hyper
            fitted.append(process)
        return ProcessGroups.joined(fitted)

    def expected(self, rows: Rows, scale: float) -> ExpectedObjective:
        """Fit the residuals, and where simulations fail; let that weigh as much as a scale. [unit squared].

        Raises:
            numpy.linalg.LinAlgError: There is no fit to such rows.
        """
        failed, process = ~rows.good, self.fit(rows)
        if not failed.any():
            return ExpectedObjective(process, self._prior)
        refits = is_refitted(failed.size, self._n_failures_fitted)
        if refits:
            self._n_failures_fitted = failed.size
        failures = Failures.fit(
            self._features, rows.u, failed, self._prior, self._failed_hyper, scale=scale, refits=refits
        )
        self._failed_hyper = failures.process.hyper
        return ExpectedObjective(process, failures)
