"""Whether samples that are compared as values of moments are rather means, late, or off by a constant.

Means over the sampling interval lag behind the moments of their stamps. Wrong parameters make up for a part
of that, so the parameters are fitted before errors are compared. The slopes of the fit to moments say which
other reading of the samples would fit best; that alone is tried.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.measurement import Measurement
from simulation.samples import Samples
from simulation.trajectories import Trajectories
from studies.doctor.finding import Finding, finding
from studies.words.wording import quantity, square_of

Simulate = Callable[[FloatArray], Trajectories]
"""Answers rows. Shape (n, p). [per parameter]"""
FAR_BETTER = 0.5
"""Means are named if they leave less than this share of the error. By hand: others come from noise."""
MOST = 0.25
"""Other readings are named if they leave less than this: means over an interval are the usual mistake."""
N_ROUNDS = 8
"""Steps downhill of a fit; Gauss-Newton steps near an optimum need three or four."""
STEP = 0.01
"""Step of differences in the unit cube: the error of a solver of 1e-4 is then small."""
DAMPINGS = (1e-6, 1e-3, 1e-1)
"""Damping of the steps that are tried at once, relative to the largest curvature: from next to none on."""
STAMPS = {"end": (-1.0, 0.0), "begin": (0.0, 1.0), "centre": (-0.5, 0.5)}
"""Where the interval of a mean lies, relative to its stamp. [sampling intervals]"""


def rows_for_means(case: Case) -> int:
    """Return how many simulations the fits to means take at most, 0 where samples can be no means."""
    n_parameters = case.parameter_space.n_parameters
    n_samples = sum(len(one.samples.time) for one in case.outputs if one.is_measured)
    is_long = n_samples > 2 * n_parameters and bool(_lengths_s(case))
    return 3 * N_ROUNDS * (n_parameters + 1 + len(DAMPINGS)) if is_long else 0


def look_at_means(case: Case, simulate: Simulate, known: Trajectories) -> Iterator[Finding]:
    """Name another reading of the samples that explains the data far better than values of moments.

    Args:
        case: The case of a single experiment.
        simulate: Asks its model, no row twice.
        known: Rows that were simulated, of which the best one is fitted.
    """
    lengths_s, good = _lengths_s(case), known.take(np.flatnonzero(~known.failed))
    plain = _with_means(case.measurement, lengths_s, None)
    if not lengths_s or plain is None or not good.n:
        return
    fit = _Fit.of(
        case, simulate, plain, case.parameter_space.to_unit(good.theta[np.argmin(plain.mse(good.y))])
    )
    if fit is None:
        return
    readings = [*_means(case, lengths_s), *_shifts(plain, lengths_s), *_offsets(plain, lengths_s)]
    # As a share of what each may leave: where a shift leaves half of what means do, means are likelier.
    reading = min(readings, key=lambda one: fit.expected(one.measurement) / one.most)
    if fit.expected(reading.measurement) >= reading.most * fit.mse:
        return
    other = _Fit.of(case, simulate, reading.measurement, fit.u)
    if other is None or other.mse >= reading.most * fit.mse:
        return
    # A fit that goes on finds less in any case: so does that to moments, from the same point.
    again = _Fit.of(case, simulate, plain, other.u)
    if again is not None and other.mse < reading.most * again.mse:
        unit = square_of(case.outputs[0].unit)
        words = {"better": quantity(other.mse, unit), "moments": quantity(min(fit.mse, again.mse), unit)}
        if isinstance(reading.measurement, _Freed):
            words["offset"] = reading.measurement.said(other.y[:1])
        yield finding(reading.key, "warn", **words, **reading.words)


@dataclass(frozen=True, eq=False)
class _Reading:
    """What samples may be instead of values of moments.

    Attributes:
        key: Its finding.
        words: What completes that.
        measurement: The samples read so.
        most: Share of the error that it may leave.
    """

    key: str
    words: Mapping[str, str]
    measurement: "Measurement | _Freed"
    most: float = MOST


def _means(case: Case, lengths_s: Mapping[int, float]) -> Iterator[_Reading]:
    """Yield means over the sampling intervals [s] of the outputs, by position: of each, and of all."""
    groups = [{k: length_s} for k, length_s in lengths_s.items()]
    groups += [dict(lengths_s)] * (len(lengths_s) > 1)
    for group in groups:
        for stamp in STAMPS:
            means = _with_means(case.measurement, group, stamp, beside=lengths_s)
            if means is None:
                continue
            more = f' and mean_stamp = "{stamp}"' * (stamp != "end")
            keys = (
                f"outputs[{case.outputs[k].name}] mean_over_s = {length_s:.12g}{more}"
                for k, length_s in group.items()
            )
            words = {
                "stamp": {"end": "end", "begin": "begin", "centre": "have their centre"}[stamp],
                "names": ", ".join(case.outputs[k].name for k in group),
                "keys": "; ".join(keys),
            }
            yield _Reading("means", words, means, FAR_BETTER)


def _shifts(plain: Measurement, lengths_s: Mapping[int, float]) -> Iterator[_Reading]:
    """Yield samples that were taken half a sampling interval [s] earlier or later than they say."""
    for k, length_s in lengths_s.items():
        one = plain.outputs[k]
        for shift_s, word in ((-0.5 * length_s, "earlier"), (0.5 * length_s, "later")):
            moved = replace(one.samples, time=one.samples.time + shift_s)
            words = {"name": one.name, "shift": f"{abs(shift_s):.12g} s {word}"}
            yield _Reading("shifted", words, _with_output(plain, k, moved))


def _offsets(plain: Measurement, lengths_s: Mapping[int, float]) -> Iterator[_Reading]:
    """Yield samples that are off by a constant, whichever explains most."""
    for k in lengths_s:
        samples = plain.outputs[k].samples
        raised = _with_output(plain, k, replace(samples, values=samples.values + 1.0))
        yield _Reading(
            "offset", {"name": plain.outputs[k].name}, _Freed(plain, raised, plain.outputs[k].unit)
        )


@dataclass(frozen=True, eq=False)
class _Freed:
    """A measurement one of whose outputs is off by a constant, which is fitted to each row.

    Attributes:
        plain: The measurement as it is.
        raised: The same with samples that are higher by 1 in the output's unit.
        unit: The output's unit.
    """

    plain: Measurement
    raised: Measurement
    unit: str

    def _fitted(self, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return residuals, what 1 adds to them, and by how much samples are too high. Shape (n, ...)."""
        residuals = self.plain.compared(y)
        one = self.raised.compared(y) - residuals
        high = np.sum(one * residuals, axis=1, keepdims=True) / np.sum(one**2, axis=1, keepdims=True)
        return residuals, one, high

    def compared(self, y: FloatArray) -> FloatArray:
        """Return the residuals as `Measurement` does."""
        residuals, one, high = self._fitted(y)
        return residuals - high * one

    def mse(self, y: FloatArray) -> FloatArray:
        """Return the error as `Measurement` does."""
        error = np.mean(self.compared(y) ** 2, axis=1)
        return np.where(np.isfinite(error), error, np.inf)

    def said(self, y: FloatArray) -> str:
        """Say by how much samples are too high or too low, at one row."""
        high = float(self._fitted(y)[2][0, 0])
        return f"{quantity(abs(high), self.unit)} too {'high' if high > 0.0 else 'low'}"


