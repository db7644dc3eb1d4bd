"""What `studies status` and `studies best` say of records, without a training."""

import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path

import pytest
from project_for_tests import REPOSITORY, Run
from records_on_disk import STARTED_S, write_manifest, write_study

from studies.looking.pace import trials_per_s
from studies.tuning.claim import Claim, this_owner
from studies.tuning.trial_store import TrialStore

LIMIT_S = 60.0


def begin(store: TrialStore, index: int, *, owner: dict[str, object] | None = None) -> None:
    """Claim a trial as a worker does, and beat once."""
    empty = Claim(index, {}, {}, 0, "random", time.time(), max_epochs=400)
    claim = empty.taken(this_owner() if owner is None else owner, time.time())
    store.put_claim(claim)
    store.beat(claim, epoch=100, value=0.5)


def test_an_empty_project_says_what_to_type_first(project: Path, studies: Run) -> None:
    for command in ("status", "best"):
        answer = studies(command)
        assert answer.code == 0
        assert "studies run" in answer.out
        assert len(answer.out.splitlines()) == 1
    assert studies("status", "--json").document["studies"] == []
    assert studies("show", "anything").code == 2


def test_every_study_has_a_line_and_the_counts_are_those_of_its_records(project: Path, studies: Run) -> None:
    store = write_study(project, "office-quick", 64, n_trials=12, n_planned=20)
    write_study(project, "office-quick", 128, n_trials=3)
    (first, second) = studies("status", "--json").document["studies"]
    states = [record.state for record in store.records()]
    assert (first["n_complete"], first["n_pruned"], first["n_failed"]) == tuple(
        states.count(state) for state in ("complete", "pruned", "failed")
    )
    assert (first["n_done"], first["n_planned"], first["mood"]) == (12, 20, "stopped")
    assert (second["n_train"], second["mood"], second["unit"]) == (128, "finished", "K")
    least = min(record.metrics["val/mae"] for record in store.records() if record.state == "complete")
    assert first["best_metrics"]["val/mae"] == least
    lines = studies("status").out.splitlines()
    assert any("office-quick/n0064" in line and "12/20" in line and f"{least:.3f}" in line for line in lines)
    assert any("office-quick/n0128" in line and "3/3" in line and "done" in line for line in lines)


def test_running_trials_are_shown_with_the_time_to_go_and_dead_ones_as_lost(
    project: Path, studies: Run
) -> None:
    store = write_study(project, "office-quick", 64, n_trials=10, n_planned=20)
    begin(store, 10)
    begin(store, 11, owner=this_owner() | {"pid": 2**22 + 1})
    write_study(project, "office-quick", 128, n_trials=0, n_planned=5)
    document = studies("status", "--json").document
    first, second = document["studies"]
    assert (first["mood"], first["n_running"], second["mood"]) == ("running", 1, "waiting")
    # A trial a minute (see records_on_disk), ten left of which a quarter of one is done.
    assert first["to_go_s"] == pytest.approx((10 - 0.25) * 60.0, rel=0.05)
    assert [(trial["index"], trial["is_lost"]) for trial in document["running"]] == [(10, False), (11, True)]
    out = studies("status").out
    assert "office-quick/n0064/t010  100/400" in out
    assert "lost" in out


def test_the_names_of_twins_mean_themselves(project: Path, studies: Run) -> None:
    write_study(project, "office-quick", 64, n_trials=4, seed=1)
    write_study(project, "office-quick", 64, n_trials=4, seed=2)
    for line in studies("status", "--json").document["studies"]:
        shown = studies("show", line["study"], "--json").document
        best = shown["trials"][shown["best_trial"]]
        assert (shown["name"], best["metrics"]) == (line["study"], line["best_metrics"])
    (bench,) = studies("best", "--json").document["benches"]
    (model,) = bench["models"]
    assert model["trial"] == f"{model['study']}/t{model['index']:03d}"
    assert model["trial"] in studies("best").out
    assert studies("show", model["trial"], "--json").document["metrics"] == model["metrics"]


@pytest.mark.parametrize("text", ["", '{"study": "office-quick/n00', "[]", "{}"])
def test_a_damaged_record_is_named_in_one_line(project: Path, studies: Run, text: str) -> None:
    store = write_study(project, "office-quick", 64, n_trials=3)
    Path(store.place, "t001", "trial.json").write_text(text, encoding="utf-8")
    for command in (("status",), ("best",), ("show", "office-quick/n0064/t000")):
        answer = studies(*command)
        assert answer.code == 2
        assert "t001/trial.json: cannot be read" in answer.err
        assert "studies doctor --repair" in answer.err
        assert answer.err.count("\n") == 1


def test_a_pause_does_not_count_for_the_pace(project: Path) -> None:
    store = write_study(project, "office-quick", 64, n_trials=4)
    assert trials_per_s(store.records()) == pytest.approx(4 / (3 * 60.0 + 55.0))
    next_day = write_study(project, "office-next", 64, n_trials=2, started_s=STARTED_S + 86_400.0).records()
    both = [*store.records(), next_day[0]]
    assert trials_per_s(both) == pytest.approx(1 / 55.0)
    assert trials_per_s([]) is None


