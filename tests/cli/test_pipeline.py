"""Stages remember what they did: same inputs and files there means finished, anything else means again."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation.arrays import FloatArray
from simulation.case import load_case
from studies.paths import ProjectPaths, find_case
from studies.profile import load_profile
from studies.results.outcome import Outcome, digest_of
from studies.results.saved import WITH_ARRAYS, Error, plain
from studies.results.stage_results import Fit
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Stage
from studies.stages.simulate_stage import TEST_SEED, TRAIN_SEED_BASE, VALIDATION_SEED, train_seed
from studies.task import Task
from studies.words.console import Console


@pytest.fixture
def task(project: Path) -> Task:
    paths = ProjectPaths(project)
    return Task(
        case=load_case(find_case(paths, "office")),
        profile=load_profile("smoke"),
        paths=paths,
        console=Console(),
        n_jobs=1,
        label="office-smoke",
        command="office",
    )


@dataclass(frozen=True, eq=False)
class Made:
    """A result with an array, a part of its own and a number that may be infinite."""

    __pydantic_config__ = WITH_ARRAYS

    n: int
    fit: Fit
    error: Error
    y: FloatArray
    absent: FloatArray | None = None
    has_failures: bool = False


RESULT = Made(7, Fit(0.5, share_within=0.1 + 0.2), np.inf, np.array([1.0, np.nan]))


class Worker:
    """Does a stage and counts how often."""

    def __init__(self, task: Task, result: Made = RESULT) -> None:
        self.task, self.n_done = task, 0
        self.result, self.is_interrupted = result, False
        self.file = task.results / "result.txt"

    def run(self, inputs: dict[str, Any], *, keep: bool = True) -> Outcome[Made]:
        def work() -> Made:
            self.n_done += 1
            if self.is_interrupted:
                raise KeyboardInterrupt
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.file.write_text("result")
            return self.result

        stage = Stage(self.task, "work", "working", inputs, Made)
        return stage.once(work, files=[self.file], is_kept=lambda _: keep)


def test_a_finished_stage_is_not_done_again(task: Task, capsys: pytest.CaptureFixture[str]) -> None:
    worker = Worker(task)
    first, second = worker.run({"a": 1}), worker.run({"a": 1})
    assert worker.n_done == 1
    assert (first.reused, second.reused) == (False, True)
    assert (
        plain(first.result)
        == plain(second.result)
        == {
            "n": 7,
            "fit": dict.fromkeys(Fit.__dataclass_fields__)
            | {"rmse": 0.5, "share_within": 0.1 + 0.2, "of_each_sample": False},
            "error": None,
            "has_failures": False,
        }
    )
    assert second.result.error == np.inf
    assert second.result.absent is None
    np.testing.assert_array_equal(second.result.y, RESULT.y)
    assert second.wall_s == pytest.approx(first.wall_s, abs=1e-3)
    assert "work: finished before" in capsys.readouterr().err


def test_other_inputs_or_a_missing_or_changed_file_mean_again(task: Task) -> None:
    worker = Worker(task)
    worker.run({"a": 1})
    worker.run({"a": 2})
    assert worker.n_done == 2
    worker.file.unlink()
    worker.run({"a": 2})
    assert worker.n_done == 3
    worker.file.write_text("half")
    worker.run({"a": 2})
    assert worker.n_done == 4
    (task.results / "work.json").write_text('{"digest": ')
    worker.run({"a": 2})
    assert worker.n_done == 5


def test_interrupted_while_failed_simulations_are_asked_again_a_stage_is_unfinished(task: Task) -> None:
    worker = Worker(task, replace(RESULT, has_failures=True))
    worker.run({})
    patient = Worker(replace(task, retry_failed=True))
    patient.is_interrupted = True
    with pytest.raises(KeyboardInterrupt):
        patient.run({})
    worker.run({})
    assert worker.n_done == 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('scale = "log"', 'scale = "linear"'),
        ("estimate = 0.7", "estimate = 0.6"),
        ("estimate = 0.7", "estimate = 0.7\nprior = { about = 0.7, within_factor = 1.5 }"),
        ("uncertainty = 0.5", "uncertainty = 0.5\nerror_lasts_s = 7200"),
    ],
)
def test_what_no_digest_holds_is_an_input_where_it_decides(task: Task, old: str, new: str) -> None:
    file = task.case.path
    before = load_case(file)
    file.write_text(file.read_text().replace(old, new, 1))
    after = load_case(file)
    assert (after.digest, after.measurement.digest) == (before.digest, before.measurement.digest)
    assert declared_inputs(after) != declared_inputs(before)


def test_a_manifest_says_what_made_it(task: Task) -> None:
    Worker(task).run({"a": 1})
    manifest = json.loads((task.results / "work.json").read_text())
    assert manifest["inputs"] == {"a": 1}
    assert manifest["files"] == {
        "mlruns/results/office-smoke/result.txt": 6,
        "mlruns/results/office-smoke/work.npz": (task.results / "work.npz").stat().st_size,
    }
    assert manifest["seed"] == 0
    assert {"python", "numpy", "torch", "platform"} <= set(manifest["environment"])
    assert {"wall_s", "finished"} <= set(manifest)


def test_no_seed_trains_on_the_rows_that_judge() -> None:
    near = range(VALIDATION_SEED - TRAIN_SEED_BASE - 3, VALIDATION_SEED - TRAIN_SEED_BASE + 5)
    seeds = [train_seed(seed) for seed in (0, 1, *near)]
    assert not {VALIDATION_SEED, TEST_SEED} & set(seeds)
    assert len(set(seeds)) == len(seeds)
    assert train_seed(0) == TRAIN_SEED_BASE


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=5), min_size=1, max_size=5))
def test_digests_depend_on_content_and_not_on_order(content: dict[str, Any]) -> None:
    backwards = dict(reversed(list(content.items())))
    assert digest_of(content) == digest_of(backwards)
    name = next(iter(content))
    assert digest_of(content) != digest_of({**content, name: [content[name]]})


def test_a_run_that_could_not_be_logged_is_logged_by_the_next_command(task: Task) -> None:
    stage, logged = Stage(task, "made", "made up", {"x": 1}, Made), list[int]()

    def refuse(_: Task, outcome: Outcome[Made]) -> None:
        logged.append(outcome.result.n)
        if len(logged) == 1:
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        stage.once(lambda: RESULT, log=refuse)
    assert stage.once(lambda: replace(RESULT, n=8), log=refuse).result.n == 7  # it was stored before
    assert logged == [7, 7]
    stage.once(lambda: RESULT, log=refuse)
    assert logged == [7, 7]


def test_a_result_stays_until_the_new_one_is_whole(task: Task) -> None:
    stage = Stage(task, "made", "made up", {"x": 1}, Made)
    stage.once(lambda: RESULT)

    def fail() -> Made:
        raise KeyboardInterrupt

    assert stage.is_anew
    with pytest.raises(KeyboardInterrupt):
        stage.once(fail, again=True)
    assert not stage.is_anew  # the same command goes on
    assert stage.once(fail).result.n == 7
    assert stage.once(lambda: replace(RESULT, n=8), again=True).result.n == 8
    assert stage.once(fail).result.n == 8
    assert stage.is_anew
