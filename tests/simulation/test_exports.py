"""Exports as they are: other timestamps, midnights of 24:00, lines before the header, units after it."""

import re
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit
from decaying_case_for_tests import (
    NOISE_K,
    TRUE_K,
    TRUE_X0,
    DecayingCase,
    driving,
    fitted,
    noise,
    states,
)

from simulation import InputError, load_case

TIME = np.arange(0.0, 115_201.0, 600.0)
WINDOW = "window_s = [0, 115200]"


def rows(begin: datetime, form: str, values: np.ndarray, *, ends: bool) -> list[str]:
    """Return lines of timestamps and values; midnights are ends of days where `ends`."""
    found = []
    for at, value in zip(TIME, values, strict=True):
        moment = begin + timedelta(seconds=float(at))
        stamp = moment.strftime(form)
        if ends and at and moment.hour == moment.minute == 0:
            before = moment - timedelta(days=1)
            stamp = before.strftime(form).replace("00:00", "24:00", 1)
        found.append(f"{stamp},{value:.9f}")
    return found


def written(
    folder: Path,
    begin: datetime,
    form: str,
    *,
    top: str = "",
    ends: bool = True,
    before: str = "",
    after: str = "",
    time: str = WINDOW,
) -> Path:
    u, x = driving(TIME), states(TIME) + noise(len(TIME))
    texts = [
        "\n".join([f"{before}time,{name}{after.format(unit)}", *rows(begin, form, values, ends=ends)]) + "\n"
        for name, unit, values in (("u", "K/s", u), ("x", "K", x))
    ]
    return DecayingCase(inputs=texts[0], measured=texts[1], top=top, time=time).write(folder)


def check(file: Path) -> None:
    """Check that the truth is found, within what the noise allows."""
    k, x0, rms = fitted(file)
    assert rms < 2.0 * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


@pytest.mark.parametrize(
    ("begin", "form", "key"),
    [
        # EnergyPlus, also over the end of a year.
        (datetime(2001, 1, 1), "%m/%d  %H:%M:%S", 'time_format = "%m/%d %H:%M:%S"'),
        (datetime(2001, 12, 31), "%m/%d  %H:%M:%S", 'time_format = "%m/%d %H:%M:%S"'),
        (datetime(2024, 2, 28), "%m/%d  %H:%M:%S", 'time_format = "%m/%d %H:%M:%S"\nyear = 2024'),
        (datetime(2023, 2, 28), "%m/%d/%Y %H:%M", 'time_format = "%m/%d/%Y %H:%M"'),
        (datetime(2023, 2, 28), "%d/%m/%Y %H:%M:%S", 'time_format = "%d/%m/%Y %H:%M:%S"'),
        (datetime(2023, 2, 28), "%d-%b-%y %H:%M", 'time_format = "%d-%b-%y %H:%M"'),
        (datetime(2023, 2, 28), "%Y-%m-%dT%H:%M:%S", ""),
        (datetime(2023, 2, 28), "%Y-%m-%dT%H:%M:%S+01:00", ""),
        (datetime(2023, 12, 31), "%d.%m.%Y %H:%M", ""),
    ],
)
def test_timestamps_of_other_programs(tmp_path: Path, begin: datetime, form: str, key: str):
    check(written(tmp_path, begin, form, top=key))


def test_a_zero_may_be_written_like_the_timestamps(tmp_path: Path):
    keys = 'time_format = "%m/%d %H:%M:%S"'
    later = f'zero = "01/01 00:00:00"\n{WINDOW.replace("[0, 115200]", "[86400, 201600]")}'
    case = load_case(written(tmp_path, datetime(2001, 1, 2), "%m/%d  %H:%M:%S", top=keys, time=later))
    assert case.measurement.outputs[0].samples.time[0] == 86400.0


@pytest.mark.parametrize(
    ("begin", "form", "key", "said"),
    [
        (
            datetime(2023, 2, 3), "%m/%d  %H:%M:%S", "",
            "line 2, column time: '02/03  00:00:00' may have the month or the day first; say at the top of "
            'the case file which: time_format = "%m/%d %H:%M:%S" or "%d/%m %H:%M:%S"',
        ),
        (
            datetime(2023, 2, 3), "%m/%d/%Y %H:%M", "",
            "may have the month or the day first; say at the top of the case file which: "
            'time_format = "%m/%d/%Y %H:%M" or "%d/%m/%Y %H:%M"',
        ),
        (
            datetime(2024, 2, 28, 12), "%m/%d  %H:%M:%S", 'time_format = "%m/%d %H:%M:%S"',
            "line 75, column time: '02/29  00:10:00' is not written like time_format = "
            '"%m/%d %H:%M:%S", or is '
            "no day of 2001 (year = ... names another)",
        ),
        (
            datetime(2023, 2, 28), "%m/%d/%Y %H:%M", 'time_format = "%d/%m/%Y %H:%M"',
            "'02/28/2023 00:00' is not written like time_format = \"%d/%m/%Y %H:%M\"; correct one of the two",
        ),
        (datetime(2023, 2, 28), "%m/%d/%Y", 'time_format = "%H:%M"', "has no day; write codes of"),
        (datetime(2023, 2, 28), "%m/%d/%Y", 'time_format = "%Q"', "has no day; write codes of"),
        (datetime(2023, 2, 28), "%m/%d/%Y", "year = 2023", "year = 2023 is of a time_format without a year"),
        (
            datetime(2023, 2, 28), "%m/%d/%Y", 'year = 2023\ntime_format = "%m/%d/%Y"',
            "year = 2023 is of a time_format without a year",
        ),
    ],
)  # fmt: skip
def test_what_is_ambiguous_or_wrong_is_one_line(
    tmp_path: Path, begin: datetime, form: str, key: str, said: str
):
    with pytest.raises(InputError, match=re.escape(said)) as error:
        load_case(written(tmp_path, begin, form, top=key))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("stamp", ["24:10", "24:00:01", "25:00"])
