"""The paper's problem: its own recording, our FMU; numbers found before by other means.

0.01028 is the best MSE known on days 0 to 10, from an exact solution of the same equations; the paper's
differential evolution came to 0.0104 with 748,020 calls and its usual result is 0.0121 (Tables 3 and 4;
10.3384/ecp204107).
"""

import statistics
from collections.abc import Iterator
from pathlib import Path

import pytest
from multistart_for_tests import multistart

from simulation.case import load_case
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem

ROOT = Path(__file__).parents[2]
RECORDING = ROOT.parent / "shared" / "data" / "office_recording"
PAPERS_USUAL_MSE = 0.0121


@pytest.fixture(scope="module")
def problem(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CalibrationProblem]:
    if not RECORDING.is_dir():
        pytest.skip(f"the recording is not at {RECORDING}")
    if not (ROOT / "fmus" / "office" / "Office.fmu").is_file():
        pytest.skip("fmus/office/Office.fmu is not built")
    text = (ROOT / "fmus" / "office-recorded" / "case.toml").read_text()
    folder = tmp_path_factory.mktemp("recorded")
    for relative, absolute in (
        ("../office/Office.fmu", ROOT / "fmus" / "office" / "Office.fmu"),
        ("../../data/office-recorded", RECORDING),
    ):
        assert f'"{relative}"' in text
        text = text.replace(f'"{relative}"', f'"{absolute}"')
    (folder / "case.toml").write_text(text)
    case = load_case(folder, window_d=(0.0, 10.0))
    with case.open_model() as model:
        yield CalibrationProblem(model, case.measurement)


def test_random_starts_reach_the_papers_result_in_some_150_calls(problem: CalibrationProblem) -> None:
    runs = multistart(problem, 12, seed=0, polishing=LeastSquaresTRF(max_calls=500))
    calls = [calls or 501 for calls in runs.calls_to(PAPERS_USUAL_MSE)]
    assert 90 <= statistics.median(calls) <= 210
    assert max(calls) <= 500


def test_the_papers_squared_residuals_take_many_times_the_calls(problem: CalibrationProblem) -> None:
    papers = LeastSquaresTRF(residuals="squared", max_calls=1000)
    runs = multistart(problem, 3, seed=0, polishing=papers)
    calls = [calls or 1001 for calls in runs.calls_to(PAPERS_USUAL_MSE)]
    assert statistics.median(calls) > 600
