"""The README and the tutorials show what their examples print."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store

from studies.cli import main

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
DURATION = re.compile(r" \(\d+(\.\d+)? (s|min)\)")
PROCESSORS_DIFFER = 0.02
"""The last digits differ between processors."""


def blocks(page: Path, kind: str) -> list[str]:
    text = page.read_text("utf-8")
    return re.findall(rf"^```{kind}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


def is_shown(line: str, printed: list[list[str]]) -> bool:
    """Say whether the words of a line stand in this order in a printed line, numbers nearly equal."""
    return any(follows(line.split(), words) for words in printed)


def follows(shown: list[str], printed: list[str]) -> bool:
    rest = iter(printed)
    return all(any(is_same(word, other) for other in rest) for word in shown)


def is_same(word: str, other: str) -> bool:
    try:
        number, printed = (float(text.replace(",", "")) for text in (word, other))
    except ValueError:
        return word == other
    return number == pytest.approx(printed, rel=PROCESSORS_DIFFER)


def compare(block: str, output: str) -> None:
    printed = [DURATION.sub("", line).split() for line in output.splitlines()]
    lines = [DURATION.sub("", line) for line in block.splitlines() if line.strip()]
    assert lines
    assert not [line for line in lines if not is_shown(line, printed)], output


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    give_store(tmp_path)
    return tmp_path


def test_the_office_is_calibrated_as_shown(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = blocks(ROOT / "README.md", "python")
    assert len([line for line in example.splitlines() if line]) <= 5
    exec(example, {})
    assert capsys.readouterr().out.startswith("office-quick/adaptive: MSE 0.0105")
    # The command finds what the example has made.
    assert main(["calibrate"]) == 0
    compare(blocks(TUTORIALS / "office.md", "text")[0], capsys.readouterr().out)


@pytest.mark.slow
def test_an_fmu_of_ones_own_is_calibrated_as_shown(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = TUTORIALS / "own-fmu.md"
    commands = [line.split() for block in blocks(page, "sh") for line in block.splitlines()]
    texts = blocks(page, "text")
    shutil.copy(ROOT / "fmus" / "wall" / "Wall.fmu", project / "MyWall.fmu")

    def type_in(word: str, *options: str) -> str:
        (words,) = (one[1:] for one in commands if one[1] == word and "--list" not in one)
        assert main([*words, *options]) == 0
        return capsys.readouterr().out

    compare(texts[0], type_in("new"))
    for name in ("inputs.csv", "measured.csv"):
        shutil.copy(ROOT / "data" / "wall" / name, project / "data" / "mywall")
    case = project / "fmus" / "mywall" / "case.toml"
    text = case.read_text("utf-8").replace("window_d = [0, 7]", "window_d = [1, 5]")
    text = text.replace("# start_d = 0", "start_d = 0")
    text = text.replace("# validation_d = [7, 14]", "validation_d = [5, 7]")
    for old, new in (("TIn", "TRoom_degC"), ("TOut", "TOutdoor_degC"), ("TMasonry", "TMasonry_degC")):
        text = text.replace(f'column = "{old}"\nunit = "K"', f'column = "{new}"\nunit = "degC"')
    text = text.replace('column = "QRoom"', 'column = "QRoom_W"')
    text = text.replace("uncertainty = 0.5", "uncertainty = 0.05").replace(
        "uncertainty = 1.0", "uncertainty = 2"
    )
    case.write_text(text, "utf-8")
    assert "changes QRoom by 4.69 W at most, 2.3 times" in " ".join(type_in("check").split())
    case.write_text(text.replace("communication_step_s = 600 ", "communication_step_s = 60 "), "utf-8")
    assert "changes QRoom by 0.474 W at most, 0.24 times" in " ".join(type_in("check").split())
    compare(texts[2], type_in("calibrate"))
    compare(texts[3], type_in("uncertainty"))


def test_machine_learners_are_led_to_names_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    page = TUTORIALS / "machine-learning.md"
    named = re.findall(r"((?:`\w+(?:\.\w+)?`(?:, | and )?)+) in `([\w/]+\.py)`", page.read_text("utf-8"))
    assert len(named) > 20
    for names, file in named:
        code = (ROOT / file).read_text("utf-8")
        for name in re.findall(r"\w+", names.replace(" and ", " ")):
            assert re.search(rf"^\s*(?:def |class )?{name}\b", code, re.MULTILINE), f"{name} in {file}"
    for file in re.findall(r"`([\w/]+\.py)`", page.read_text("utf-8")):
        assert (ROOT / file).is_file(), file
    (example,) = blocks(page, "python")
    names_made: dict[str, Any] = {}
    exec(example, names_made)
    assert names_made["error"] < 0.15  # of values from 0.05 to 2
    assert "best epoch" in capsys.readouterr().out
