"""What results mean, in sentences that the terminal and the page share."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from studies.calibration.search.misfit_threshold import misfit_threshold
from studies.calibration.uncertainty.identifiability import DETERMINED, Ridge
from studies.calibration.uncertainty.noise import Noise
from studies.results.choice import Choice
from studies.results.outcome import Outcome
from studies.results.planned import Planned
from studies.results.profiled import Profiles
from studies.results.stage_results import (
    Calibration,
    Determined,
    EquationsFound,
    LargestSample,
    TunedSize,
    Uncertainty,
)
from studies.words.console import format_seconds
from studies.words.wording import (
    compared_in,
    count,
    difference_unit,
    ended,
    in_letters,
    listed,
    moment_of,
    percent,
    quantity,
    shown_unit,
    significant,
    square_of,
    squared,
)

if TYPE_CHECKING:  # numba and FMPy, which `studies best` does without
    from simulation.case import Case
    from simulation.measurement import MeasuredOutput

MOST_NAMED, FARTHEST = 4, 3
"""Outputs up to which a sentence names all, and how many it names of more."""
UNCORRELATED = 0.9
"""Samples that are worth this share of their number are said to be uncorrelated."""
_RANDOM = (
    "The FMU is not deterministic: the best simulation was another one when it was repeated with the same "
    "parameters, so no error and no parameter here is exact"
)
_OWN_PROCESSES = (
    "The FMU does not forget one simulation before the next, so each simulation had a process of its own"
)
FITS_BETTER = 0.99
"""Share of a calibration's error below which another parameter set is said to fit better."""


def headline(case: "Case", outcome: Outcome[Calibration]) -> str:
    """Say what a calibration came to, what it cost and why it ended."""
    found, unit = outcome.result, square_of(case.outputs[0].unit)
    n_experiments = len(case.experiments)
    n_alone = 0 if found.state_equations is None else found.state_equations.n_alone
    n_rows = found.n_calls_paper - (math.ceil(n_alone / n_experiments) if n_alone else 0)
    cost = count(n_rows, "model call")
    if n_experiments:
        alone = f" and {n_alone} in single ones" if n_alone else ""
        cost += f" in each of {count(n_experiments, 'experiment')}{alone}"
        cost += f", {count(n_rows * n_experiments + n_alone, 'simulation')} in all"
    if found.settings.get("n_parallel", 1) != 1:
        cost += f" in {count(found.n_rounds or 0, 'round')}"
    if found.n_warm_start:
        cost += f", begun with {count(found.n_warm_start, 'stored simulation')}"
    return (
        f"{found.error_name} {quantity(found.mse, unit, 4)} after {cost} ({format_seconds(outcome.wall_s)}). "
        f"{ended(found.stop_reason, converged=found.converged)}"
    )


def calibration_sentences(case: "Case", found: Calibration) -> list[str]:
    """Say what a calibration means, from how its state equations did to what priors weigh."""
    said = [_RANDOM] * found.is_random + [_OWN_PROCESSES] * found.has_own_processes
    said += [] if found.state_equations is None else [equations_sentence(found.state_equations)]
    if not math.isfinite(found.mse):
        return said
    said += [_fit(case, found), *_relative(case, found), *_limits(case, found), *_outliers(case, found)]
    said += [] if found.determined_by_data is None else determined_sentences(found.determined_by_data)
    if (prior := found.prior) is not None:
        unit = square_of(case.outputs[0].unit)
        said.append(
            f"One standard deviation of a prior weighs as much as {quantity(prior.weight, unit)} of "
            f"{found.error_name} ({prior.n_independent:.4g} independent samples); all priors together "
            f"{quantity(prior.penalty, unit)}, which no {found.error_name} shown here includes"
        )
    return said


def determined_sentences(judged: Determined) -> list[str]:
    """Say which parameters are left open and which compensate each other; nothing where none is open."""
    if not judged.open:
        return []
    n = count(len(judged.spread), "parameter")
    first = (
        f"The data do not determine {len(judged.open)} of {n} (standard deviation at the result of "
        f"{percent(DETERMINED)} of the range or more): {listed(judged.open)}"
    )
    return [first, *(_ridge(judged, ridge) for ridge in judged.ridges)]


def _ridge(judged: Determined, ridge: Ridge) -> str:
    """Say which parameters compensate each other, and how many of them have to be fixed."""
    n, n_free = len(ridge.names), in_letters(ridge.n_free)
    how = [pair.how for pair in judged.pairs if n == 2 and (pair.first, pair.second) == ridge.names]
    return (
        f"{listed(ridge.names)} compensate each other{f' ({how[0]})' if how else ''}: the data determine "
        f"{in_letters(n - ridge.n_free)} of these {in_letters(n)}; fix {n_free} under [fixed]"
    )


