"""What the command line promises: help that teaches, one JSON document, quiet runs, labels, lazy imports."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from project_for_tests import REPOSITORY, Run, copy_of, process_environment

from studies.cli import COMMANDS, EPILOG, build_parser, help_of, main
from studies.words.console import Column, Console

HEAVY = (
    "torch",
    "mlflow",
    "optuna",
    "vl_convert",
    "numba",
    "fmpy",
    "SALib",
    "scipy",
    "numpy",
    "pydantic",
    "rich",
)


def test_help_answers_without_any_heavy_import() -> None:
    program = (
        "import sys\nfrom studies.cli import main\nmain(['--help'])\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        check=True,
    )
    assert done.stderr == "[]\n"
    for command in COMMANDS:
        assert command in done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_says_what_happens_and_gives_examples(
    studies: Run, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    answer = studies(command, "--help")
    assert answer.code == 0
    assert answer.err == ""
    assert "What happens:" in answer.out
    assert f"Examples:\n  studies {command}" in answer.out
    explained = [line for line in answer.out.splitlines() if not line.startswith(" ")]
    assert max(map(len, explained)) <= 80


def examples(text: str) -> list[list[str]]:
    """Return the words of the commands that a help shows as examples."""
    lines = [line.strip() for line in text.splitlines() if line.startswith("  studies ")]
    return [shlex.split(re.split(r"\s{2,}", line)[0])[1:] for line in lines]


def test_every_command_in_an_example_is_understood() -> None:
    shown = [words for text in (EPILOG, *(help_of(c)[1] for c in COMMANDS)) for words in examples(text)]
    assert len(shown) > 15
    for words in shown:
        build_parser().parse_args(words)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_works_on_the_storage_that_is_named(
    new_project: Path, studies: Run, command: str
) -> None:
    """A storage that cannot be one shows which commands open it before they do anything."""
    answer = studies(*examples(help_of(command)[1])[0], "--storage", "sqlite:///other.db")
    assert (answer.code, answer.out) == (2, "")
    assert "the storage is no PostgreSQL URL" in answer.err


def test_version(studies: Run) -> None:
    answer = studies("--version")
    assert answer.code == 0
    assert re.fullmatch(r"studies (\d+\.\d+\.\d+\S*|\(not installed\))\n", answer.out)


def test_simulate_as_json_is_one_document_and_the_rest_on_stderr(project: Path, studies: Run) -> None:
    answer = studies("simulate", "--profile", "smoke", "--json")
    assert answer.code == 0
    (stage,) = answer.document["stages"]
    assert stage["n"] == {"train": 32, "validation": 32, "test": 32}
    assert not stage["finished_before"]
    assert answer.err.startswith("simulate: 96 simulations")
    again = studies("simulate", "--profile", "smoke", "--json", "--quiet")
    assert again.err == ""
    (reused,) = again.document["stages"]
    assert reused["finished_before"]
    assert reused["files"] == stage["files"]


def test_sets_and_labels_follow_sizes_windows_and_seeds(project: Path, studies: Run) -> None:
    arguments = ("simulate", "--profile", "smoke", "--json", "-q")
    plain = studies(*arguments).document
    assert plain["label"] == "office-smoke"
    first = plain["stages"][0]["files"]
    own = studies(*arguments, "--window", "0-240h").document
    assert (own["label"], own["stages"][0]["finished_before"]) == ("office-smoke", True)
    other = studies(*arguments, "--window", "8-16", "--seed", "3").document
    assert other["label"] == "office-smoke-d8-16-seed3"
    assert set(other["stages"][0]["files"].values()).isdisjoint(first.values())
    seeded = studies(*arguments, "--window", "0-10", "--seed", "3").document
    assert seeded["label"] == "office-smoke-seed3"
    files = seeded["stages"][0]["files"]
    assert files["train"] != first["train"]
    assert (files["validation"], files["test"]) == (first["validation"], first["test"])
    # A larger training set goes on from the smaller one.
    profile = (REPOSITORY / "studies" / "profiles" / "smoke.toml").read_text()
    (project / "larger.toml").write_text(
        profile.replace('name = "smoke"', 'name = "larger"').replace("[16, 32]", "[16, 200]")
    )
    larger = studies("simulate", "--profile", "larger.toml", "--json").document
    (stage,) = larger["stages"]
    assert (larger["label"], stage["n"]["train"], stage["n_reused"]) == ("office-larger", 200, 96)


def test_ui_refuses_a_label_without_work(project: Path, studies: Run) -> None:
    answer = studies("ui", "office-quik")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "MLflow has no experiment 'office-quik'; there are: none" in answer.err


def test_indices_without_a_surrogate_name_what_to_type(new_project: Path, studies: Run) -> None:
    answer = studies("sensitivity", "--profile", "smoke")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.count("\n") == 1
    assert "type: studies tune office --profile smoke; or ask the FMU: " in answer.err
    assert answer.err.endswith("studies sensitivity office --profile smoke --fmu\n")


def test_a_plan_says_what_is_to_do_and_writes_nothing(new_project: Path, studies: Run) -> None:
    before = sorted(new_project.rglob("*"))
    document = studies("run", "--profile", "smoke", "--dry-run", "--json").document
    assert document["n_simulations"] == 96
    assert [one["stage"] for one in document["plan"]] == ["simulate", "polish"]
    assert all(one["simulations_s"] > 0.0 for one in document["plan"])
    assert document["sizes"] == [
        {"n_train": n_train, "n_left": 2, "training_s": None} for n_train in (16, 32)
    ]
    shown = studies("tune", "--profile", "smoke", "--dry-run").out
    assert re.search(r"^ simulations of the sets +96 +[\d.]+ ms$", shown, re.MULTILINE)
    assert "unknown before the first trial" in shown
    (search,) = studies("calibrate", "--max-calls", "7", "--dry-run", "--json").document["plan"]
    assert (search["stage"], search["n_simulations"]) == ("search", 7)
    for words, stage, n in (
        (("simulate", "--profile", "smoke"), "simulate", 96),
        (("sensitivity", "--profile", "smoke", "--fmu"), "sensitivity", 8 * 16),
        (("uncertainty",), "search", 280),
    ):
        (one,) = studies(*words, "--dry-run", "--json").document["plan"]
        assert (one["stage"], one["n_simulations"]) == (stage, n)
    assert studies("sensitivity", "--dry-run", "--json").document["plan"] == []
    # One after the other, each in a process of its own.
    assert search["simulations_s"] > 7 * document["simulation_s"]
    assert sorted(new_project.rglob("*")) == before


def test_a_plan_counts_what_is_there_and_takes_times_from_it(
    whole_run: Path, studies: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_of(whole_run, tmp_path / "project", monkeypatch)
    plan = ("tune", "--profile", "smoke", "--n-train", "16", "--dry-run", "--json")
    done = studies(*plan).document
    assert (done["n_simulations"], done["sizes"]) == (0, [{"n_train": 16, "n_left": 0, "training_s": 0.0}])
    (size,) = studies(*plan, "--trials", "5").document["sizes"]
    assert size["n_left"] == 3
    assert size["training_s"] > 0.0


def test_ctrl_c_says_how_to_go_on(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("simulation.case.load_case", interrupted)
    assert main(["run", "office", "--seed", "3", "--json"]) == 130
    captured = capsys.readouterr()
    assert captured.err.splitlines() == [
        "studies: interrupted; finished work is kept, go on with: studies run office --seed 3 --json"
    ]
    assert json.loads(captured.out)["go_on_with"] == "studies run office --seed 3 --json"


def test_a_reader_that_leaves_is_no_failure(project: Path) -> None:
    theirs, ours = os.pipe()
    os.close(theirs)
    done = subprocess.run(
        [sys.executable, "-m", "studies", "status", "--json"],
        stdout=ours,
        stderr=subprocess.PIPE,
        text=True,
        env=process_environment(project),
        check=False,
    )
    os.close(ours)
    assert done.returncode == 141
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize(
    ("how", "code", "err"),
    [
        (">/dev/full", 1, "studies: error: No space left on device; free some space"),
        (">&-", 0, ""),
        ("| tail -n 1", 0, ""),
    ],
)
def test_where_nothing_can_be_written_there_is_no_traceback(
    project: Path, how: str, code: int, err: str
) -> None:
    # The message names the folder.
    root = project.rename(project.with_name("Büro"))
    done = subprocess.run(
        f"{shlex.quote(sys.executable)} -m studies status {how}",
        shell=True,
        capture_output=True,
        text=True,
        env=process_environment(root) | {"PYTHONIOENCODING": "ascii"},
        check=False,
    )
    assert done.returncode == code
    assert ("B?ro yet" in done.stdout) == (how == "| tail -n 1")
    said = [line for line in done.stderr.splitlines() if line.startswith("studies: error")]
    assert "\n".join(said).startswith(err)
    assert bool(said) == bool(err)
    assert "Traceback" not in done.stderr


def test_a_number_is_never_broken_and_a_unit_in_brackets_is_no_markup(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    columns = [
        Column("parameter"), Column("calibrated", True), Column("upper bound", True),
        Column("moved by [standard deviations]", True),
    ]  # fmt: skip
    for width in (120, 60, 50):
        monkeypatch.setenv("COLUMNS", str(width))
        Console().table("", columns, [["wall.layer[1].capacity", "2.58924e+06", "1.23457e+07", "-0.12"]])
        said = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", capsys.readouterr().out)
        for number in ("2.58924e+06", "1.23457e+07", "-0.12"):
            assert f" {number} " in said.replace("\n", " \n")
        assert "[standard" in said
        assert max(map(len, said.splitlines())) <= width
