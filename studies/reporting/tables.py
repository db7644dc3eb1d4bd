"""The tables of results, for the terminal and the page alike; every cell is written here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from simulation.parameters import ParameterSpace
from studies.blocks import Column, Table, number
from studies.results.best_mean import shortened_model
from studies.results.choice import Choice
from studies.results.declaration import CROSS_VALIDATED
from studies.results.outcome import Outcome
from studies.results.planned import Planned
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, Held, Screened, TunedSize, Uncertainty
from studies.words.wording import (
    MISSING,
    bound_at,
    cell_text,
    compared_in,
    count,
    declared,
    difference_unit,
    digits_between,
    percent,
    percent_of_seeds,
    shown_unit,
    significant,
    square_of,
)

if TYPE_CHECKING:  # numba and FMPy, which `studies best` does without
    from simulation.case import Case
    from studies.calibration.sobol import SobolIndices

FAR = 2.0
"""So many standard deviations from what was known, the data contradict it."""
HOW_KNOWN = {
    "determined": "determined",
    "narrowed": "narrowed",
    "open": "not determined",
    "prior": "as known before",
    "unsure": "too few calls",
}
Calibrations = tuple[Outcome[Calibration], ...]
Reader = Callable[[Outcome[Calibration]], str]
Columns = Sequence[tuple[Column, Reader]]


def best_of(calibrations: Calibrations) -> Outcome[Calibration] | None:
    """Return the calibration of lowest MSE, of equals the cheapest; None without any."""
    return min(calibrations, key=lambda one: (one.result.mse, one.result.n_calls_paper), default=None)


def tuning_table(tuned: Sequence[TunedSize]) -> Table | None:
    """Tabulate the best surrogate of each training-set size beside PCA + GP; None where nothing was tuned."""
    found = [one for one in sorted(tuned, key=lambda one: one.n_train) if one.trial is not None]
    if not found:
        return None
    unit, names = found[0].unit, tuple(dict.fromkeys(name for one in found for name in one.params))
    errors, judged_by = dict.fromkeys(name for one in found for name in one.metrics), found[0].judged_by
    outputs = [name for name in errors if name.startswith(f"{judged_by}/mae_")]
    has_sets = not found[0].folds
    columns = (
        number("n_train"),
        Column("model"),
        *(number(name) for name in names),
        number("MAE", unit),
        number("P90", unit),
        *(Column(name.removeprefix(f"{judged_by}/").replace("_", " ", 1), True) for name in outputs),
        number("gain"),
        number("PCA+GP MAE", unit, 1),
        number("PCA+GP P90", unit, 2),
        number("complete", spare=3),
        number("pruned", spare=3),
        number("failed", spare=4),
        *([number("MAE val", unit, 5)] if has_sets else []),
    )
    rows = [
        [
            count(one.n_train),
            one.short_model,
            *(cell_text(one.params.get(name)) for name in names),
            significant(one.mae),
            significant(one.p90),
            *(significant(one.metrics.get(name)) for name in outputs),
            percent_of_seeds(one.gain, one.gain_deviation),
            significant(one.baseline.get(f"{judged_by}/mae")),
            significant(one.baseline.get(f"{judged_by}/p90")),
            *(count(n) for n in (one.n_complete, one.n_pruned, one.n_failed)),
            *([significant(one.metrics["val/mae"])] if has_sets else []),
        ]
        for one in found
    ]
    how = "validation error (MAE, P90: test set" if has_sets else "cross-validated error (MAE, P90"
    title = f"Best surrogate per training-set size by {how}; gain over default)"
    return Table(title, columns, rows)


def importances_table(importances: Mapping[int, Mapping[str, float]]) -> Table:
    """Tabulate how much each hyperparameter decides the validation error, a row per training-set size.

    Args:
        importances: Parts that sum to 1, by size and name; a size with too few trials has none. [1]
    """
    names = tuple(dict.fromkeys(name for one in importances.values() for name in one))
    rows = [[count(n), *(percent(one.get(name)) for name in names)] for n, one in importances.items()]
    columns = (number("n_train"), *(number(name) for name in names))
    return Table("Importance of each hyperparameter by PED-ANOVA, complete and pruned trials", columns, rows)


def sensitivity_table(found: "SobolIndices") -> Table:
    """Tabulate Sobol indices averaged over time."""
    from studies.calibration.sobol import mean_over_time

    titles = ("first order", "±", "total order", "±")
    columns = (Column("output"), Column("parameter"), *(number(title) for title in titles))
    indices = (found.first_order, found.first_order_ci, found.total_order, found.total_order_ci)
    means = [mean_over_time(one) for one in indices]
    rows = [
        [output, found.names[i], *(_index(float(mean[k, i])) for mean in means)]
        for k, output in enumerate(found.output_names)
        for i in found.order(k)
    ]
    return Table(f"Sobol indices, averaged over time, from {asked_of(found)}", columns, rows)


def asked_of(found: "SobolIndices") -> str:
    """Say what Sobol indices are estimated from."""
    if found.n_train is None:
        return f"{count(found.n_calls, 'simulation')} of the FMU"
    return f"the surrogate of n_train = {found.n_train}, its own error in the ±"


def _index(value: float) -> str:
    return MISSING if np.isnan(value) else f"{value:.3f}"


def calibrations_table(case: "Case", calibrations: Calibrations) -> Table:
    """Tabulate calibrations, one row each (Table 4 of the paper, with all simulations counted beside)."""
    unit, mse_unit = difference_unit(case.outputs[0].unit), square_of(case.outputs[0].unit)
    error = case.measurement.error_name
    screened = [one.result.screening for one in calibrations if one.result.screening is not None]
    is_crossed = any(f"{CROSS_VALIDATED}/mae" in one.errors for one in screened)
    judged, judged_by = ("CV", CROSS_VALIDATED) if is_crossed else ("test", "test")
    with_surrogate: Columns = [
        (number("training set"), lambda one: count(one.result.n_train)),
        *([(Column("model"), _model)] if any(one.model for one in screened) else []),
        (number(f"{judged} MAE", unit), _screened(lambda found: found.errors.get(f"{judged_by}/mae"), 2)),
        (number(f"{judged} P90", unit, 3), _screened(lambda found: found.errors.get(f"{judged_by}/p90"), 2)),
        (number(f"{error} surrogate", mse_unit, 2), _screened(lambda found: found.mse_surrogate)),
        (number(f"{error} screened", mse_unit), _screened(lambda found: found.mse)),
        (number("gap", mse_unit, 4), _screened(lambda found: found.gap)),
        (number("polish calls"), lambda one: count(one.result.ledger["n_polish"])),
    ]
    has_surrogate = any(not one.result.is_adaptive for one in calibrations)
    columns: Columns = [
        *(with_surrogate if has_surrogate else []),
        (number(f"final {error}", mse_unit), lambda one: significant(one.result.mse)),
        (number("calls, paper's count"), lambda one: count(one.result.n_calls_paper)),
        (number("calls, all", spare=1), lambda one: count(one.result.n_calls)),
        *(
            (number(f"calls to {known.mse:g}"), _calls_to(known.mse))
            for known in case.references
            if known.is_target
        ),
        (number("stored before", spare=6), lambda one: count(one.result.n_warm_start or 0)),
        (number("time [s]", spare=5), lambda one: significant(one.wall_s, 2)),
        (Column("method", False, 5), lambda one: one.result.method),
    ]
    rows = [[read(one) for _, read in columns] for one in calibrations]
    best = best_of(calibrations)
    emphasized = calibrations.index(best) if best is not None and len(rows) > 1 else None
    title = (
        f"Calibrations. {error} surrogate and {error} screened are both at the screened point: by the "
        "surrogate and by the model. The paper's count leaves out validation and test sets; no count has "
        "simulations stored before"
    )
    return Table(title, [one for one, _ in columns], rows, emphasized=emphasized)


def _model(one: Outcome[Calibration]) -> str:
    return MISSING if one.result.screening is None else shortened_model(one.result.screening.model) or MISSING


def _screened(read: Callable[[Screened], float | None], digits: int = 3) -> Reader:
    """Return what reads the screening of a calibration; an adaptive one has none."""

    def text(one: Outcome[Calibration]) -> str:
        return MISSING if one.result.screening is None else significant(read(one.result.screening), digits)

    return text


def _calls_to(mse: float) -> Reader:
    return lambda one: cell_text(one.result.history.calls_to(mse))


def parameters_table(case: "Case", found: Calibration) -> Table:
    """Tabulate the parameters of one calibration with their bounds, and what is to be said of each."""
    screened, space = found.screening, case.parameter_space
    columns = (
        Column("parameter"),
        Column("unit"),
        number("estimate"),
        *([] if screened is None else [number("screened", spare=2)]),
        number(found.final),
        number("lower bound", spare=1),
        number("upper bound", spare=1),
        Column(""),
    )
    places = space.to_unit(found.point)
    in_box = replace(space, constraints=(), sums=()).to_unit(found.point)
    rows = [
        [
            one.name,
            shown_unit(one.unit),
            _six(one.estimate),
            *([] if screened is None else [_six(screened.theta[one.name])]),
            _six(found.theta[one.name]),
            _six(one.lower),
            _six(one.upper),
            _note(found, one.name, float(u), is_constrained=bound_at(u) != bound_at(box)),
        ]
        for one, u, box in zip(space.parameters, places, in_box, strict=True)
    ]
    how = "adaptively" if found.is_adaptive else f"from {count(found.n_train, 'training simulation')}"
    return Table(f"Parameters, calibrated {how}", columns, rows)


def _six(value: float | None) -> str:
    """Write a number as it can be typed into a case file."""
    return MISSING if value is None else f"{value:.6g}"


def _note(found: Calibration, name: str, u: float, *, is_constrained: bool) -> str:
    """Say what judges a calibrated value that lies at `u` between its bounds, or those of a constraint."""
    judged, note = found.determined_by_data, ""
    if judged is not None and name in judged.open:
        note = f"not determined: ±{percent(judged.spread[name])} of the range"
    if name in found.without_effect:
        # A bound that it happens to lie at says nothing.
        note = "the error hardly depends on it"
    elif bound := bound_at(u):
        # What others compensate goes to any bound: wider ones would not end that.
        place = "at a constraint" if is_constrained else f"at the {bound} bound"
        note = f"{place}; {note}" if note else place + ": widen it?" * (not is_constrained)
    known = None if found.prior is None else found.prior.parameters.get(name)
    if known is None:
        return note
    before = f"known before: {_known(known)}, moved by {known.moved_deviations:+.2f} deviations"
    if abs(known.moved_deviations) > FAR:
        before += ": the data contradict it"
    return "; ".join(filter(None, (note, before)))


def _known(held: Held) -> str:
    """Say what was known of a parameter, e.g. `0.7 ×/÷ 1.5` or `290 ± 2`."""
    if held.within_factor is not None:
        return f"{held.about:.4g} ×/÷ {held.within_factor:.4g}"
    return f"{held.about:.4g} ± {held.within:.4g}"


def validation_table(case: "Case", found: Calibration) -> Table | None:
    """Tabulate the parameter sets on the validation period, one row per set and output; None without one."""
    if found.validation is None or case.validation is None:
        return None
    unit = square_of(case.outputs[0].unit)
    columns = (
        Column("parameters"),
        number(f"{found.error_name}, calibrated part", unit),
        number(f"{found.error_name}, validation", unit),
        Column("output"),
        Column("unit"),
        number("samples", spare=4),
        number("RMSE"),
        number("bias", spare=1),
        number("CV(RMSE)", spare=3),
        number("NMBE", spare=3),
        number("NRMSE", spare=3),
    )
    rows: list[list[str]] = []
    for name, point in found.validation.points.items():
        errors = [significant(point.mse_window), significant(point.mse)]
        if not point.outputs:
            rows.append([name, *errors, "failed", "", *[MISSING] * 6])
        for k, (output, fit) in enumerate(point.outputs.items()):
            rows.append(
                [
                    name,
                    *(errors if k == 0 else [MISSING] * 2),
                    output,
                    difference_unit(case.validation.outputs[k].unit),
                    count(fit.n_samples),
                    significant(fit.rmse),
                    significant(fit.bias),
                    percent(fit.cv_rmse),
                    percent(fit.nmbe),
                    percent(fit.nrmse),
                ]
            )
    title = (
        f"Validation {compared_in(case.validation)}, which the calibration did not see (bias: "
        "simulated minus measured). No count of calls includes its simulations"
    )
    return Table(title, columns, rows)


def intervals_table(space: ParameterSpace, found: Uncertainty) -> Table:
    """Tabulate the intervals, one row per parameter; no two ends of an interval look equal."""
    share = percent(found.level)
    columns = (
        Column("parameter"),
        Column("unit"),
        number("calibrated"),
        number(f"{share} from"),
        number("to"),
        number("linearised from", spare=2),
        number("to", spare=2),
        number("lower bound", spare=1),
        number("upper bound", spare=1),
        Column("by the data"),
    )
    rows = []
    for one, known, interval in zip(
        space.parameters, found.parameters.values(), found.interval.T.tolist(), strict=True
    ):
        ends = [*interval, *known.linear]
        pairs = [pair for pair in (interval, known.linear) if np.isfinite(pair[0])]
        digits = max(digits_between(low, high, least=4) for low, high in pairs)
        rows.append(
            [
                one.name,
                shown_unit(one.unit),
                *(significant(value, digits) for value in (known.calibrated, *ends)),
                declared(one.lower),
                declared(one.upper),
                HOW_KNOWN[known.known if found.sample.is_trusted else "unsure"],
            ]
        )
    title = f"{share} intervals of the parameters ({found.calibration})"
    return Table(title, columns, rows)


def structures_table(found: Choice, unit: str) -> Table:
    """Tabulate compared structures, the chosen one pointed out.

    Args:
        found: The comparison.
        unit: Unit of the first output's differences.
    """
    square = square_of(unit)
    columns = (
        Column("structure"), number("parameters"), number("determined", spare=1), number("error", square),
        number("AIC", spare=2), number("BIC"), number("log evidence"), number("probability"),
        number("left-out error", square), number("white", spare=2), Column("larger", spare=3),
        number("p", spare=3), number("calls", spare=1),
    )  # fmt: skip
    least = [min(getattr(one, key) for one in found.structures) for key in ("aic", "bic")]
    rows = [
        [
            one.case, one.n_parameters, len(one.determined), significant(one.mse, 4),
            *(f"+{value - low:.1f}" for value, low in zip((one.aic, one.bic), least, strict=True)),
            f"{one.log_evidence:.1f}", percent(one.probability), significant(one.left_out_mse, 4),
            significant(one.white, 2), one.larger or MISSING, significant(one.ratio_p, 2),
            one.n_calls + one.n_judged,
        ]
        for one in found.structures
    ]  # fmt: skip
    names = [one.case for one in found.structures]
    title = f"Structures on one measurement (AIC, BIC: above the least; left out: {found.blocks})"
    return Table(title, columns, rows, names.index(found.chosen) if found.chosen else None)


def profiles_table(space: ParameterSpace, found: Profiles, posterior: Uncertainty) -> Table:
    """Tabulate the intervals of profiles beside those of the posterior.

    Args:
        space: The parameters.
        found: The profiles.
        posterior: The uncertainty that they belong to.
    """
    share = percent(found.level)
    columns = (
        Column("parameter"), Column("unit"), number(f"profile {share} from"), number("to"),
        number("posterior from", spare=1), number("to", spare=1), number("rise by simulation", spare=2),
        number("at both ends", spare=2), Column("moves with", spare=1),
    )  # fmt: skip
    rows = []
    for one, interval in zip(space.parameters, posterior.interval.T.tolist(), strict=True):
        its = found.parameters[one.name]
        digits = digits_between(*its.interval, least=4)
        ends = [significant(value, digits) for value in (*its.interval, *interval)]
        ends[:2] = [f"{end}{' (bound)' * is_open}" for end, is_open in zip(ends, its.at_bound, strict=False)]
        rises = (significant(value, 2) for value in its.rise)
        rows.append([one.name, shown_unit(one.unit), *ends, *rises, ", ".join(its.moves) or MISSING])
    title = f"Profile likelihoods: {share} where −2 log L rises by {significant(found.limit)}"
    return Table(title, columns, rows)


def planned_table(found: Planned) -> Table:
    """Tabulate candidates for the next experiment, the best first."""
    columns = (
        Column("candidate"), Column("what", spare=1), number("days"), number("intervals shrink to"),
        number(found.criterion, spare=2), Column("would determine"), number("calls", spare=2),
    )  # fmt: skip
    rows = [
        [
            one.name, one.what, significant(one.days), percent(one.shrinks_to), significant(one.merit, 4),
            one.excluded or ", ".join(one.determines) or MISSING, one.n_calls,
        ]
        for one in found.candidates
    ]  # fmt: skip
    title = "What the next experiment would show, the best first"
    return Table(title, columns, rows, None if found.candidates[0].excluded else 0)
