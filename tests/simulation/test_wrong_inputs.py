"""Every mistake in a case file, a recording or an FMU is one line that names file, key, value and remedy."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from case_for_tests import edit, repack

from simulation import InputError, load_case

Change = Callable[[Path], None]


def toml(old: str, new: str) -> Change:
    return lambda folder: edit(folder, (old, new))


def csv(pattern: str, new: str) -> Change:
    def change(folder: Path) -> None:
        path = folder / "data" / "recording.csv"
        text, n = re.subn(pattern, new, path.read_text(), count=1, flags=re.MULTILINE)
        assert n == 1
        path.write_text(text)

    return change


def fmu(change: Callable[[dict[str, bytes]], dict[str, bytes]]) -> Change:
    return lambda folder: repack(folder / "decay.fmu", change)


def xml(old: bytes, new: bytes) -> Change:
    name = "modelDescription.xml"
    return fmu(lambda members: {**members, name: members[name].replace(old, new)})


WRONG: dict[str, tuple[Change, str]] = {
    "no case file": (
        lambda folder: (folder / "case.toml").unlink(),
        r"case\.toml: no such file; a case is a folder with a case\.toml",
    ),
    "an FMU": (
        lambda folder: (folder / "case.toml").write_bytes((folder / "decay.fmu").read_bytes()),
        r"is not a case file but, it seems, an FMU; studies new makes a case of one",
    ),
    "fixed name with dots": (
        toml('{ first_measured = "y" }', "1.0\ntank.h.start = 2.0"),
        r"toml: fixed\.tank = .*: a name with dots .*; write \"tank\.h\.start\" =",
    ),
    "validation inside the window": (
        toml("[time]", "[time]\nvalidation_d = [0.5, 1.0]"),
        r"validation_d = \[0\.5, 1\] overlaps with window_d = \[0\.25, 0\.75\]",
    ),
    "commas and points in numbers": (
        csv(r"(?s)\A.*", "time_s;T_degC;heating\n0;1,5;0\n1800;1.5;0\n"),
        r"column T_degC has a comma in '1,5' \(line 2\) and there is a point in '1.5' \(line 3\)",
    ),
    "workbook": (
        csv(r"\Atime_s", "PK\x03\x04"),
        r"recording\.csv: is no readable workbook .*; save it again",
    ),
    "time left out": (csv(r"^3600,", ","), r"line 4, column time_s: the time is missing"),
    "misspelt key of a table": (
        toml("output_step_s", "output_steps"),
        r"case\.toml: unknown key time\.output_steps \(did you mean output_step_s\?\)",
    ),
    "fixed and calibrated": (
        toml("[fixed]", "[fixed]\nk = 1e-4"),
        r"fixed\.k: k is both in \[\[parameters\]\] and under \[fixed\]",
    ),
    "wrong causality": (
        toml('name = "mode"', 'name = "y"'),
        r"parameters\[y\]: y is an output of decay\.fmu, not parameter; to change its start, begin earlier "
        r"\(start_d\), or choose one of: k, x0, mode",
    ),
    "input left out": (
        toml(
            '[[inputs]]\nname = "u"\nfile = "recording.csv"\ncolumn = "heating"\nunit = "K/s"\n'
            'interpolation = "linear"\n',
            "",
        ),
        r"the FMU's input u has no \[\[inputs\]\] entry; add one",
    ),
    "window beyond the data": (
        toml("[0.25, 0.75]", "[0.25, 3.0]"),
        r"window_d = \[0\.25, 3\]: the recording .*recording\.csv ends at day 1; shorten the window",
    ),
    "missing column": (
        csv("heating", "heat"),
        r"recording\.csv: column heating is missing; correct .* there are time_s, T_degC, heat$",
    ),
    "empty cell of an input": (
        csv(r"^(36000,[^,]*),.*$", r"\1,"),
        r"recording\.csv: line 22: heating has no value from 34200 to 37800 s; fill the gap, or write "
        r"max_gap_s = 3600 for inputs\[u\], which interpolates$",
    ),
    "unsorted": (csv(r"^3600,", "900,"), r"line 4: time_s = 900 comes before the line above \(1800\); sort"),
    "no binary": (
        fmu(lambda members: {name.replace("linux64", "darwin64"): text for name, text in members.items()}),
        r"no binary for this platform \(binaries/linux64/decay\.so is missing\)",
    ),
    "broken description": (xml(b"</ModelVariables>", b""), r"modelDescription\.xml is not valid \("),
    "model exchange alone": (
        xml(
            b'<CoSimulation modelIdentifier="decay" canHandleVariableCommunicationStepSize="true"/>',
            b'<ModelExchange modelIdentifier="decay"/>',
        ),
        r'case\.toml: decay\.fmu has no co-simulation interface; write interface = "model-exchange"',
    ),
    "days and seconds": (
        toml("[time]", "[time]\nwindow_s = [0, 1]"),
        r"time: both window_d and window_s are given; give one",
    ),
    "accepted band that holds nothing": (
        toml("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [21.0, 19.0]"),
        r"outputs\[y\]: accepted = \[21, 19\] holds nothing; give the lower value first",
    ),
    "steps that do not fit": (
        toml("communication_step_s = 600", "communication_step_s = 700"),
        r"output_step_s = 1800 is no multiple of communication_step_s = 700",
    ),
    "accepted band without a measured value": (
        toml("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [20.0, 20.5]"),
        r"outputs\[y\]: accepted = \[20, 20\.5\] leaves out the measured 20\.\d+ at \d+ s; widen",
    ),
    "start after the window's start": (
        toml("[time]", "[time]\nstart_d = 0.5"),
        r"time\.start_d = 0\.5 does not lie between day 0 and the window's start, 0\.25",
    ),
    "first measured of nothing": (
        toml('first_measured = "y"', 'first_measured = "T"'),
        r'fixed\.x0: first_measured = "T" is no output of the case; choose one of: y',
    ),
    "text cell": (
        csv(r"^3600,[^,]*,", "3600,warm,"),
        r"line 4, column T_degC: 'warm' is not a number; correct it, or",
    ),
    "newer schema": (toml("schema = 1", "schema = 2"), r"case\.toml: schema = 2: .*1"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_one_line(decay_case: Path, mistake: str):
    change, message = WRONG[mistake]
    change(decay_case)
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)
    assert re.match(r"/\S+\.(toml|csv|fmu)", str(caught.value)), "the line begins with the file"


def test_a_window_of_the_caller_is_checked_like_the_file_s(decay_case: Path):
    with pytest.raises(InputError, match=r"case\.toml: days 0 to 9: the recording .* ends at day 1;"):
        load_case(decay_case, window_d=(0, 9))