def test_labels_are_chosen_by_case_label_or_pattern(project: Path, studies: Run) -> None:
    for label in ("office-quick", "office-quick-seed1", "office-paper"):
        write_study(project, label, 64, n_trials=1)

    def labels(which: str) -> list[str]:
        return [study["label"] for study in studies("status", which, "--json").document["studies"]]

    write_study(project, "office-recorded-quick", 64, n_trials=1, case="office-recorded")
    assert labels("office") == ["office-paper", "office-quick", "office-quick-seed1"]
    assert labels("office-quick") == ["office-quick"]
    assert labels("office-recorded") == ["office-recorded-quick"]
    write_study(project, "wall-quick", 64, n_trials=1, case="the wall")
    assert labels("wall") == ["wall-quick"]
    assert labels("office-paper") == ["office-paper"]
    assert labels("*-seed?") == ["office-quick-seed1"]
    answer = studies("status", "ofice-paper")
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert "did you mean office-paper?" in answer.err


def test_best_compares_only_what_was_judged_alike(project: Path, studies: Run) -> None:
    stores = [write_study(project, f"office-quick-seed{seed}", 64, n_trials=8, seed=seed) for seed in (1, 2)]
    elsewhere = {
        "case": "1" * 64,
        "fmu": "2" * 64,
        "train": "3" * 64,
        "validation": "9" * 64,
        "test": "5" * 64,
    }
    write_study(project, "office-other", 64, n_trials=2, seed=3, digests=elsewhere)
    alike, other = sorted(studies("best", "--json").document["benches"], key=lambda b: -len(b["labels"]))
    assert alike["labels"] == ["office-quick-seed1", "office-quick-seed2"]
    complete = [r for store in stores for r in store.records() if r.state == "complete"]
    least = min(complete, key=lambda record: record.metrics["val/mae"])
    (model,) = alike["models"]
    assert (model["study"], model["index"]) == (least.study, least.index)
    assert model["n_trials"] == 16
    default = next(r for r in complete if r.study == least.study and r.index == 0)
    assert model["gain"] == pytest.approx(1 - least.metrics["val/mae"] / default.metrics["val/mae"])
    assert other["labels"] == ["office-other"]
    assert "not comparable" in studies("best").out
    answer = studies("best", "--n-train", "99")
    assert answer.code == 2
    assert "there are 64" in answer.err


def test_best_tells_a_small_gain_from_none(project: Path, studies: Run) -> None:
    store = write_study(project, "office-quick", 64, n_trials=1)
    (default,) = store.records()
    slightly = default.metrics | {"val/mae": 0.996 * default.metrics["val/mae"]}
    store.write(replace(default, index=1, metrics=slightly), {})
    shown = studies("best").out
    assert " -0.4 % " in shown
    assert "by 0.4 % of its validation error" in shown


def test_best_tells_errors_of_an_output_that_is_a_small_number(project: Path, studies: Run) -> None:
    store = write_study(project, "office-quick", 64, n_trials=1)
    (default,) = store.records()
    small = default.metrics | {"val/mae": 0.000234, "test/mae": 3.21e-5}
    store.write(replace(default, index=1, metrics=small), {})
    shown = studies("best").out
    assert " 0.000234 " in shown
    assert " 3.21e-05 " in shown


def test_compare_tells_errors_of_one_output_in_its_own_unit(project: Path, studies: Run) -> None:
    store = write_study(project, "office-quick", 64, n_trials=2)
    assert "(errors in K)" in studies("compare", "n64/t0", "n64/t1").out
    for record in store.records():
        store.write(
            replace(record, index=record.index + 2, metrics=record.metrics | {"val/mae_power": 7.0}), {}
        )
    assert "(errors in K; mae_... in that output's unit)" in studies("compare", "n64/t2", "n64/t3").out


def test_best_shows_the_parameters_of_the_best_calibration(project: Path, studies: Run) -> None:
    for n_train, mse in ((64, 0.04), (128, 0.02)):
        summary = {
            "n_train": n_train,
            "mse_polished": mse,
            "theta": {"UWin": 0.5 + mse, "b": 1.25},
            "ledger": {"total_paper": 100, "total_honest": 200},
            "case_sha256": "1",
            "measurement_sha256": "2",
            "restriction": {"fixed": {"b": 1.25}, "why": {"b": "its estimate"}},
        }
        write_manifest(project, "office-quick", f"calibrate-n{n_train:04d}", summary)
    (found,) = studies("best", "--json").document["calibrations"]
    assert (found["name"], found["theta"]) == ("office-quick/calibrate-n0128", {"UWin": 0.52, "b": 1.25})
    assert found["fixed"] == {"b": {"value": 1.25, "unit": "", "why": "its estimate"}}
    shown = studies("best", "office-quick").out
    calibrated, _, fixed = shown.partition("fixed as least relevant")
    assert "0.52" in calibrated
    assert "1.25" not in calibrated
    assert ["b", "1.25", "its", "estimate"] in [line.split() for line in fixed.splitlines()]
    assert "MSE 0.02000, 100 model calls in the paper's count\n" in shown
    assert "0.02000" in studies("status").out