def equations_sentence(equations: EquationsFound) -> str:
    """Say what became of the state equations that a calibration looked for."""
    calls, hidden = count(equations.n_calls, "call"), equations.hidden_inputs
    inputs = "input" if len(hidden) == 1 else "inputs"
    learnt = f"learnt with {listed(hidden)} of the FMU as {inputs}" if hidden else "learnt"
    if equations.n_alone:
        learnt += f" from {count(equations.n_alone, 'simulation')} of single experiments"
    if equations.are_believed:
        end = f"{learnt}, and {calls} went where they expect the lowest error"
        if equations.is_given_up:
            end += "; the last ones gained less than the equations err by, so no more were asked there"
        if equations.without_effect:
            end += f"; {listed(equations.without_effect)} changed nothing in any simulation"
    elif equations.why_not is None:
        end = f"{learnt}, but their last predictions were wrong, after {calls}; the search went on without"
    else:
        how = f"given up after {calls}" if equations.n_calls else "not learnt"
        end = f"{how}, for {equations.why_not}; the search did without"
    return f"State equations of {count(equations.n_states, 'state')}: {end}"


def _fit(case: "Case", found: Calibration) -> str:
    parts = []
    for output in _shown(case, found):
        fit, unit = found.outputs[output.name], difference_unit(output.unit)
        part = f"{output.name} differs by {quantity(fit.rmse, unit)} (RMS)"
        if fit.uncertainty is not None and fit.share_within is not None:
            sensor = f"the sensor's ±{fit.uncertainty:g} {unit}".strip()
            within = "the uncertainty of each sample" if fit.of_each_sample else sensor
            part += f", {percent(fit.share_within)} of it within {within}"
        parts.append(part)
    n_left = len(case.measurement.measured) - len(parts)
    less = f"; the other {n_left} outputs by a smaller part of their range" if n_left else ""
    return _begun(f"{compared_in(case)} {'; '.join(parts)}{less}")


def _shown(case: "Case", found: Calibration) -> list["MeasuredOutput"]:
    """Return the measured outputs that a sentence names: all, or of many those that differ most."""
    measured = [output for output in case.outputs if output.is_measured]
    if len(measured) <= MOST_NAMED:
        return measured
    return sorted(measured, key=lambda output: found.outputs[output.name].nrmse or 0.0)[: -FARTHEST - 1 : -1]


def _relative(case: "Case", found: Calibration) -> list[str]:
    """Say how large differences are relative to what was measured, of the outputs that have it."""
    parts = []
    for output in _shown(case, found):
        fit = found.outputs[output.name]
        shares = [
            f"{name} {percent(share)}"
            for name, share in (("NRMSE", fit.nrmse), ("CV(RMSE)", fit.cv_rmse))
            if share is not None
        ]
        parts += [f"{output.name} {' and '.join(shares)}"] * bool(shares)
    return [f"Relative to the range and the mean of the measured values: {'; '.join(parts)}"] * bool(parts)


def _limits(case: "Case", found: Calibration) -> list[str]:
    """Say which outputs keep their limits, and how far the others lie beyond."""
    said = []
    for output in case.outputs:
        fit, limits, unit = found.outputs[output.name], output.limits, output.unit
        if limits is None or fit.largest_excess is None or fit.share_beyond is None:
            continue
        ends = listed(
            f"{name} {quantity(end, shown_unit(unit), 4)}"
            for name, end in (("at least", limits.at_least), ("at most", limits.at_most))
            if math.isfinite(end)
        )
        if not fit.largest_excess:
            said.append(f"{output.name} keeps its limits ({ends}) throughout")
            continue
        side = "below" if fit.largest_excess < 0.0 else "above"
        largest = quantity(abs(fit.largest_excess), difference_unit(unit))
        said.append(
            f"{output.name} is outside its limits ({ends}) for {percent(fit.share_beyond)} of the time, by "
            f"{largest} {side} at most"
        )
    return said


