"""The uncertainty of a calibration on the page: its table, its captions, its pictures."""

from __future__ import annotations

from studies.report.records import MeasuredSeries, ParameterBox
from studies.report.tables import Column, Table
from studies.report.uncertainty import HOW_KNOWN, UncertaintyRecord
from studies.report.wording import count, declared, listed, percent, shown_unit, significant


def intervals_table(box: ParameterBox, record: UncertaintyRecord) -> Table:
    """Tabulate the intervals, one row per parameter."""
    r = record
    share = percent(r.level)
    columns = (
        Column("name", "parameter"),
        Column("unit", "unit"),
        Column("calibrated", "calibrated", "", _four),
        Column("low", f"{share} from", "", _four),
        Column("high", "to", "", _four),
        Column("linear_low", "linearised from", "", _four),
        Column("linear_high", "to", "", _four),
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
    )


def band_caption(measured: MeasuredSeries, record: UncertaintyRecord) -> str:
    """Say what lies in the bands."""
    parts = [
        f"{percent(share)} of the measured values of {name}"
        for name, share in zip(measured.output_names, record.share_predictive, strict=True)
    ]
    return (
        f"Dark: where {percent(record.level)} of the equally good parameter sets bring the simulation. "
        f"Light: where {percent(record.level)} of the measured values should lie, noise included; "
        f"{listed(parts)} do."
    )


def interval_caption(record: UncertaintyRecord) -> str:
    """Say how to read the intervals."""
    parts = [f"{len(record.called(kind))} {word}" for kind, word in HOW_KNOWN.items() if record.called(kind)]
    return (
        f"Each from its lower to its upper bound: density and {percent(record.level)} interval of the "
        f"posterior, the linearised interval as a thin line, the calibrated value as a mark. Of "
        f"{count(len(record.names), 'parameter')}, {listed(parts)}."
    )


def pairs_caption(record: UncertaintyRecord) -> str:
    """Say what the pairs show."""
    said = "; ".join(pair.sentence for pair in record.pairs[:3])
    return f"Equally good parameter sets, in the case's scales. {said or 'No two compensate each other'}."


def _four(value: float) -> str:
    return significant(value, 4)
