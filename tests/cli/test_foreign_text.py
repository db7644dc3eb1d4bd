"""Texts of strangers on the terminal: nothing in them is obeyed, and what messages quote of them is short."""

import json
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from project_for_tests import Run, copy_of, edit

from simulation.foreign_text import MOST_QUOTED, escaped, not_a_formula, quoted
from studies.words.console import Column, Console, Table

CLEAR = "\x1b[2J\x1b]0;title\x07"
HOSTILE = f"a{CLEAR}\x9b31m\u202eb\u2066c\r\x00d\x08\x7f\u2028e"
"""Clears a screen, sets a title, turns the direction of writing, and goes back to the line's begin."""


def is_harmless(text: str, allowed: str = "\n") -> bool:
    return all(
        sign in allowed or unicodedata.category(sign) not in ("Cc", "Zl", "Zp") for sign in text
    ) and not any(
        unicodedata.bidirectional(sign) in ("RLO", "LRO", "RLE", "LRE", "RLI", "LRI") for sign in text
    )


@given(st.text(st.characters()))
def test_escaped_texts_are_harmless_and_others_stay(text: str) -> None:
    said = escaped(text)
    assert is_harmless(said, "")
    assert escaped(said) == said
    if text.isprintable():
        assert said == text
    assert is_harmless(escaped(text, keep_lines=True), "\n\t")


@given(st.recursive(st.text() | st.integers(), st.lists, max_leaves=50))
def test_quotations_are_short(value: object) -> None:
    assert len(quoted(value)) <= MOST_QUOTED
    assert len(quoted("x" * 100_000)) == MOST_QUOTED
    assert "digits" in quoted(10**5000)


def test_nothing_that_the_console_writes_is_obeyed(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    for write in (console.say, console.warn, console.result):
        write(f"{HOSTILE} umlaut ä, K², 日本")
    console.show(
        [
            HOSTILE,
            Table(HOSTILE, [Column(HOSTILE), Column("n", True)], [[HOSTILE, 3], [HOSTILE, None]]),
        ]
    )
    said = capsys.readouterr()
    assert is_harmless(said.out), repr(said.out)
    assert is_harmless(said.err), repr(said.err)
    assert "umlaut ä, K², 日本" in said.out
    assert r"\x1b[2J" in said.out
    assert said.err.count("\n") == 2


PICTURES = (
    "![x](http://e.org/a.png)",
    '<img src="http://e.org/a.png">',
)


@pytest.mark.parametrize("picture", PICTURES)
def test_a_note_shows_no_picture(tmp_path: Path, picture: str) -> None:
    from mlflow_store_for_tests import give_store

    from studies.paths import ProjectPaths
    from studies.tracking.runs import NOTE, RunStore

    give_store(tmp_path)
    runs = RunStore(ProjectPaths(tmp_path))
    runs.describe("a-label", "", f"3 rows {picture}", "")
    run = runs.client.get_run(runs.begin("a-label", "a run", {NOTE: f"3 rows {picture}"}))
    experiment = runs.client.get_experiment_by_name("a-label")
    assert experiment is not None
    for note in (run.data.tags[NOTE], experiment.tags[NOTE]):
        assert note.startswith("3 rows ")
        assert "![" not in note
        assert "<" not in note


@pytest.mark.parametrize("text", ["=1+1", " =1+1", "+1", "-x", "@sum", "\t=1"])
def test_no_text_is_a_formula(text: str) -> None:
    assert not_a_formula(text) == f"'{text}"
    assert not_a_formula(f"a{text}") == f"a{text}"
    assert not_a_formula("") == ""


def test_half_a_character_in_a_record_is_one_line(
    hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    root = copy_of(hasty_wall, tmp_path / "project", monkeypatch)
    edit(root / "mlruns/results/wall-quick/calibrate-adaptive.json", ('"TMasonry"', r'"\ud800\udc00 \udfff"'))
    for command in (("status",), ("best",), ("report", "wall"), ("uncertainty", "wall")):
        answer = studies(*command)
        assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
        assert r"calibrate-adaptive.json: '\udfff' is half a character" in answer.err


def test_a_damaged_record_is_named_until_it_is_removed(
    hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    root = copy_of(hasty_wall, tmp_path / "project", monkeypatch)
    record = root / "mlruns/results/wall-quick/calibrate-adaptive.json"
    whole = json.loads(record.read_text())
    edit(record, ('"n_failed": 0', '"n_failed": 1'))
    calibrate = ("calibrate", "wall", "--max-calls", "8", "--jobs", "1", "-q")
    for command in (("status",), ("best",), ("report", "wall"), calibrate):
        answer = studies(*command)
        assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
        assert "calibrate-adaptive.json is damaged; remove calibrate-adaptive.json, and " in answer.err
    record.unlink()
    assert studies(*calibrate).code == 0
    assert json.loads(record.read_text())["result"]["mse"] == whole["result"]["mse"]
    assert studies("status").code == 0
