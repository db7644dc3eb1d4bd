"""The uncertainty of a calibration on the page: its table, its captions, its pictures."""

from __future__ import annotations

from studies.report.records import MeasuredSeries, ParameterBox
from studies.report.tables import Column, Table
from studies.report.uncertainty import HOW_KNOWN, UncertaintyRecord
from studies.report.wording import count, declared, listed, percent, shown_unit


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


def band_caption(measured: MeasuredSeries, record: UncertaintyRecord) -> str:
    """Say what lies in the bands."""
    parts = [
        f"{percent(share)} of the measured values of {name}"
        for name, share in zip(measured.output_names, record.share_predictive, strict=True)
    ]
    warning = "" if record.is_trusted else "Too few calls, not to be trusted yet. "
    return (
        f"{warning}Dark: where {percent(record.level)} of the equally good parameter sets bring the "
        f"simulation. Light: where {percent(record.level)} of the measured values should lie, noise "
        f"included; {listed(parts)} do{_fixed(record)}."
    )


def interval_caption(record: UncertaintyRecord) -> str:
    """Say how to read the intervals."""
    if not record.is_trusted:
        return (
            f"Each from its lower to its upper bound: the linearised {percent(record.level)} interval and "
            f"the calibrated value. Too few calls to say more{_fixed(record)}."
        )
    parts = [f"{len(record.called(kind))} {word}" for kind, word in HOW_KNOWN.items() if record.called(kind)]
    return (
        f"Each from its lower to its upper bound: density and {percent(record.level)} interval of the "
        f"posterior, the linearised interval as a thin line, the calibrated value as a mark. Of "
        f"{count(len(record.names), 'parameter')}, {listed(parts)}{_fixed(record)}."
    )


def pairs_caption(record: UncertaintyRecord) -> str:
    """Say what the pairs show."""
    said = "; ".join(pair.sentence for pair in record.pairs[:3])
    said = said or "No two compensate each other"
    return f"Equally good parameter sets, in the case's scales. {said}{_fixed(record)}."


def _fixed(record: UncertaintyRecord) -> str:
    if not record.n_fixed:
        return ""
    are = "is" if record.n_fixed == 1 else "are"
    return f"; {count(record.n_fixed, 'fixed parameter')} {are} taken as right"
