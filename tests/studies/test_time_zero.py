"""Recordings that begin after the model: the truth is recovered, and the offset is said."""

from pathlib import Path

import numpy as np
import pytest
from decaying_case_for_tests import (
    NOISE_K,
    TRUE_K,
    TRUE_X0,
    DecayingCase,
    driving,
    fitted,
    noise,
    states,
    table,
)

from simulation.case import load_case
from studies.doctor.begin import look_at_begin, say_begin
from studies.words.console import Console

LATE = np.arange(9000.0, 57601.0, 600.0)
MEASURED = states(LATE) + noise(len(LATE))


@pytest.mark.parametrize(("column", "unit_s"), [("time_s", 1.0), ("time [min]", 60.0)])
def test_a_late_recording_does_not_shift_the_model(tmp_path: Path, column: str, unit_s: float) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    file = DecayingCase(
        inputs=table(f"{column},u", time / unit_s, driving(time)),
        measured=table(f"{column},x", LATE / unit_s, MEASURED),
        top=f'time_column = "{column}"' * (column != "time_s"),
    ).write(tmp_path)
    k, x0, rms = fitted(file)
    assert rms < 2.0 * NOISE_K
    # The start is seen through what is left of it after 9,000 s.
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


def test_the_offset_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = load_case(DecayingCase(measured=table("time_s,x", LATE, MEASURED)).write(tmp_path / "late"))
    said = "the simulation begins at 0 s, the first sample lies at 9000 s, 2.5 h later"
    (found,) = look_at_begin(case)
    assert (found.level, found.found) == ("warn", said)
    assert 'zero = "first"' in found.remedy
    say_begin(case, Console())
    assert capsys.readouterr().err == f"{said}\n"

    usual = load_case(DecayingCase().write(tmp_path / "usual"))
    assert list(look_at_begin(usual)) == []
    say_begin(usual, Console())
    assert capsys.readouterr().err == ""

    # With a warm-up that was asked for, it is said as well, and nothing needs a look.
    time = "start_s = 0\nwindow_s = [21600, 57600]"
    (warm,) = look_at_begin(load_case(DecayingCase(time=time).write(tmp_path / "warm")))
    assert warm.level == "ok"
    assert warm.found.endswith("the first sample lies at 21600 s, 6 h later")


def test_each_experiment_has_its_own_offset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = DecayingCase(measured=table("time_s,x", LATE, MEASURED)).write(tmp_path)
    names = "".join(f'[[experiments]]\nname = "e{i}"\n' for i in range(6))
    file.write_text(file.read_text() + names)
    say_begin(load_case(file), Console())
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("experiment e0: the simulation begins at 0 s")
    assert lines[-1] == "2 more experiments begin before their first samples"
