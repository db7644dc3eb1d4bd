"""Tables of calibrations: what each came to, and the parameters that it found."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from simulation.parameters import ParameterSpace
from studies.report.data import ReportData
from studies.report.records import CalibrationRecord
from studies.report.tables import Cell, Column, Table
from studies.report.uncertainty_record import HOW_KNOWN, UncertaintyRecord
from studies.report.wording import (
    bound_at,
    count,
    declared,
    difference_unit,
    percent,
    shown_unit,
    significant,
)

Reader = Callable[[CalibrationRecord], Cell]
_CALIBRATIONS_TITLE = (
    "Calibrations. MSE surrogate and MSE screened are both at the screened point: by the surrogate and by "
    "the model. The paper's count leaves out validation and test sets; no count has simulations stored before"
)


def calibrations_table(data: ReportData) -> Table:
    """Tabulate the calibrations, one row each (Table 4 of the paper, with all simulations counted beside)."""
    unit, mse_unit = difference_unit(data.measurement.units[0]), data.measurement.mse_unit
    all_of_them = data.by_size
    with_surrogate: list[tuple[Column, Reader]] = [
        (Column("n_train", "training set", "", count), lambda c: c.n_train),
        (Column("test_mae", "test MAE", unit, _two), lambda c: c.test_mae),
        (Column("test_p90", "test P90", unit, _two, 3), lambda c: c.test_p90),
        (Column("mse_surrogate", "MSE surrogate", mse_unit, spare=2), lambda c: c.mse_surrogate),
        (Column("mse_screened", "MSE screened", mse_unit), lambda c: c.mse_screened),
        (Column("screening_gap", "gap", mse_unit, spare=4), lambda c: c.screening_gap),
        (Column("n_polish", "polish calls", "", count), lambda c: c.n_polish),
    ]
    columns: list[tuple[Column, Reader]] = [
        *(with_surrogate if any(not c.is_adaptive for c in all_of_them) else []),
        (Column("mse_polished", "final MSE", mse_unit), lambda c: c.mse_polished),
        (Column("calls_paper", "calls, paper's count", "", count), lambda c: c.calls_paper),
        (Column("total_calls", "calls, all", "", count, 1), lambda c: c.total_calls),
        *(
            (Column(f"calls_to_{mse:g}", f"calls to {mse:g}", "", count), partial(_calls_to, mse=mse))
            for mse in (reference.mse for reference in data.references if reference.is_target)
        ),
        (Column("n_known", "stored before", "", count, 6), lambda c: c.n_known),
        (Column("wall_s", "time", "s", _two, 5), lambda c: c.wall_s),
        (Column("method", "method", spare=5), lambda c: c.method),
    ]
    rows = tuple(tuple(read(c) for _, read in columns) for c in all_of_them)
    emphasized = all_of_them.index(data.headline) if data.headline and len(rows) > 1 else None
    return Table("calibrations", _CALIBRATIONS_TITLE, tuple(one for one, _ in columns), rows, emphasized)


def _calls_to(c: CalibrationRecord, mse: float) -> int | None:
    return c.calls_to(mse)


def _two(value: float) -> str:
    return significant(value, 2)


def parameters_table(parameters: ParameterSpace, calibration: CalibrationRecord) -> Table:
    """Tabulate the parameters of one calibration with their bounds."""
    units = [one.unit for one in parameters.parameters]
    screened = [] if calibration.is_adaptive else [calibration.theta_screened.tolist()]
    known = [calibration.knowledge] if calibration.knowledge else []
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
    )
    values = zip(
        parameters.names, map(shown_unit, units), [one.estimate for one in parameters.parameters],
        parameters.lower.tolist(), parameters.upper.tolist(), *screened,
        calibration.theta_polished.tolist(), at_bound(parameters, calibration), *known, strict=True,
    )  # fmt: skip
    how = f"from {count(calibration.n_train, 'training simulation')}"
    title = f"Parameters, calibrated {'adaptively' if calibration.is_adaptive else how}"
    return Table(f"parameters-{calibration.name}", title, columns, tuple(values))


def _four(value: float) -> str:
    return significant(value, 4)


def intervals_table(box: ParameterSpace, record: UncertaintyRecord) -> Table:
    """Tabulate the intervals, one row per parameter."""
    r = record
    units = [shown_unit(one.unit) for one in box.parameters]
    share = percent(r.level)
    columns = (
        Column("name", "parameter"),
        Column("unit", "unit"),
        Column("calibrated", "calibrated"),
        Column("low", f"{share} from"),
        Column("high", "to"),
        Column("linear_low", "linearised from", spare=2),
        Column("linear_high", "to", spare=2),
        Column("lower", "lower bound", "", declared, 1),
        Column("upper", "upper bound", "", declared, 1),
        Column("known", "by the data"),
    )
    rows = tuple(
        zip(
            r.names, units, r.calibrated.tolist(), *r.interval.tolist(),
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


def at_bound(parameters: ParameterSpace, calibration: CalibrationRecord) -> tuple[str, ...]:
    """Say for every parameter whether its polished value lies at a bound: "lower", "upper" or nothing."""
    return tuple(map(bound_at, parameters.to_unit(calibration.theta_polished).tolist()))
