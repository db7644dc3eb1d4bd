"""Recordings as other programs export them: workbooks, Parquet, thousands, lines of header; or refused."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from decaying_case_for_tests import NOISE_K, TRUE_K, TRUE_X0, DecayingCase, driving, fitted, noise, states

from simulation import InputError, load_case
from simulation.recording import Recording, read_recording

TIME = np.arange(0.0, 57601.0, 600.0)
ZERO = datetime(2024, 2, 28, 22)
STAMPS = [ZERO + timedelta(seconds=one) for one in TIME]
MEASURED = states(TIME) + noise(len(TIME))


def frames() -> tuple[pd.DataFrame, pd.DataFrame]:
    return pd.DataFrame({"time": STAMPS, "u": driving(TIME)}), pd.DataFrame({"time": STAMPS, "x": MEASURED})


def recovered(file: Path) -> None:
    k, x0, rms = fitted(file)
    assert rms < 2.0 * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


def renamed(file: Path, inputs: str, measured: str) -> Path:
    text = file.read_text().replace('"inputs.csv"', f'"{inputs}"').replace('"measured.csv"', f'"{measured}"')
    file.write_text(text)
    return file


def written(folder: Path, text: str, **keys: str) -> Path:
    return DecayingCase(measured=text, **keys).write(folder)


def read(folder: Path, text: str, names: str = "x", **words: str) -> Recording:
    file = folder / "a.csv"
    file.write_bytes(text.encode())
    return read_recording(file, names.split(), **words)


def test_one_workbook_with_a_sheet_of_inputs_and_one_of_outputs(tmp_path: Path) -> None:
    file = renamed(DecayingCase().write(tmp_path), "runs.xlsx#On-line", "runs.xlsx")
    inputs, measured = frames()
    with pd.ExcelWriter(file.parent / "runs.xlsx") as book:
        pd.DataFrame({"Operator": ["K. M."]}).to_excel(book, sheet_name="About", index=False)
        # A title, then names, then units, as people type them.
        pd.DataFrame([["Reactor 3", "", ""], ["time", "x", "remark"], ["", "K", ""]]).to_excel(
            book, sheet_name="Off", index=False, header=False
        )
        measured.to_excel(book, sheet_name="Off", startrow=3, index=False, header=False)
        inputs.to_excel(book, sheet_name="On-line", index=False)
    recording = read_recording(file.parent / "runs.xlsx", ["x"])
    assert (recording.first_line, recording.units) == (4, {"x": "K"})
    recovered(file)
    with pytest.raises(
        InputError, match=r"no sheet has all columns, u, x and a time column; say in each file"
    ):
        read_recording(file.parent / "runs.xlsx", ["x", "u"])


def test_a_sheet_of_each_batch_is_named(tmp_path: Path) -> None:
    file = renamed(DecayingCase().write(tmp_path), "runs.xlsx#inputs", "runs.xlsx#Batch 2")
    inputs, measured = frames()
    with pd.ExcelWriter(file.parent / "runs.xlsx") as book:
        measured.assign(x=0.0).to_excel(book, sheet_name="Batch 1", index=False)
        measured.to_excel(book, sheet_name="Batch 2", index=False)
        inputs.to_excel(book, sheet_name="inputs", index=False)
    recovered(file)
    with pytest.raises(
        InputError, match=r'several sheets, Batch 1, Batch 2; say which: file = "runs\.xlsx#Batch 1"'
    ):
        read_recording(file.parent / "runs.xlsx", ["x"])
    with pytest.raises(InputError, match="has no sheet 'Batch 3'; it has Batch 1, Batch 2, inputs"):
        read_recording(file.parent / "runs.xlsx#Batch 3", ["x"])


def test_faults_of_a_sheet_have_its_lines(tmp_path: Path) -> None:
    _, measured = frames()
    measured["x"] = measured["x"].astype(object)
    measured.loc[7, "x"] = "20,5"
    measured.to_excel(tmp_path / "a.xlsx", index=False)
    with pytest.raises(InputError, match=r"a\.xlsx: line 9, column x: '20,5' is not a number"):
        read_recording(tmp_path / "a.xlsx", ["x"], decimal=",")


@pytest.mark.parametrize("zone", [None, "UTC"])
def test_parquet(tmp_path: Path, zone: str | None) -> None:
    file = renamed(DecayingCase().write(tmp_path), "all.parquet", "all.parquet")
    inputs, measured = frames()
    frame = inputs.merge(measured).set_index("time")
    (frame.rename_axis(None) if zone is None else frame.tz_localize(zone)).to_parquet(
        file.parent / "all.parquet"
    )
    recovered(file)
    (file.parent / "all.parquet").write_bytes((file.parent / "all.parquet").read_bytes()[:200])
    with pytest.raises(InputError, match=r"all\.parquet: is no readable Parquet file"):
        load_case(file)


def test_thousands_and_three_lines_of_header(tmp_path: Path) -> None:
    """As a building's control system writes it: kilokelvins make numbers with thousands."""
    rows = [
        f"{t:%d.%m.%Y %H:%M};{f'{1000.0 * x:,.1f}'.translate(str.maketrans(',.', '.,'))}"
        for t, x in zip(STAMPS, MEASURED, strict=True)
    ]
    assert rows[0].endswith(";312.006,3")
    text = "Export;\nzeit;x\n;mK\n;Mittel\n" + "\n".join(rows)
    inputs = ["zeit;u"] + [
        f"{t:%d.%m.%Y %H:%M};{f'{u:.10f}'.replace('.', ',')}"
        for t, u in zip(STAMPS, driving(TIME), strict=True)
    ]
    file = DecayingCase(
        measured=text, inputs="\n".join(inputs), top='time_column = "zeit"\ndecimal = ","'
    ).write(tmp_path)
    changed = (
        file.read_text()
        .replace('unit = "K"\nfile', 'unit = "mK"\nfile')
        .replace("uncertainty = 0.05", "uncertainty = 50")
    )
    file.write_text(changed)
    k, x0, rms = fitted(file)
    assert rms < 2000.0 * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


