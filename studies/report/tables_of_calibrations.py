"""Tables of calibrations: what each came to, and the parameters that it found."""

from __future__ import annotations

from studies.report.data import Reference, ReportData
from studies.report.findings import at_bound
from studies.report.records import CalibrationRecord, ParameterBox
from studies.report.tables import Column, Table
from studies.report.uncertainty import HOW_KNOWN, UncertaintyRecord
from studies.report.wording import (
    count,
    declared,
    difference_unit,
    percent,
    shown_unit,
    significant,
    squared,
)

_CALIBRATIONS_TITLE = (
    "Calibrations. MSE surrogate and MSE screened are both at the screened point: "
    "by the surrogate and by the model; the paper's count leaves out validation and test sets"
)


def calibrations_table(data: ReportData) -> Table:
    """Tabulate the calibrations, one row each (Table 4 of the paper, with honest counts)."""
    unit = difference_unit(data.measurement.units[0])
    mse_unit = squared(unit)
    targets = [reference for reference in data.references if reference.is_target]
    p = len(data.parameters.names)
    if all(c.is_adaptive for c in data.by_size):
        return _adaptive_table(data, targets)
    columns = (
        Column("n_train", "training set", "", count),
        Column("test_mae", "test MAE", unit, _two),
        Column("test_p90", "test P90", unit, _two),
        Column("mse_surrogate", "MSE surrogate", mse_unit),
        Column("mse_screened", "MSE screened", mse_unit),
        Column("screening_gap", "gap", mse_unit),
        Column("n_polish", "polish calls", "", count),
        Column("mse_polished", "final MSE", mse_unit),
        Column("calls_paper", "calls, paper's count", "", count),
        Column("calls_honest", "calls, all", "", count),
        *(Column(f"calls_to_{target.mse:g}", f"calls to {target.mse:g}", "", count) for target in targets),
        Column("wall_s", "time", "s", _two),
        Column("method", "method"),
        Column("n_free", "parameters calibrated", "", count),
    )
    rows = tuple(
        (
            c.n_train, c.test_mae, c.test_p90, c.mse_surrogate, c.mse_screened, c.screening_gap,
            c.n_polish, c.mse_polished, c.calls_paper, c.calls_honest,
            *(c.calls_to(target.mse) for target in targets), c.wall_s, c.method, c.n_free or p,
        )
        for c in data.by_size
    )  # fmt: skip
    headline = data.headline
    emphasized = data.by_size.index(headline) if headline else None
    return Table("calibrations", _CALIBRATIONS_TITLE, columns, rows, emphasized)


def _adaptive_table(data: ReportData, targets: list[Reference]) -> Table:
    """Tabulate calibrations that know no training set."""
    p, is_known = len(data.parameters.names), any(c.n_known for c in data.by_size)
    columns = (
        Column("method", "method"),
        Column("n_free", "parameters calibrated", "", count),
        *([Column("n_known", "stored before", "", count)] if is_known else []),
        Column("calls_honest", "model calls", "", count),
        *(Column(f"calls_to_{target.mse:g}", f"calls to {target.mse:g}", "", count) for target in targets),
        Column("mse_polished", "final MSE", squared(difference_unit(data.measurement.units[0]))),
        Column("wall_s", "time", "s", _two),
    )
    rows = tuple(
        (
            c.method, c.n_free or p, *([c.n_known] if is_known else []), c.calls_honest,
            *(c.calls_to(target.mse) for target in targets),
            c.mse_polished, c.wall_s,
        )
        for c in data.by_size
    )  # fmt: skip
    title = "Calibrations; every simulation counts" + (" that was not stored before" if is_known else "")
    return Table("calibrations", title, columns, rows)


def _two(value: float) -> str:
    return significant(value, 2)


def parameters_table(parameters: ParameterBox, calibration: CalibrationRecord) -> Table:
    """Tabulate the parameters of one calibration with their bounds."""
    screened = [] if calibration.is_adaptive else [calibration.theta_screened.tolist()]
    known = [calibration.knowledge] if calibration.knowledge else []
    shares: list[tuple[Column, list[float | None]]] = []
    if (r := calibration.restriction) is not None:
        shown = (("share", "relevance", r.shares), ("gain_if_free", "gain if free", r.gain_alone))
        shares = [
            (Column(key, title, "", percent), [of.get(name) for name in parameters.names])
            for key, title, of in shown
        ]
    columns = (
        Column("name", "parameter"),
        Column("unit", "unit"),
        Column("estimate", "estimate", "", declared),
        Column("lower", "lower bound", "", declared),
        Column("upper", "upper bound", "", declared),
        *(Column("screened", "screened", "", _four) for _ in screened),
        Column(calibration.final, calibration.final, "", _four),
        Column("at_bound", "at a bound"),
        *(Column("knowledge", "known before") for _ in known),
        *(column for column, _ in shares),
    )
    values = zip(
        parameters.names, map(shown_unit, parameters.units), parameters.estimate.tolist(),
        parameters.lower.tolist(), parameters.upper.tolist(), *screened,
        calibration.theta_polished.tolist(), at_bound(parameters, calibration), *known,
        *(cells for _, cells in shares), strict=True,
    )  # fmt: skip
    how = f"from {count(calibration.n_train, 'training simulation')}"
    title = f"Parameters, calibrated {'adaptively' if calibration.is_adaptive else how}"
    return Table(f"parameters-{calibration.name}", title, columns, tuple(values))


def _four(value: float) -> str:
    return significant(value, 4)


def intervals_table(box: ParameterBox, record: UncertaintyRecord) -> Table:
    """Tabulate the intervals, one row per parameter that was judged."""
    r, box = record, box.of(record.names)
    share = percent(r.level)
    columns = (
        Column("name", "parameter"),
        Column("unit", "unit"),
        Column("calibrated", "calibrated"),
        Column("low", f"{share} from"),
        Column("high", "to"),
        Column("linear_low", "linearised from"),
        Column("linear_high", "to"),
        Column("lower", "lower bound", "", declared),
        Column("upper", "upper bound", "", declared),
        Column("known", "by the data"),
    )
    rows = tuple(
        zip(
            r.names, map(shown_unit, box.units), r.calibrated.tolist(), *r.interval.tolist(),
            *r.linear.tolist(), box.lower.tolist(), box.upper.tolist(), [HOW_KNOWN[k] for k in r.known],
            strict=True,
        )
    )  # fmt: skip
    return Table(
        f"uncertainty-{r.calibration}",
        f"{share} intervals of the parameters ({r.calibration})",
        columns,
        rows,
        digits=r.digits,
    )
