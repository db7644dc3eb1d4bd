"""Table 4 drawn from calibrations alone: medians, quartiles, and what was never reached."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from paper_study_for_tests import COMMITTED, ORIGIN, REPOSITORY

from studies.paper import fig7
from studies.paper.items import read_sizes, write_size
from studies.paper.table4 import SeedCalibration, SizeCalibrations, shown
from studies.words.wording import count, significant

DOCUMENTATION = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")


def calibration(seed: int, calls: int | None) -> SeedCalibration:
    """Return one that reached 0.0121 after so many calls behind its training set, or never."""
    course = (0.5, 0.0121, 0.0110) if calls is not None else (0.5, 0.02, 0.015)
    return SeedCalibration(
        seed=seed, val_mae=1.0, test_mae=1.0, test_p90=2.0, training_s=3.0, mse_surrogate=0.02,
        mse_screened=0.5, n_checks=1, polish_calls=(1, calls or 200, 300), polish_mse=course, n_polish=299,
        mse_polished=course[-1], stop_reason="ftol", squared_calls=250, squared_mse=0.0125, theta={"a": 1.0},
    )  # fmt: skip


def size_of(*calibrations: SeedCalibration) -> SizeCalibrations:
    return SizeCalibrations(
        32, "refined", {"n_latent": 8}, (8.0, 16.0), {"popsize": 8}, 400, (), calibrations
    )


def row_of(*calibrations: SeedCalibration) -> dict[str, Any]:
    result = shown(ORIGIN, [size_of(*calibrations)])
    return dict(zip(result.columns, result.rows[0], strict=True))


def test_a_target_that_is_never_reached_makes_a_quartile_infinite_and_no_other() -> None:
    row = row_of(*(calibration(i, calls) for i, calls in enumerate((100, 140, 120, None))))
    assert (row["lower quartile"], row["calls to 0.0121"], row["upper quartile"]) == (142.0, 162.0, np.inf)
    assert (row["seeds"], row["calls"]) == (4, 32 + 1 + 299)
    assert row["calls, validation and test too"] == row["calls"] + 640


def test_what_could_not_be_simulated_is_infinite_and_null_in_the_file(tmp_path: Path) -> None:
    never = {"mse_screened": np.inf, "mse_polished": np.inf, "squared_mse": np.inf}
    failed = replace(calibration(0, None), **never, polish_mse=(np.inf,) * 3)
    write_size(tmp_path, ORIGIN, 32, size_of(failed))
    assert "Infinity" not in (tmp_path / "n0032.json").read_text()
    _, (size,) = read_sizes(tmp_path, SizeCalibrations)
    assert size == size_of(failed)
    assert row_of(*size.calibrations)["final MSE"] == np.inf


def test_the_committed_calibrations_are_what_the_documentation_says() -> None:
    result = shown(*read_sizes(COMMITTED / "table4", SizeCalibrations))
    for row in result.rows:
        assert documented_row(dict(zip(result.columns, row, strict=True))) in DOCUMENTATION


def calls_or_never(calls: float) -> str:
    return count(calls) if np.isfinite(calls) else "never"


def documented_row(row: Mapping[str, Any]) -> str:
    """Return a row of the table in docs/paper.md."""
    cells = [
        f"{count(row['n_train'])} ({row['seeds']})",
        *(significant(row[key]) for key in ("test MAE", "MSE surrogate", "MSE screened", "final MSE")),
        count(row["calls"]),
        *(calls_or_never(row[key]) for key in ("calls to 0.0121", "calls to the paper's final")),
        *(
            significant(row[key])
            for key in ("final MSE, squared residuals", "paper: screened", "paper: final")
        ),
        count(row["paper: calls"]),
    ]
    return f"| {' | '.join(cells)} |"


def test_the_committed_errors_of_fig_7_are_what_the_documentation_says() -> None:
    result = fig7.shown(*read_sizes(COMMITTED / "fig7", fig7.SpreadSize))
    found = {(kind, n): mae for kind, n, *mae in result.rows}
    for n in (n for kind, n in found if kind == "all"):
        important, mae = found["important", n], found["all", n]
        cells = [count(n), *map(significant, (mae[-1], important[8], important[2], mae[8], mae[2], mae[0]))]
        assert f"| {' | '.join(cells)} |" in DOCUMENTATION