def _with_output(measurement: Measurement, k: int, samples: Samples) -> Measurement:
    outputs = list(measurement.outputs)
    outputs[k] = replace(outputs[k], samples=samples)
    return replace(measurement, outputs=tuple(outputs))


def _lengths_s(case: Case) -> dict[int, float]:
    """Return the sampling intervals of the outputs that may be measured as means, by position. [s]."""
    found = {}
    for k, one in enumerate(case.outputs):
        if one.is_measured and not one.samples.are_means and one.samples.since_s is None:
            length_s = float(np.median(np.diff(one.samples.time)))
            # Between two outputs no mean differs from the moment in its middle.
            if length_s >= (1.0 - 1e-6) * case.output_step_s:
                found[k] = length_s
    return found


def _with_means(
    measurement: Measurement,
    lengths_s: Mapping[int, float],
    stamp: str | None,
    *,
    beside: Mapping[int, float] | None = None,
) -> Measurement | None:
    """Return a measurement some of whose outputs are means, or moments where no stamp is given.

    Samples whose interval would leave the window are left out in every case, so that all errors are of the
    same samples.

    Args:
        measurement: The measurement.
        lengths_s: The outputs, by position, and their sampling intervals. [s]
        stamp: What of the interval the stamps are.
        beside: All outputs of which samples are left out; None for those.

    Returns:
        None where an output has no sample left.
    """
    outputs, (begin_s, end_s) = list(measurement.outputs), measurement.time[[0, -1]]
    for k, length_s in (beside or lengths_s).items():
        samples = outputs[k].samples
        kept = (samples.time - length_s >= begin_s - 1e-6) & (samples.time + length_s <= end_s + 1e-6)
        if not kept.any():
            return None
        interval = samples.interval
        if stamp is not None and k in lengths_s:
            first, last = STAMPS[stamp]
            interval = (first * length_s, last * length_s)
        outputs[k] = replace(outputs[k], samples=samples.taken(kept, interval))
    return replace(measurement, outputs=tuple(outputs))


