"""Calibrated values as files: read back by others' readers and simulated, the error is the same."""

import csv
import dataclasses
import json
import re
import shutil
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssv
from fmpy.validation import validate_fmu
from mlflow_store_for_tests import give_store

from simulation.case import Case, load_case
from simulation.case_reading import read_experiments
from simulation.fmi.description import read_description
from simulation.fmi.variable import Value
from studies.cli import main
from studies.exports.calibrated_values import CalibratedValues, as_csv, calibrated_values
from studies.paths import find_project
from studies.project import read_project

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT), str(ROOT / "tests" / "simulation")]  # the compiler, and an FMU with every type


@pytest.fixture(scope="module", params=["office", "kinds3"])
def project(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with one calibrated case; to be read only."""
    root = tmp_path_factory.mktemp(request.param) / "project"
    give_store(root)
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    for folder in ("fmus", "data"):
        shutil.copytree(ROOT / folder / "office", root / folder / "office")
    if request.param != "office":
        write_kinds_case(root, fmi=int(request.param[-1]))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        name = request.param.rstrip("23")
        assert main(["calibrate", name, "--max-calls", "15", "--jobs", "1", "-q"]) == 0
    return root


def write_kinds_case(root: Path, *, fmi: int) -> None:
    """Write a case that calibrates a parameter, a start value and an input, and fixes one of each type."""
    import kinds_fmu

    folder = root / "fmus" / "kinds"
    folder.mkdir()
    fmu = kinds_fmu.build_kinds_fmu(folder, fmi=fmi)
    text = (ROOT / "tests" / "simulation" / "kinds.toml").read_text("utf-8")
    text = text.format(fmu=fmu.name, output="y", shared="")
    begin, end = text.index('[[inputs]]\nname = "u"'), text.index('[[inputs]]\nname = "on"')
    calibrated = '[[parameters]]\nname = "{}"\nlower = {}\nupper = {}\nunit = "1"\n\n'
    free = calibrated.format("x0", 200.0, 400.0) + calibrated.format("u", 0.0, 0.01)
    text = text[:begin] + text[end:].replace(
        "[fixed]", free + '[fixed]\nn = 3\nb = true\nc = "high"\ns = "a \\"<b"'
    )
    (folder / "case.toml").write_text(text, encoding="utf-8")
    time = 1800.0 * np.arange(26)
    rows = [f"{t:g},{i % 2},{i % 5},{300.0 * np.exp(-1e-5 * t) + 20.0}" for i, t in enumerate(time)]
    (folder / "recording.csv").write_text("\n".join(["time_s,on,level,y", *rows]) + "\n", encoding="utf-8")


@pytest.fixture(autouse=True)
def _here(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STUDIES_ROOT", str(project))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def found() -> CalibratedValues:
    return calibrated_values(read_project(find_project(None)))


def written(kind: str) -> Path:
    assert main(["best", "--write", kind, f"values.{kind}", "-q"]) == 0
    return Path(f"values.{kind}")


def error_with(case: Case, values: Mapping[str, Value]) -> float:
    """Simulate a case with values in the FMU's units."""
    settings = dataclasses.replace(
        case.settings,
        parameter_factors=None,
        parameter_offsets=None,
        fixed={name: values[name] for name in case.fixed},
    )
    row = np.array([[float(values[name]) for name in case.parameter_space.names]])
    with settings.open() as model:
        return float(case.measurement.mse(model.simulate(row).y)[0])


def typed(case: Case, texts: Mapping[str, str]) -> dict[str, Value]:
    """Give texts of a file the types that the FMU declares."""
    values: dict[str, Value] = {}
    for name, text in texts.items():
        kind = case.fmu.variables[name].kind
        values[name] = (
            text == "true"
            if kind == "Boolean"
            else text
            if kind == "String"
            else float(text)
            if kind in ("Real", "Float64")
            else int(text)
        )
    return values


def test_a_parameter_set_is_valid_and_gives_the_same_error(found: CalibratedValues) -> None:
    file = written("ssv")
    read = read_ssv(str(file), validate=True)  # by the schema of the standard
    values = {one.name: one.value for one in read.parameters}
    assert list(values) == [one.name for one in found.values]
    assert error_with(found.case, typed(found.case, values)) == found.finished.found.mse
    defined = {one.get("name") for one in ElementTree.parse(file).getroot().iterfind("{*}Units/{*}Unit")}
    assert {one.unit for one in read.parameters} - {None} == defined


def test_tables_give_the_same_error_and_name_their_origin(found: CalibratedValues) -> None:
    document = json.loads(written("json").read_text("utf-8"))
    values = {one["name"]: one["value"] for one in document["values"]}
    assert error_with(found.case, values) == found.finished.found.mse == document["mse"]
    about, *lines = written("csv").read_text("utf-8").splitlines()
    assert about.startswith(f"# case: {found.case.name}, case_digest: {found.case.digest}, command: studies ")
    rows = list(csv.DictReader(lines))
    texts = {row["name"]: row["value"].replace("True", "true") for row in rows}
    assert error_with(found.case, typed(found.case, texts)) == found.finished.found.mse
    origins = [row["origin"] for row in rows]
    assert origins.count("calibrated") == found.case.parameter_space.n_parameters
    assert origins.count("fixed") == len(found.case.fixed)
    units = {row["name"]: row["unit"] for row in rows}
    assert units[rows[0]["name"]] == found.case.fmu.variables[rows[0]["name"]].unit


def test_no_cell_of_a_table_is_a_formula(found: CalibratedValues) -> None:
    formula = "=cmd|' /C calc'!A0"
    first = dataclasses.replace(found.values[0], value=formula, unit="@x", origin="+1")
    finished = dataclasses.replace(found.finished, changed_since=("a", formula))
    text = as_csv(dataclasses.replace(found, values=(first, *found.values[1:]), finished=finished)).decode()
    cells = [cell for line in csv.reader(text.splitlines()) for cell in line]
    assert not [cell for cell in cells if cell.strip()[:1] in ("=", "@", "+")]
    assert {f"'{formula}", "'@x", "'+1"} <= {*cells}


def test_an_fmu_starts_with_the_values_and_is_otherwise_the_same(found: CalibratedValues) -> None:
    file = written("fmu")
    before_and_after = [validate_fmu(str(fmu)) for fmu in (found.case.fmu.path, file)]
    assert before_and_after[0] == before_and_after[1]
    new, old = read_description(file), found.case.fmu
    assert (new.guid, new.variables.keys()) == (old.guid, old.variables.keys())
    changed = {one.name for one in found.values}
    for name, variable in new.variables.items():
        if name not in changed:
            assert variable.start_text == old.variables[name].start_text
    settings = dataclasses.replace(found.case.settings, path=file)
    case = dataclasses.replace(found.case, settings=settings, fmu=new)
    texts = {name: new.variables[name].start_text for name in changed}
    assert error_with(case, typed(case, texts)) == found.finished.found.mse
    with zipfile.ZipFile(old.path) as before, zipfile.ZipFile(file) as after:
        assert before.namelist() == after.namelist()
        same = [one for one in before.namelist() if one != "modelDescription.xml"]
        assert all(before.read(one) == after.read(one) for one in same)
        assert [one.external_attr for one in before.infolist()] == [
            one.external_attr for one in after.infolist()
        ]


def test_a_modelica_compiler_makes_a_model_with_the_values(found: CalibratedValues) -> None:
    pytest.importorskip("casadi")
    pytest.importorskip("pymoca")
    file = written("modelica")
    if found.case.name != "office":
        text = file.read_text("utf-8")
        assert "x0(\n      start = " in text
        assert 's = "a \\"<b"' in text
        assert "// not set: c = item 7, whose type the FMU does not name" in text
        return
    from fmus.compiler.package import build_fmu

    source = ROOT / "fmus" / "office"
    Path("Office.mo").write_bytes((source / "Office.mo").read_bytes() + file.read_bytes())
    settings = (source / "build.toml").read_text("utf-8").replace("Office.R7C4Office", "Calibrated_office")
    Path("build.toml").write_text(settings, encoding="utf-8")
    built = read_description(build_fmu(Path()))
    values = {one.name: built.variables[one.name].start for one in found.values}
    assert (
        error_with(found.case, {k: v for k, v in values.items() if v is not None}) == found.finished.found.mse
    )


def test_a_changed_case_is_refused(
    project: Path, found: CalibratedValues, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    copy = tmp_path / "copy"
    shutil.copytree(project, copy)
    monkeypatch.setenv("STUDIES_ROOT", str(copy))
    file = copy / "fmus" / found.case.name / "case.toml"
    text = file.read_text("utf-8")
    file.write_text(
        text.replace("communication_step_s = 600", "communication_step_s = 300"), encoding="utf-8"
    )
    assert load_case(file).digest != found.case.digest
    assert main(["best", "--write", "ssv"]) == 2
    assert "changed since 'studies calibrate" in capsys.readouterr().err


def test_what_was_changed_since_is_said_on_the_terminal(
    project: Path, found: CalibratedValues, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    copy = tmp_path / "copy"
    shutil.copytree(project, copy)
    monkeypatch.setenv("STUDIES_ROOT", str(copy))
    file = copy / "fmus" / found.case.name / "case.toml"
    written("csv")
    assert "calibrated before" not in capsys.readouterr().err
    text = file.read_text("utf-8")
    before, begin, rest = text.partition("uncertainty = ")
    weighted = f"{before}weight = 2.0\n{begin}{rest}"
    shorter = re.sub(
        r"(?<=^window_d = \[)([\d.]+), ([\d.]+)(?=\])",
        lambda found: f"{found[1]}, {float(found[2]) - 0.125}",
        text,
        count=1,
        flags=re.MULTILINE,
    )
    for new, keys in ((weighted, "outputs"), (shorter, "time")):
        assert new != text
        file.write_text(new, "utf-8")
        assert main(["best", "--write", "csv", f"{keys}.csv", "-q"]) == 0
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{keys}.csv: calibrated before case.toml ({keys}) changed; to calibrate anew: studies" in line
    file.write_text(text, "utf-8")
    (source,) = {output.file for one in read_experiments(file) for output in one.file.outputs}
    recording = file.parent / read_experiments(file)[0].file.data / str(source)
    recording.write_text(recording.read_text("utf-8") + "\n", "utf-8")
    assert main(["best", "--write", "csv", "data.csv", "-q"]) == 0
    assert f"calibrated before {recording.name} changed" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_refused_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    Path("file").touch()
    for place in ("/proc/values.csv", "file/values.csv", "x" * 300):
        assert main(["best", "--write", "csv", place]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"studies: error: {place}: cannot be written (")