@pytest.mark.parametrize(
    ("cells", "decimal", "values"),
    [
        ("1.234,5;20", ",", 1234.5),
        ("1'234.5;20", ".", 1234.5),
        ("1 234,5;20", ",", 1234.5),
        ("-1.234.567;20", ",", -1234567.0),
        ("1.234;20", ",", 1234.0),
        ("1.234;20", ".", 1.234),
        ("1,234;20", ".", 1234.0),
        ("1.5e3;2", ".", 1500.0),
        ("1,5e3;2", ",", 1500.0),
    ],
)
def test_the_key_says_the_sign_of_decimals(tmp_path: Path, cells: str, decimal: str, values: float) -> None:
    text = f"time_s;x;y\n0;{cells}\n1;{cells}\n"
    assert read(tmp_path, text, decimal=decimal).columns["x"].tolist() == [values] * 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s;x\n0;1.234\n1;2.345\n2;\n", "'1.234' may have a decimal point or a sign of thousands"),
        ("time_s;x\n0;1.234,5\n1;12,5\n", r'column x has a comma .* decimal = "," or "."'),
        (
            "time;x\n02/03 13:30;1\n02/03 14:30;2\n",
            'the month or the day first.*"%m/%d %H:%M" or "%d/%m %H:%M"',
        ),
        ("time,x\n02/03/2024,1\n02/04/2024,1\n", '"%m/%d/%Y" or "%d/%m/%Y"'),
        ("time,x\n02/03/24 1:30 PM,1\n02/04/24 1:30 PM,1\n", '"%m/%d/%y %I:%M %p" or "%d/%m/%y %I:%M %p"'),
    ],
)
def test_what_is_ambiguous_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(tmp_path, text)


@pytest.mark.parametrize("text", ["0;0.125\n1;1.250\n", "0;20.125\n1;20.5\n", "0;20,125\n1;21,250\n"])
def test_what_is_clear_is_read(tmp_path: Path, text: str) -> None:
    found = read(tmp_path, f"time_s;x\n{text}").columns["x"]
    np.testing.assert_allclose(found, [float(line.split(";")[1].replace(",", ".")) for line in text.split()])


def test_a_number_that_is_none_with_the_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 3, column x: '12\.5' is not a number with decimal = \",\""):
        read(tmp_path, "time_s;x\n0;1.234,5\n1;12.5\n", decimal=",")


@pytest.mark.parametrize("stamp", ["2024-03-01T24:00:00", "2024/03/02 00:00", "2024-03-01 24:00"])
def test_the_end_of_a_day_and_slashes_with_the_year_first(tmp_path: Path, stamp: str) -> None:
    assert read(tmp_path, f"time,x\n2024-03-01 23:00,1\n{stamp},2\n").step_s == 3600.0


def test_a_gap_is_named_by_its_timestamps(tmp_path: Path) -> None:
    rows = [
        f"{t:%Y-%m-%d %H:%M},{u:.10g}"
        for t, u in zip(STAMPS, driving(TIME), strict=True)
        if not 2 < t.minute + 60 * t.hour < 50
    ]
    measured = "time,x\n" + "\n".join(
        f"{t:%Y-%m-%d %H:%M},{x:.6f}" for t, x in zip(STAMPS, MEASURED, strict=True)
    )
    file = DecayingCase(inputs="time,u\n" + "\n".join(rows) + "\n", measured=measured).write(tmp_path)
    with pytest.raises(InputError, match=r"from 2024-02-29 00:00 to 2024-02-29 00:50 \(3000 s\); fill"):
        load_case(file)


@pytest.mark.parametrize(
    ("begin", "what"),
    [
        (b"\xd0\xcf\x11\xe0", "a workbook of an old form"),
        (b"MATLAB 5.0", "a MATLAB"),
        (b"\x89HDF\r\n", "an HDF5 file"),
    ],
)
def test_tables_of_other_kinds_are_named(tmp_path: Path, begin: bytes, what: str) -> None:
    (tmp_path / "a.csv").write_bytes(begin + bytes(100))
    with pytest.raises(InputError, match=f"a.csv: is {what}.*; save its table as CSV, .xlsx or Parquet"):
        read_recording(tmp_path / "a.csv", ["x"])
