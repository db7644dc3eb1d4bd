"""Parameters that follow from others: what the FMU gets, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulation.case import load_case
from simulation.errors import InputError
from tests.simulation.case_for_tests import edit

WALL = Path(__file__).parents[2] / "fmus" / "wall"
G23 = """[[parameters]]
name = "G23"
estimate = 10
lower = 1
upper = 100
unit = "W/K"
scale = "log"
"""


def tied(folder: Path, expression: str) -> Path:
    """Return a copy of the wall's case whose conductance G23 follows from others."""
    text = (WALL / "case.toml").read_text().replace("../../data", str(WALL.parents[1] / "data"))
    begin = text.index(G23)
    end = text.index("[[", begin + len(G23))
    text = text[:begin] + text[end:]
    folder.mkdir()
    (folder / "case.toml").write_text(f"{text}\n[tied]\nG23 = '{expression}'\n")
    (folder / "Wall.fmu").symlink_to(WALL / "Wall.fmu")
    return folder


def test_the_fmu_gets_the_expression(tmp_path: Path) -> None:
    case, plain = load_case(tied(tmp_path / "tied", "G12 / 2 + 0.25 * GIn")), load_case(WALL)
    assert case.parameter_space.names == tuple(n for n in plain.parameter_space.names if n != "G23")
    theta = case.parameter_space.expected
    values = dict(zip(case.parameter_space.names, theta, strict=True))
    whole = [
        values.get(name, values["G12"] / 2 + 0.25 * values["GIn"]) for name in plain.parameter_space.names
    ]
    with case.open_model() as model, plain.open_model() as other:
        answer, same = model.simulate(theta[None]), other.simulate(np.array([whole]))

    assert not answer.failed[0]
    np.testing.assert_array_equal(answer.y, same.y)
    assert case.model_digest != load_case(tied(tmp_path / "other", "G12 / 3")).model_digest


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("G12 * exp(-2 * G12 / GIn)", lambda a, b: a * np.exp(-2.0 * a / b)),
        ("sqrt(G12 * GIn)", lambda a, b: np.sqrt(a * b)),
        ("max(G12, GIn) - min(G12, GIn) / 2", lambda a, b: max(a, b) - min(a, b) / 2.0),
        ("abs(G12 - GIn) + G12 * log(GIn / G12 + 1)", lambda a, b: abs(a - b) + a * np.log(b / a + 1.0)),
    ],
)
def test_functions_in_an_expression(tmp_path: Path, expression: str, expected: Callable[..., float]) -> None:
    (one,) = load_case(tied(tmp_path / "tied", expression)).settings.ties
    assert one.value({"G12": 12.0, "GIn": 75.0}) == pytest.approx(expected(12.0, 75.0))


def test_a_row_that_the_expression_cannot_answer_fails(tmp_path: Path) -> None:
    case = load_case(tied(tmp_path / "tied", "G12 * GIn / (GIn - 75)"))
    with case.open_model() as model:
        answer = model.simulate(case.parameter_space.expected[None])

    assert "G23" in answer.failures[0]


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("C1 * 2", r"is in .*, and G23 in W/K; correct it"),
        ("G12 + C1", "adds"),
        ("G12 *", "is no expression"),
        ("2 * unknown", "unknown is neither calibrated nor fixed"),
        ('__import__("os")', "is not understood"),
        ("G12 ** GIn", "is no whole power"),
        ("12.5", "has no parameter"),
        ("exp(G12)", "exp of .*; divide it by a value in that unit"),
        ("max(G12, C1)", "max of .* and .*; correct it"),
        ("min(G12)", "min has 1 arguments"),
        ("sqrt(G12)", "sqrt of .*; divide it"),
        ("eval(G12)", "is not understood; write sums.*and exp, log, sqrt, abs, min, max of them"),
    ],
)
def test_what_is_wrong_is_one_line(expression: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        load_case(tied(tmp_path / "tied", expression))


def test_a_parameter_is_not_tied_and_calibrated(tmp_path: Path) -> None:
    folder = tied(tmp_path / "tied", "G12")
    edit(folder, ("[tied]\nG23", "[tied]\nG12"))

    with pytest.raises(InputError, match=r"tied.G12: G12 is both under \[tied\] and \[\[parameters\]\]"):
        load_case(folder)