def _begun(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _outliers(case: "Case", found: Calibration) -> list[str]:
    """Name the samples that a robust loss counts less, by output, and those that may be wrong."""
    said, measurement = [], case.measurement
    for k, output in enumerate(case.outputs):
        unit, largest = difference_unit(output.unit), found.outputs[output.name].largest
        if (loss := output.loss) is None:
            if largest is not None:
                # A correlation time and a robust loss exclude each other.
                is_free = not output.correlation_s
                said.append(_largest(output.name, largest, unit, may_have_loss=is_free))
            continue
        difference = measurement.differences(found.y[None], k)[0]
        n_beyond, worst = np.count_nonzero(np.abs(difference) > loss.scale), np.argmax(np.abs(difference))
        sentence = (
            f"{output.name} has the {loss.kind} loss with scale {quantity(loss.scale, unit)}: "
            f"{n_beyond:,} of {count(len(difference), 'sample')} differ by more and count less, "
            "none is left out"
        )
        if n_beyond:
            moment = moment_of(case, output, int(worst))
            sentence += f"; the largest, {quantity(float(difference[worst]), unit)}, at {moment}"
        said.append(sentence)
    return said


def _largest(name: str, sample: LargestSample, unit: str, *, may_have_loss: bool) -> str:
    """Name a sample that stands alone, and what to do about it."""
    far = "" if sample.times_median is None else f", {sample.times_median:,.0f} times the median difference"
    less = ', or let it count less with loss = "huber" for this output' * may_have_loss
    return (
        f"{name} differs most at {sample.at}, by {quantity(abs(sample.difference), unit)}{far}; "
        f"if that value is wrong, empty its cell{less}"
    )


def noise_sentence(noise: Noise, unit: str) -> str:
    """State the noise model.

    Args:
        noise: Kind and numbers.
        unit: Unit of a difference of the first output.
    """
    m, n = count(noise.n_samples, "sample"), count(noise.n_independent)
    size = f"{significant(noise.deviation)} {unit}".strip()
    if noise.kind == "sensor":
        worth = "all independent" if noise.n_independent == noise.n_samples else f"worth {n}"
        return (
            f"Noise model: the sensor's declared uncertainty, {size} as one standard deviation; {m}, {worth}."
        )
    if noise.kind == "white":
        return f"Noise model: white, {size} as the residuals scatter; {m}, all independent."
    if noise.n_independent > UNCORRELATED * noise.n_samples:
        return f"Noise model: {size} as the residuals scatter; they do not follow each other, {m} count."
    return (
        f"Noise model: {size} as the residuals scatter; they follow each other (first-order autoregressive), "
        f"so {m} are worth {n} independent."
    )


def uncertainty_sentences(found: Uncertainty, unit: str) -> list[str]:
    """Say plainly what the data determine and what they do not.

    Args:
        found: The uncertainty.
        unit: Unit of a difference of the first output.
    """
    noise, best, is_trusted = found.noise, found.sample.best_mse, found.sample.is_trusted
    said = [noise_sentence(noise, unit)]
    sensor = math.inf if found.sensor is None else found.sensor
    doubtful = misfit_threshold(sensor)
    if noise.kind == "sensor" and math.sqrt(best) < sensor:
        said[0] += f" The best fit differs by less, {quantity(math.sqrt(best), unit)} (RMS)."
    if noise.kind != "sensor" and doubtful is not None and best > doubtful:
        said[0] += (
            f" The best fit is off by {significant(math.sqrt(best) / sensor)} times the sensor's "
            "uncertainty: rather a failed fit, or a model that lacks something, than noise. All that follows "
            "takes it for noise."
        )
    if is_trusted:
        said += _known(found)
    (low, high), point = found.interval, found.point
    is_outside = (point < low) | (point > high)
    outside = [name for name, is_out in zip(found.parameters, is_outside, strict=True) if is_out]
    if found.has_prior and noise.kind != "sensor" and outside:
        said.append(
            f"The calibrated {listed(outside)} may lie outside: a calibration weighs priors by the sensor's "
            "uncertainty, and here the noise is as large as the residuals; --noise sensor weighs both alike."
        )
    if best < FITS_BETTER * found.mse:
        said.append(
            f"A simulated set fits better than the calibration: {significant(best)} instead of "
            f"{significant(found.mse)} {squared(unit)}; calibrate with --from-stored begins with it."
        )
    # What nothing below may be trusted without comes first.
    said.insert(len(said) if is_trusted else 0, _sample(found))
    return said


def _known(found: Uncertainty) -> list[str]:
    kinds = (
        ("determined", "The data determine {names}."),
        ("narrowed", "They narrow down {names}."),
        ("open", "They say next to nothing about {names}: any value in the bounds fits as well."),
        ("prior", "They leave {names} about as uncertain as the prior did."),
    )
    said = []
    for kind, text in kinds:
        if names := [name for name, one in found.parameters.items() if one.known == kind]:
            said.append(text.format(names=listed(names)))
        elif kind == "determined":
            said.append("The data determine no parameter on its own.")
    said += [f"{pair.in_words}." for pair in found.pairs]
    return said + [
        f"Near the calibrated point moving these together hardly changes any output: {direction} (shares of "
        "the ranges, rounded)."
        for direction in found.null_directions
    ]


def _sample(found: Uncertainty) -> str:
    """Say what the sample is worth and what it cost."""
    ledger, sample = found.ledger, found.sample
    cost = count(ledger.total, "model call")
    if ledger.by_equations:
        cost += "; the model's state equations gave the rest"
    else:
        cost += (
            f": {ledger.n_differences} differences, {ledger.n_taught} that taught the surrogate, "
            f"{ledger.n_sample} of the sample; {count(ledger.n_warm_start, 'simulation')} stored before "
            "taught it, too"
        )
    worth = (
        f"The sample of {count(sample.n, 'simulated parameter set')} is worth {sample.n_effective:.0f} of "
        f"equal weight ({cost})."
    )
    if not sample.is_trusted:
        worth += (
            " That is too few: the surrogate does not know the posterior yet, so no interval is given but "
            "the linearised ones, and bands are not to be trusted; go on with more --max-calls, and see "
            "whether a prior contradicts the data."
        )
    return worth


def mean_sentences(tuned: Sequence[TunedSize]) -> list[str]:
    """Say of which surrogates each mean is made, with the error of each."""
    said = []
    for one in tuned:
        name = f"{one.judged_by}/mae"
        if one.parts:
            errors = [significant(part.metrics.get(name)) for part in one.parts]
            parts = zip(one.parts, errors, strict=True)
            made_of = " + ".join(f"{part.share:.2f} × {part.name} ({error})" for part, error in parts)
            said.append(f"n_train {one.n_train}: MAE {significant(one.mae)} {one.unit} is that of {made_of}")
    return said


def choice_sentences(found: Choice, unit: str) -> list[str]:
    """Say which structure the data choose, and what that assumes.

    Args:
        found: The comparison.
        unit: Unit of a difference of the first output.
    """
    said = [
        f"Chosen: {found.chosen}; {found.reason}."
        if found.chosen
        else f"The data do not decide: {found.reason}."
    ]
    if not found.is_explained:
        said.append(
            "The residuals of the most probable structure are still autocorrelated: it too may lack "
            "something, and the comparison takes what it lacks for noise."
        )
    said.append(
        f"{noise_sentence(found.noise, unit)} It is that of {found.noise_of}, for all structures alike."
    )
    if by_process := [one.case for one in found.structures if not one.by_equations]:
        said.append(f"Of {listed(by_process)} a Gaussian process of the simulations stands for the model.")
    said.append(
        "Evidence depends on bounds and priors: a parameter that the data hardly need counts the more "
        "against a structure, the wider its bounds are."
    )
    return said


def profile_sentences(found: Profiles) -> list[str]:
    """Say which profiles stay within up to a bound, along which ridge, and how sure that is.

    Args:
        found: The profiles.
    """
    said = []
    for name, one in found.parameters.items():
        if any(one.at_bound):
            side = "upper" if one.at_bound[1] else "lower"
            where = "both bounds" if all(one.at_bound) else f"the {side} bound"
            ridge = f", while {listed(one.moves)} move with it" if one.moves else ""
            said.append(f"{name} fits up to {where}{ridge}.")
    who = "state equations" if found.by_equations else "a Gaussian process of the simulations"
    how = "confirm" if found.is_confirmed else "do not confirm"
    said.append(f"The profiles are of {who}; {count(found.n_calls, 'simulation')} at their ends {how} them.")
    said.append("They assume that the model is right and the noise is as above, and no normal distribution.")
    return said


def planned_sentences(found: Planned) -> list[str]:
    """Say which experiment would show most, and what that assumes.

    Args:
        found: The candidates.
    """
    best = found.candidates[0]
    if best.excluded:
        return ["No candidate may be made."]
    shrunk = percent(best.shrinks_to)
    said = [f"Best: {best.name}, {best.what}; intervals are expected to shrink to {shrunk} on average."]
    if best.own:
        said.append(f"It has values of its own of {listed(best.own)}, which are taken for unknown.")
    over = count(found.n_points, "equally good parameter set")
    where = "at the calibrated point" if found.n_points == 1 or not best.by_equations else f"over {over}"
    said.append(
        f"Expected {where}, by {count(found.n_calls, 'simulation')}, if the model is right, noise stays as "
        "it is, and residuals are linear within the intervals."
    )
    if found.error is not None:
        said.append(
            f"Its equations and a simulation differ by {significant(found.error, 2)} uncertainties at most."
        )
    return said
