"""One bit of a record is flipped: commands name the file, and what makes it anew."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project_for_tests import Run, copy_of

from studies.paths import ProjectPaths
from studies.server import Server, give_identity
from studies.tracking.sent_runs import SentRuns

TASK = ("office", "--profile", "smoke", "--jobs", "1", "-q")
RESULTS = "mlruns/results/office-smoke"


def content_of(text: bytes) -> Any:
    """Return what a record says, without its checksum."""
    try:
        content = json.loads(text)
    except ValueError:
        return None
    return {name: value for name, value in content.items() if name != "checksum"}


def flip_a_bit(file: Path, rng: np.random.Generator) -> bytes:
    """Flip a bit of what a record says, and return the whole record; blanks and its checksum say nothing."""
    whole = file.read_bytes()
    while True:
        place = int(rng.integers(8 * len(whole)))
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << place % 8
        if content_of(bytes(damaged)) != content_of(whole):
            file.write_bytes(damaged)
            return whole


@pytest.fixture
def project(whole_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(whole_run, tmp_path / "project", monkeypatch)


def assert_named(studies: Run, file: Path, *words: str, remedy: str) -> None:
    """Flip bits at three places and look at what a command says; the file is whole again afterwards."""
    rng = np.random.default_rng(list(file.name.encode()))
    for _ in range(3):
        whole = flip_a_bit(file, rng)
        answer = studies(*words)
        file.write_bytes(whole)
        assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
        assert f"{file} is damaged" in answer.err
        assert remedy in answer.err


def test_a_result_is_named_with_its_command(project: Path, studies: Run) -> None:
    records = sorted((project / RESULTS).glob("*.json"))
    stages = {one.stem.partition("-")[0] for one in records}
    assert stages == {"check", "simulate", "sensitivity", "calibrate", "report"}
    for file in records:
        remedy = f"studies {file.stem.partition('-')[0]} makes it anew"
        assert_named(studies, file, "report", *TASK, remedy=remedy)
        if file.stem.startswith("calibrate"):
            assert_named(studies, file, "status", remedy=remedy)


def test_arrays_of_a_result_are_made_anew_with_a_line(project: Path, studies: Run) -> None:
    record = project / RESULTS / "calibrate-n0016.json"
    arrays, before = record.with_suffix(".npz"), json.loads(record.read_bytes())
    damaged = bytearray(arrays.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    arrays.write_bytes(damaged)
    answer = studies("status")
    assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
    assert f"{arrays} is damaged; remove {record.name}, and studies calibrate" in answer.err
    answer = studies("calibrate", *TASK, "--method", "paper", "--n-train", "16")
    assert answer.code == 0
    assert f"{arrays} is damaged" in answer.err
    assert "calibrate-n0016 is done again" in answer.err
    assert json.loads(record.read_bytes())["result"]["theta"] == before["result"]["theta"]


def test_what_made_a_run_is_named(project: Path, studies: Run) -> None:
    file = next(project.glob("mlruns/artifacts/*/*/artifacts/provenance.json"))
    run = file.parts[-3]
    assert_named(studies, file, "reproduce", run, "-q", remedy=f"take another run than {run}")


def test_a_surrogate_is_named(project: Path, studies: Run) -> None:
    for file in project.glob("mlruns/artifacts/*/*/artifacts/surrogate/surrogate.json"):
        flip_a_bit(file, np.random.default_rng(0))
    again = ("--method", "paper", "--n-train", "16", "--again")
    answer = studies("calibrate", *TASK, *again)
    assert (answer.code, len(answer.err.splitlines())) == (2, 1), answer.err
    assert "surrogate.json is damaged (" in answer.err
    assert "train or copy it again" in answer.err


def test_a_list_of_sent_runs_is_named(project: Path, studies: Run) -> None:
    uri = "http://127.0.0.1:9"
    give_identity(project / "studies.toml")
    paths, server = ProjectPaths(project), Server(uri, uri)
    SentRuns(uri, {"office-smoke": "7"}, {"a" * 32: {"id": "b" * 32}}).write(paths, server)
    assert SentRuns.read(paths, server).id_of("a" * 32) == "b" * 32
    (file,) = project.glob("mlruns/sent/*.json")
    assert_named(studies, file, "best", "--json", "--tracking", uri, remedy="asks the server anew")
    content = json.loads(file.read_bytes())
    del content["checksum"]  # as earlier versions wrote it
    file.write_text(json.dumps(content))
    assert SentRuns.read(paths, server).id_of("a" * 32) == "b" * 32


def test_a_time_of_a_simulation_is_measured_anew(project: Path, studies: Run) -> None:
    (file,) = project.glob("data/office/generated/simulations/*.time.json")
    flip_a_bit(file, np.random.default_rng(0))
    assert studies("run", *TASK, "--dry-run").code == 0
