"""Table 4 drawn from calibrations alone: medians, quartiles, and what was never reached."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from paper_study_for_tests import ORIGIN, REPOSITORY

from studies.paper import fig7
from studies.paper.published import published_calibration
from studies.paper.table4_shown import shown, values_of
from studies.paper.table4_sizes import SeedCalibration, SizeCalibrations, read_calibrations
from studies.report.findings import quartiles
from studies.report.wording import count, significant

COMMITTED = REPOSITORY / "data" / "paper-results"


def calibration(seed: int, calls: int | None, *, final: float = 0.0110) -> SeedCalibration:
    """Return one that reached 0.0121 after so many calls behind its training set, or never."""
    course = (0.5, 0.0121, final) if calls is not None else (0.5, 0.02, 0.015)
    return SeedCalibration(
        seed=seed, val_mae=1.0, test_mae=1.0, test_p90=2.0, training_s=3.0, mse_surrogate=0.02,
        mse_screened=0.5, n_checks=1, polish_calls=(1, calls or 200, 300), polish_mse=course, n_polish=299,
        mse_polished=course[-1], stop_reason="ftol", squared_calls=250, squared_mse=0.0125, theta={"a": 1.0},
    )  # fmt: skip


def size(n_train: int, *calibrations: SeedCalibration) -> SizeCalibrations:
    return SizeCalibrations(
        n_train, "refined", {"n_latent": 8}, (8.0, 16.0), {"popsize": 8}, 400, (), calibrations
    )


def test_a_target_that_is_never_reached_makes_a_quartile_infinite_and_no_other() -> None:
    found = values_of(ORIGIN, size(32, *(calibration(i, c) for i, c in enumerate((100, 140, 120, None)))))
    assert quartiles(found["calls_to_usual"]).tolist() == [142.0, 162.0, np.inf]
    assert quartiles(found["n_polish"]).tolist() == [299.0, 299.0, 299.0]
    never = values_of(ORIGIN, size(32, calibration(0, 100), calibration(1, None), calibration(2, None)))
    assert quartiles(never["calls_to_usual"]).tolist() == [132.0, np.inf, np.inf]


def test_medians_stand_beside_the_paper() -> None:
    result = shown(
        ORIGIN, [size(32, *(calibration(i, 100 + i) for i in range(3))), size(512, calibration(0, 50))]
    )
    assert result.agreement == "agrees"
    rows = result.numbers["by_size"]
    assert rows[32]["median"]["calls_to_usual"] == 32 + 101
    assert rows[32]["median"]["calls_to_paper"] == 32 + 101
    assert rows[32]["median"]["total_paper"] == 32 + 1 + 299
    assert rows[512]["n_seeds"] == 1
    assert result.n_calls["training sets"] == 512 + 2 * 32
    assert "0.0121 K² is reached after 133 calls (quartiles 132 and 134) at n = 32" in result.verdict
    assert [picture.file for picture in result.pictures] == ["fig9.png", "seeds.png"]


@pytest.mark.parametrize(("final", "agreement"), [(0.0110, "agrees"), (0.0130, "differs")])
def test_a_final_error_above_the_papers_differs(final: float, agreement: str) -> None:
    assert shown(ORIGIN, [size(32, calibration(0, 50, final=final))]).agreement == agreement


def test_what_could_not_be_simulated_is_infinite() -> None:
    failed = replace(calibration(0, None), mse_screened=None, mse_polished=None, squared_mse=None)
    result = shown(ORIGIN, [size(32, failed), size(64, calibration(0, 50))])
    assert result.agreement == "agrees in part"
    assert result.numbers["by_size"][32]["median"]["mse_screened"] == np.inf


def test_the_committed_calibrations_are_what_the_documentation_says() -> None:
    origin, sizes = read_calibrations(COMMITTED / "table4")
    documentation = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    for n, numbers in shown(origin, sizes).numbers["by_size"].items():
        assert documented_row(n, numbers) in documentation


def calls_or_never(calls: float) -> str:
    return count(calls) if np.isfinite(calls) else "never"


def documented_row(n: int, numbers: Mapping[str, Any]) -> str:
    """Return a row of the table in docs/paper.md."""
    row, paper = numbers["median"], published_calibration(n)
    assert paper is not None
    cells = [
        f"{count(n)} ({numbers['n_seeds']})",
        *(significant(row[key]) for key in ("test_mae", "mse_surrogate", "mse_screened")),
        count(row["n_polish"]),
        significant(row["mse_polished"]),
        count(row["total_paper"]),
        *(calls_or_never(row[key]) for key in ("calls_to_usual", "calls_to_paper")),
        significant(row["squared_mse"]),
        *map(significant, (paper.mse_screened, paper.mse_polished)),
        count(paper.total),
    ]
    return f"| {' | '.join(cells)} |"


def test_the_committed_errors_of_fig_7_are_what_the_documentation_says() -> None:
    _, result = fig7.drawn_from(COMMITTED / "fig7")
    documentation = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    for n, mae in result.numbers["mae"]["all"].items():
        important = result.numbers["mae"]["important"][n]
        cells = [count(n), *map(significant, (mae[-1], important[8], important[2], mae[8], mae[2], mae[0]))]
        assert f"| {' | '.join(cells)} |" in documentation
