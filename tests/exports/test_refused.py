"""What `studies best --write` refuses: each time one line with the remedy, and no file."""

from pathlib import Path

import pytest

from simulation.errors import InputError
from studies.cli import main
from studies.exports.calibrated_values import identifiers


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", ["R[1]", "it's", "a..b", "R\n); end M; model N(", "der(x)", "Höhe", ""])
def test_names_without_a_modifier_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="Modelica has no modifier for such a name; use --write ssv"):
        identifiers(name)


def test_nothing_is_overwritten(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.csv").write_text("mine", encoding="utf-8")
    Path("away").symlink_to("nowhere")
    for name in ("mine.csv", "away", "."):
        assert main(["best", "--write", "csv", name]) == 2
        assert f"{name} exists; name another file after the format, or remove it" in capsys.readouterr().err
    assert Path("mine.csv").read_text("utf-8") == "mine"


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["pdf"], "'pdf': give one of ssv, modelica, csv, json, fmu, onnx"),
        (["csv", "a", "b"], "then at most one file"),
        (["csv", "--n-train", "64"], "--n-train chooses the surrogate of --write onnx"),
        (["onnx"], "needs one case with a surrogate; type studies tune first"),
    ],
)
def test_bad_use_gets_a_line_with_the_remedy(
    words: list[str], remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["best", "--write", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert remedy in line
    assert not list(Path().iterdir())
