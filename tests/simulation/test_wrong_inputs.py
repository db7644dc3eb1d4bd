"""Every mistake in a case file, a recording or an FMU is one line that names file, key, value and remedy."""

import re
import shutil
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
    "no TOML": (toml("schema = 1", "schema ="), r"case\.toml: not valid TOML: .*line .*; correct that line$"),
    "an FMU": (
        lambda folder: (folder / "case.toml").write_bytes((folder / "decay.fmu").read_bytes()),
        r"is not a case file but, it seems, an FMU; studies new makes a case of one",
    ),
    "far too small a step": (
        toml("communication_step_s = 600", "communication_step_s = 1e-3"),
        r"case\.toml: time\.communication_step_s = 0\.001 makes 4\.32e\+07 steps .* at least 0\.00436,",
    ),
    "prior is a number": (
        toml('scale = "log"', 'scale = "log"\nprior = 1e-4'),
        r"parameters\[k\]\.prior = 0\.0001: .*write prior = \{ about = 0\.0001, within_factor = 1\.5 \}",
    ),
    "fixed value in a wrong unit": (
        toml('{ first_measured = "y" }', '{ value = 7.0, unit = "W" }'),
        r'fixed\.x0: unit = "W" contradicts the FMU\'s "K"',
    ),
    "fixed name with dots": (
        toml('{ first_measured = "y" }', "1.0\ntank.h.start = 2.0"),
        r"toml: fixed\.tank = .*: a name with dots .*; write \"tank\.h\.start\" =",
    ),
    "validation inside the window": (
        toml("[time]", "[time]\nvalidation_d = [0.5, 1.0]"),
        r"validation_d = \[0\.5, 1\] overlaps with window_d = \[0\.25, 0\.75\]",
    ),
    "seconds beyond the data": (
        toml("window_d = [0.25, 0.75]", "window_s = [21600, 90000]"),
        r"window_s = .* ends at 86400 s; sh",
    ),
    "commas and points in numbers": (
        csv(r"(?s)\A.*", "time_s;T_degC;heating\n0;1,5;0\n1800;1.5;0\n"),
        r"column T_degC has a comma in '1,5' \(line 2\) and there is a point in '1.5' \(line 3\)",
    ),
    "a key that needs quotes": (
        toml("schema = 1", "schema = 1\ntank[2].h = 0.5  # [m]"),
        r'case\.toml: not valid TOML: .*line .*needs quotes; write "tank\[2\]\.h" = \.\.\.$',
    ),
    "time column that no file has": (
        toml("schema = 1", 'schema = 1\ntime_column = "Zeit"'),
        r'case\.toml: time_column = "Zeit" is in none of recording\.csv, whose times stand in time_s;',
    ),
    "workbook": (
        csv(r"\Atime_s", "PK\x03\x04"),
        r"recording\.csv: is a workbook, no CSV file; save its sheet as CSV",
    ),
    "time left out": (csv(r"^3600,", ","), r"line 4, column time_s: the time is missing"),
    "validation before the start": (
        toml("[time]", "[time]\nvalidation_d = [0.0, 0.25]"),
        r"validation_d = \[0, 0\.25\] begins before the simulation, day 0\.25",
    ),
    "prior without a width": (
        toml('scale = "log"', 'scale = "log"\nprior = { about = 1e-4 }'),
        r"prior does not fit scale = \"log\"; write within_factor",
    ),
    "misspelt key of a table": (
        toml("output_step_s", "output_steps"),
        r"case\.toml: unknown key time\.output_steps \(did you mean output_step_s\?\)",
    ),
    "fixed and calibrated": (
        toml("[fixed]", "[fixed]\nk = 1e-4"),
        r"fixed\.k: k is also under \[\[parameters\]\]",
    ),
    "misspelt input": (toml('name = "u"', 'name = "uu"'), r"no input named uu; did you mean u\?"),
    "wrong causality": (
        toml('name = "mode"', 'name = "y"'),
        r"parameters\[y\]: y is output in decay\.fmu, not parameter; choose one of: k, x0, mode",
    ),
    "input left out": (
        toml(
            '[[inputs]]\nname = "u"\nfile = "recording.csv"\ncolumn = "heating"\nunit = "K/s"\n'
            'interpolation = "linear"\n',
            "",
        ),
        r"the FMU's input u has no \[\[inputs\]\] entry; add one",
    ),
    "contradicting unit": (
        toml('unit = "K/s"', 'unit = "W"'),
        r'inputs\[u\]: unit = "W" contradicts .*"K/s"',
    ),
    "window beyond the data": (
        toml("[0.25, 0.75]", "[0.25, 3.0]"),
        r"window_d = \[0\.25, 3\]: the recording .*recording\.csv ends at day 1; shorten the window",
    ),
    "empty recording": (
        lambda folder: (folder / "data" / "recording.csv").write_text(""),  # type: ignore[dict-item]
        r"recording\.csv: the file is empty",
    ),
    "missing column": (
        csv("heating", "heat"),
        r"recording\.csv: column heating is missing; correct .* there are time_s, T_degC, heat$",
    ),
    "empty cell of an input": (
        csv(r"^(36000,[^,]*),.*$", r"\1,"),
        r"recording\.csv: line 22: heating has no value from 34200 to 37800 s; fill the gap, or let "
        r"inputs\[u\] bridge it with max_gap_s = 3600$",
    ),
    "gap of an input longer than declared": (
        lambda folder: (
            csv(r"^36000,.*\n37800,.*\n", "")(folder),
            toml('"linear"', '"linear"\nmax_gap_s = 3600')(folder),
        ),
        r"line 22: heating has no value from 34200 to 39600 s; .* max_gap_s = 5400$",
    ),
    "input of another year": (
        lambda folder: (
            toml('file = "recording.csv"\ncolumn = "heating"', 'file = "other.csv"\ncolumn = "heating"')(
                folder
            ),
            (folder / "data" / "other.csv").write_text("time_s,heating\n-90000,1\n-3600,2\n"),  # type: ignore[dict-item]
        ),
        r"inputs\[u\]: .*other\.csv covers -90000 to -3600 s, the window needs 21600 to 64800 s; "
        r"no moment is in both; correct the times of this file or of the first output's$",
    ),
    "unsorted": (csv(r"^3600,", "900,"), r"line 4: time_s = 900 comes before the line above \(1800\); sort"),
    "no zip": (
        lambda folder: shutil.copy(folder / "case.toml", folder / "decay.fmu"),  # type: ignore[dict-item]
        r"decay\.fmu: not an FMU \(.*zip.*\); export it again",
    ),
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
    "start in days beside a window in seconds": (
        toml("window_d = [0.25, 0.75]", "window_s = [21600, 64800]\nstart_d = 0"),
        r"time: start_d beside window_s; write start_s",
    ),
    "column and sum": (
        toml('column = "heating"', 'column = "heating"\nsum = { heating = 1.0 }'),
        r"inputs\[u\]: give either column or sum",
    ),
    "accepted band that holds nothing": (
        toml("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [21.0, 19.0]"),
        r"outputs\[y\]: accepted = \[21, 19\] holds nothing; give the lower value first",
    ),
    "window reversed": (
        toml("[0.25, 0.75]", "[0.75, 0.25]"),
        r"window_d = \[0\.75, 0\.25\]: the end must lie after",
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
    "window of odd length": (
        toml("[0.25, 0.75]", "[0.25, 0.76]"),
        r"not a whole number of output steps of 1800 s",
    ),
    "first measured of nothing": (
        toml('first_measured = "y"', 'first_measured = "T"'),
        r'fixed\.x0: first_measured = "T" is no output of the case; choose one of: y',
    ),
    "parameter twice": (
        toml('name = "mode"', 'name = "k"\nunit = "1/s"'),
        r"parameters\[k\] is declared 2 times",
    ),
    "header alone": (
        lambda folder: (folder / "data" / "recording.csv").write_text("time_s,T_degC,heating\n"),  # type: ignore[dict-item]
        r"recording\.csv: no row of data",
    ),
    "text cell": (
        csv(r"^3600,[^,]*,", "3600,warm,"),
        r"line 4, column T_degC: 'warm' is not a number; correct it, or",
    ),
    "infinite cell": (
        csv(r"^3600,[^,]*,", "3600,inf,"),
        r"line 4, column T_degC: inf is no measured value; leave",
    ),
    "no description": (
        fmu(lambda members: {"other.txt": b""}),
        r"decay\.fmu: not an FMU \(no modelDescription\.xml inside\)",
    ),
    "newer schema": (toml("schema = 1", "schema = 2"), r"case\.toml: schema = 2: .*1"),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_one_line(decay_case: Path, mistake: str):
    load_case(decay_case)
    change, message = WRONG[mistake]
    change(decay_case)
    with pytest.raises(InputError, match=message) as caught:
        load_case(decay_case)
    assert "\n" not in str(caught.value)
    assert re.match(r"/\S+\.(toml|csv|fmu)", str(caught.value)), "the line begins with the file"


def test_a_window_of_the_caller_is_checked_like_the_file_s(decay_case: Path):
    with pytest.raises(InputError, match=r"case\.toml: days 0 to 9: the recording .* ends at day 1;"):
        load_case(decay_case, window_d=(0, 9))
