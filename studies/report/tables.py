"""Tables of results, each written as Markdown, CSV and HTML from the same cells."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulation.time_unit import period_text
from studies.report.data import ReportData
from studies.report.records import CalibrationRecord
from studies.report.records_tuning import TunedSize
from studies.report.validation import ValidationRecord
from studies.report.wording import (
    MISSING,
    count,
    difference_unit,
    percent,
    significant,
)
from studies.sobol import mean_over_time

Cell = float | int | str | None


@dataclass(frozen=True)
class Column:
    """One column: its key in files, its title for readers, its unit, and how a cell is written.

    In a narrow terminal columns with a larger `spare` are left out first; 0 is always shown.
    """

    key: str
    title: str
    unit: str = ""
    write: Callable[[float], str] = significant
    spare: int = 0

    def text(self, cell: Cell, digits: int = 3) -> str:
        """Write one cell for a reader.

        Args:
            cell: What stands there.
            digits: Digits of a number that the column does not write in a way of its own.
        """
        if cell is None or isinstance(cell, str):
            return MISSING if cell is None else cell
        if self.write is not significant:
            return self.write(cell)
        return count(cell) if isinstance(cell, int) else significant(cell, digits)


@dataclass(frozen=True)
class Table:
    """A table with its cells as plain values.

    Attributes:
        name: File name without ending.
        title: For readers.
        columns: What stands where.
        rows: One cell per column each.
        emphasized: Position of the row to point out, if any.
        digits: Significant digits of each row's numbers, where rows differ in that.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    emphasized: int | None = None
    digits: tuple[int, ...] = ()

    def records(self) -> list[dict[str, Cell]]:
        """Return the rows as dictionaries of plain values; what is not finite becomes None."""
        keys = [column.key for column in self.columns]
        return [dict(zip(keys, map(_plain, row), strict=True)) for row in self.rows]

    def to_csv(self) -> str:
        """Write the cells in full precision; an unknown or infinite one is left empty."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([f"{c.key} [{c.unit}]" if c.unit else c.key for c in self.columns])
        for row in self.rows:
            writer.writerow(["" if (cell := _plain(value)) is None else cell for value in row])
        return text.getvalue()

    def texts(self) -> list[list[str]]:
        """Write all cells for a reader."""
        digits = self.digits or (3,) * len(self.rows)
        return [
            [column.text(cell, n) for column, cell in zip(self.columns, row, strict=True)]
            for row, n in zip(self.rows, digits, strict=True)
        ]

    def is_numeric(self, column: int) -> bool:
        """Return whether a column holds numbers alone."""
        return not any(isinstance(row[column], str) for row in self.rows)


def _plain(cell: Cell) -> Cell:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell


def tuning_table(tuned: Sequence[TunedSize]) -> Table | None:
    """Tabulate the best surrogate of each training-set size beside PCA + GP; None where nothing was tuned."""
    found = [one for one in sorted(tuned, key=lambda one: one.n_train) if one.trial is not None]
    if not found:
        return None
    unit, names = found[0].unit, tuple(dict.fromkeys(name for one in found for name in one.params))
    errors = dict.fromkeys(name for one in found for name in one.metrics)
    outputs = [name for name in errors if name.startswith("test/mae_")]
    columns = (
        Column("n_train", "n_train", "", count),
        *(Column(name, name) for name in names),
        Column("test_mae", "MAE", unit),
        Column("test_p90", "P90", unit),
        *(
            Column(name.replace("/", "_"), name.removeprefix("test/").replace("_", " ", 1))
            for name in outputs
        ),
        Column("gain", "gain", "", percent),
        Column("pca_gp_test_mae", "PCA+GP MAE", unit, spare=1),
        Column("pca_gp_test_p90", "PCA+GP P90", unit, spare=2),
        Column("n_complete", "complete", "", count, 3),
        Column("n_pruned", "pruned", "", count, 3),
        Column("n_failed", "failed", "", count, 4),
        Column("validation_mae", "MAE val", unit, spare=5),
    )
    rows = tuple(
        (
            one.n_train,
            *(one.params.get(name) for name in names),
            one.mae,
            one.p90,
            *(one.metrics.get(name) for name in outputs),
            one.gain,
            one.baseline.get("test/mae"),
            one.baseline.get("test/p90"),
            one.n_complete,
            one.n_pruned,
            one.n_failed,
            one.metrics["val/mae"],
        )
        for one in found
    )
    title = "Best surrogate per training-set size by validation error (MAE, P90: test set; gain over default)"
    return Table("tuning", title, columns, rows)


def sensitivity_table(data: ReportData) -> Table | None:
    """Tabulate Sobol indices averaged over time; None without a sensitivity analysis."""
    sensitivity = data.sensitivity
    if sensitivity is None:
        return None
    columns = (
        Column("output", "output"),
        Column("name", "parameter"),
        Column("first_order", "first order", "", _index),
        Column("first_order_ci", "±", "", _index),
        Column("total_order", "total order", "", _index),
        Column("total_order_ci", "±", "", _index),
    )
    s = sensitivity
    means = [mean_over_time(v) for v in (s.first_order, s.first_order_ci, s.total_order, s.total_order_ci)]
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (output, s.names[i], *(float(mean[k, i]) for mean in means))
        for k, output in enumerate(s.output_names)
        for i in s.order(k)
    )
    return Table("sensitivity", "Sobol indices, averaged over time", columns, rows)


def validation_table(calibration: CalibrationRecord, record: ValidationRecord) -> Table:
    """Tabulate the parameter sets on the validation period, one row per set and output.

    Args:
        calibration: The calibration.
        record: How it did on the validation period.
    """
    unit = record.measurement.mse_unit
    columns = (
        Column("parameters", "parameters"),
        Column("mse_window", "MSE, calibrated part", unit),
        Column("mse", "MSE, validation", unit),
        Column("output", "output"),
        Column("unit", "unit"),
        Column("n_samples", "samples", "", count, 4),
        Column("rmse", "RMSE"),
        Column("bias", "bias", spare=1),
        Column("cv_rmse", "CV(RMSE)", "", percent, 3),
        Column("nmbe", "NMBE", "", percent, 3),
        Column("guideline_14", "ASHRAE guideline 14", spare=2),
    )
    units = list(map(difference_unit, record.measurement.units))
    rows: list[tuple[Cell, ...]] = []
    for name, point in record.points.items():
        errors: tuple[Cell, Cell] = (point.mse_window, point.mse)
        for k, ((output, fit), judged) in enumerate(
            zip(point.outputs.items(), record.judged(point), strict=True)
        ):
            verdict = None if judged.is_met is None else "met" if judged.is_met else "not met"
            rows.append(
                (name, *(errors if k == 0 else (None, None)), output, units[k], fit.n_samples, fit.rmse,
                 fit.bias, fit.cv_rmse, fit.nmbe, verdict)
            )  # fmt: skip
        if not point.outputs:
            rows.append((name, *errors, "failed", "", None, None, None, None, None, None))
    title = f"Validation on {period_text(record.period_d)} (bias: simulated minus measured)"
    return Table(f"validation-{calibration.name}", title, columns, tuple(rows))


def _index(value: float) -> str:
    return MISSING if math.isnan(value) else f"{value:.3f}"