@dataclass(frozen=True, eq=False)
class _Fit:
    """The end of a walk downhill.

    Attributes:
        u: The point. Shape (p,). [1]
        steps: From it to its neighbours, one parameter each. Shape (p,). [1]
        y: Trajectories there and at its neighbours. Shape (p + 1, t, k). [per output]
        mse: Error at the point. [first output's unit squared]
    """

    u: FloatArray
    steps: FloatArray
    y: FloatArray
    mse: float

    @classmethod
    def of(
        cls, case: Case, simulate: Simulate, measurement: Measurement | _Freed, u: FloatArray
    ) -> "_Fit | None":
        """Walk downhill by damped Gauss-Newton steps; None where the first neighbours fail.

        Args:
            case: The case.
            simulate: Asks its model, no row twice.
            measurement: What is fitted.
            u: The start. Shape (p,). [1]
        """
        space, found = case.parameter_space, None
        for _ in range(N_ROUNDS):
            steps = np.where(u < 0.5, STEP, -STEP)
            answer = simulate(space.from_unit(np.vstack([u, u + np.diag(steps)])))
            if answer.failed.any():
                break
            found = cls(u, steps, answer.y, float(measurement.mse(answer.y[:1])[0]))
            residuals, slopes = found.linearised(measurement)
            curvature = slopes.T @ slopes
            most = float(np.max(np.diag(curvature))) or 1.0
            walks = [
                np.linalg.solve(curvature + damping * most * np.eye(len(u)), slopes.T @ residuals)
                for damping in DAMPINGS
            ]
            trials = np.unique(np.clip(u - np.array(walks), 0.0, 1.0), axis=0)
            errors = measurement.mse(simulate(space.from_unit(trials)).y)
            if not np.min(errors) < 0.99 * found.mse:
                break
            u = trials[np.argmin(errors)]
        return found

    def linearised(self, measurement: Measurement | _Freed) -> tuple[FloatArray, FloatArray]:
        """Return residuals (m,) and their slopes (m, p) at the point. [unit, unit per range]."""
        residuals = measurement.compared(self.y)
        return residuals[0], ((residuals[1:] - residuals[0]) / self.steps[:, None]).T

    def expected(self, measurement: Measurement | _Freed) -> float:
        """Return the least error that slopes expect of another measurement. [first output's unit squared]."""
        residuals, slopes = self.linearised(measurement)
        walk = np.linalg.lstsq(slopes, residuals, rcond=1e-6)[0]
        return float(np.mean((residuals - slopes @ walk) ** 2))