def test_no_other_hour_ends_a_day(decay_case: Path, stamp: str):
    text = "time,T_degC,heating\n2024-03-01T23:50,20,0\n2024-03-01T" + stamp + ",20,0\n"
    (decay_case / "data" / "recording.csv").write_text(text)
    with pytest.raises(InputError, match=r"line 3, column time: .* is no timestamp"):
        load_case(decay_case)


BEFORE = [
    "# exported by logger 7\n",
    "Logger 7; serial 12\n\n# time,2024\n",
    "# ",
    "% ",
    "\n\n",
    "time,of export\n",
]


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("after", ["", "\n,{}", "\ns,[{}]"])
def test_lines_around_the_header(tmp_path: Path, before: str, after: str):
    form = "%Y-%m-%d %H:%M" if "s" not in after else "{}"
    if form == "{}":
        file = seconds(tmp_path, before, after)
    else:
        file = written(tmp_path, datetime(2024, 3, 1), form, before=before, after=after, ends=False)
    check(file)


def seconds(folder: Path, before: str, after: str, *, name: str = "time", unit_s: float = 1.0) -> Path:
    u, x = driving(TIME), states(TIME) + noise(len(TIME))
    texts = []
    for column, unit, values in (("u", "K/s", u), ("x", "K", x)):
        lines = [f"{at / unit_s:.12g},{value:.9f}" for at, value in zip(TIME, values, strict=True)]
        texts.append("\n".join([f"{before}{name},{column}{after.format(unit)}", *lines]) + "\n")
    top = f'time_column = "{name}"' * (name not in ("time", "time_s"))
    return DecayingCase(inputs=texts[0], measured=texts[1], time=WINDOW, top=top).write(folder)


@pytest.mark.parametrize(("unit", "unit_s"), [("s", 1.0), ("min", 60.0), ("hours", 3600.0), ("d", 86400.0)])
def test_a_line_of_units_says_what_times_count_in(tmp_path: Path, unit: str, unit_s: float):
    check(seconds(tmp_path, "", f"\n{unit},{{}}", name="Zeit", unit_s=unit_s))


def test_units_that_contradict_the_case_are_one_line(tmp_path: Path):
    for n, (name, after, said) in enumerate(
        [
            ("time_s", "\nh,{}", "measured.csv: the line of units says 'h' of column time_s; correct one"),
            ("time [h]", "\nmin,{}", "the line of units says 'min' of column time [h]"),
            ("time_s", "\ns,W", 'inputs[u]: unit = "K/s", but line 2 of'),
            ("time_s", "\ns,degC", 'inputs[u]: unit = "K/s", but line 2 of'),
        ]
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            load_case(seconds(tmp_path / str(n), "", after, name=name))
    # A unit that is not known here says nothing against the case.
    load_case(seconds(tmp_path / "unknown", "", "\ns,furlong", name="time_s"))


def test_lines_keep_their_numbers(decay_case: Path):
    file = decay_case / "data" / "recording.csv"
    lines = file.read_text().splitlines()
    lines[9] = lines[9].replace(",", ",x", 1)
    file.write_text("\n".join(["# one", "# two", lines[0], "s,degC,K/s", *lines[1:]]) + "\n")
    with pytest.raises(InputError, match=r"line 13, column T_degC: 'x20\.\d+' is not a number"):
        load_case(decay_case)
    lines[9] = lines[9].replace(",x", ",").rpartition(",")[0] + ","
    edit(decay_case, ("window_d = [0.25, 0.75]", "window_d = [0, 0.75]"))
    file.write_text("\n".join(["# one", "# two", lines[0], "s,degC,K/s", *lines[1:]]) + "\n")
    with pytest.raises(InputError, match="line 13: heating has no value from"):
        load_case(decay_case)


def test_a_first_row_that_is_wrong_is_no_line_of_units(decay_case: Path):
    file = decay_case / "data" / "recording.csv"
    lines = file.read_text().splitlines()
    for row, said in (("0,A,0.1", "'A' is not a number"), ("0,A,W", "'A' is not a number"), (",,", "line 2")):
        file.write_text("\n".join([lines[0], row, *lines[2:]]) + "\n")
        with pytest.raises(InputError, match=said):
            load_case(decay_case)