def test_calibrations_without_a_surrogate_have_a_unit_and_each_case_its_best(
    project: Path, studies: Run
) -> None:
    units = {"vanderpol": "V²", "wall": "K²"}
    for k, case in enumerate(units):
        text = (REPOSITORY / "fmus" / case / "case.toml").read_text(encoding="utf-8")
        for window, mse in (("", 0.03), ("-0-9", 0.04 + 0.01 * k)):
            label = f"{case}-quick{window}"
            summary = {
                "n_train": 0,
                "mse": mse,
                "theta": {"U": 0.5 + mse},
                "ledger": {"total_paper": 20, "total_honest": 20},
                "case_sha256": f"{case}{window}",
                "measurement_sha256": "2",
            }
            write_manifest(
                project, label, "calibrate-adaptive", summary, finished=f"2026-01-0{1 + len(window)}"
            )
            told = {"name": case, "text": text, "place": f"fmus/{case}/case.toml"}
            told |= dict.fromkeys(("digest", "measurement_digest", "text_sha256"), "1" * 64)
            recipe = {"case": told, "files": [], "window_d": [0.0, 9.0]}
            numbers = {**summary, "recipe": recipe}
            file = project / "mlruns" / "results" / label / "calibration-adaptive.json"
            file.write_text(json.dumps(numbers), encoding="utf-8")
    found = {
        one["case"]: (one["name"], one["unit"]) for one in studies("best", "--json").document["calibrations"]
    }
    # The one of the latest window: errors on other windows are not comparable.
    assert found == {case: (f"{case}-quick-0-9/calibrate-adaptive", unit) for case, unit in units.items()}
    shown = studies("best").out
    # There is nothing that the paper would count otherwise.
    assert "vanderpol: best calibration: MSE 0.04000 V², 20 model calls\n" in shown
    assert "wall: best calibration: MSE 0.05000 K², 20 model calls\n" in shown
    assert "wall" not in studies("best", "vanderpol").out
    card = studies("show", "vanderpol-quick-0-9/calibrate-adaptive")
    assert "0.04000 V²" in card.out, card.err
    lines = [line for line in studies("status").out.splitlines() if "calibrate-adaptive" in line]
    assert len(lines) == 4
    assert all(units[line.split()[0].split("-")[0]] in line for line in lines)


def test_looking_loads_nothing_heavy(project: Path) -> None:
    write_study(project, "office-quick", 64, n_trials=2)
    program = (
        "import sys\nfrom studies.cli import main\nmain(['status'])\n"
        "heavy = ('torch', 'mlflow', 'optuna', 'pyarrow', 'scipy', 'matplotlib', 'fmpy')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=in_project(project)
    )
    assert done.stdout.splitlines()[-1] == "[]"


def in_project(project: Path) -> dict[str, str]:
    return os.environ | {"STUDIES_ROOT": str(project), "PYTHONPATH": str(REPOSITORY), "TERM": "xterm"}


@pytest.mark.parametrize(
    ("columns", "shown", "left_out"), [(80, "MAE test", "last sign"), (140, "last sign", "")]
)
def test_live_draws_until_ctrl_c_and_leaves_what_fits_the_terminal(
    project: Path, columns: int, shown: str, left_out: str
) -> None:
    write_study(project, "office-quick", 64, n_trials=2)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    words = [sys.executable, "-m", "studies", "status", "--live"]
    # The terminal tells its size, not what the tests' own terminal is said to have.
    environment = {k: v for k, v in in_project(project).items() if k not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(
        words, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, env=environment, close_fds=True
    )
    os.close(theirs)
    seen = ""
    deadline = time.monotonic() + LIMIT_S
    while seen.count("office-quick/n0064") < 2:
        assert time.monotonic() < deadline
        seen += os.read(ours, 4096).decode(errors="replace")
        if "office-quick/n0064" in seen and seen.count("office-quick/n0064") == 1:
            # a second study appears while it is watched
            write_study(project, "office-quick", 128, n_trials=1)
    process.send_signal(signal.SIGINT)
    rest = ""
    try:
        while chunk := os.read(ours, 4096):
            rest += chunk.decode(errors="replace")
    except OSError:
        pass  # the terminal has no writer left
    assert process.stderr is not None
    with process.stderr as stderr:
        assert stderr.read() == b""
    assert process.wait(LIMIT_S) == 0
    os.close(ours)
    # The alternate screen is left, and the last table stands on the terminal's own.
    last = rest.rpartition("\x1b[?1049l")[2]
    assert "office-quick/n0064" in last
    assert shown in last
    assert not left_out or left_out not in last


def test_without_a_terminal_live_prints_once(project: Path, studies: Run) -> None:
    write_study(project, "office-quick", 64, n_trials=2)
    answer = studies("status", "--live")
    assert answer.code == 0
    assert answer.out.count("office-quick/n0064") == 1
    assert "\x1b" not in answer.out
    assert studies("status", "--live", "--json").document["command"] == "status"
