"""`studies calibrate --from-stored`: what was simulated before is not simulated for nothing."""

import shutil
from pathlib import Path

import pandas
import pytest
from project_for_tests import Run, copy_of, stored_result

# With state equations there is nothing left to save.
WALL = ("calibrate", "wall", "--jobs", "1", "--no-state-equations")
N_BEFORE = 18


@pytest.fixture
def project(wall_by_search: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(wall_by_search, tmp_path / "project", monkeypatch)


def change_the_data(project: Path) -> None:
    """Say that the masonry's sensor showed a third of a kelvin too much."""
    file = project / "data" / "wall" / "measured.csv"
    table = pandas.read_csv(file)
    table["TMasonry_degC"] -= 0.3
    table.to_csv(file, index=False)


@pytest.mark.slow
def test_after_a_change_of_the_data_it_takes_a_few_calls(project: Path, studies: Run) -> None:
    change_the_data(project)
    answer = studies(*WALL, "--from-stored", "--max-calls", "6")
    assert answer.code == 0, answer.err
    assert f"begins with {N_BEFORE} stored simulations of this model" in answer.err
    assert f"after 6 model calls, begun with {N_BEFORE} stored simulations" in answer.out
    found = stored_result(project)
    assert found["n_warm_start"] == N_BEFORE
    assert found["ledger"]["total_paper"] == 6
    from_nothing = studies(*WALL, "--seed", "1", "--max-calls", str(N_BEFORE), "--json").stage
    assert found["mse"] < from_nothing["mse"]


@pytest.mark.slow
def test_it_goes_on_with_the_rows_that_it_began_with_and_again_with_all(project: Path, studies: Run) -> None:
    command = (*WALL, "--from-stored", "--max-calls", "4", "--json")
    first = studies(*command).stage
    before = stored_result(project)
    assert (first["n_warm_start"], first["n_simulated"]) == (N_BEFORE, 4)
    assert studies(*command).stage["finished_before"]
    # As after a kill in the last moment: rows and what it began with are there, its result is not.
    for typed in (command, (*command, "--again")):
        (project / "mlruns" / "results" / "wall-quick" / "calibrate-adaptive.json").unlink()
        resumed = studies(*typed).stage
        assert (resumed["n_warm_start"], resumed["n_simulated"]) == (N_BEFORE, 0)
        assert stored_result(project) == before
    # Another budget goes on: its first calls are those that were paid already.
    more = studies(*WALL, "--from-stored", "--max-calls", "6", "--json").stage
    assert (more["n_warm_start"], more["n_simulated"]) == (N_BEFORE, 2)
    again = studies(*command, "--again").stage
    assert N_BEFORE < again["n_warm_start"] <= N_BEFORE + 6
    assert again["n_simulated"] == 4
    assert again["mse"] <= first["mse"]


@pytest.mark.slow
def test_everything_that_looks_at_it_says_what_it_began_with(project: Path, studies: Run) -> None:
    assert studies(*WALL, "--from-stored", "--max-calls", "3").code == 0
    words = f"begun with {N_BEFORE} stored simulations"
    assert f"3 model calls, {words}" in studies("best").out
    assert studies("best", "--json").document["calibrations"][0]["n_warm_start"] == N_BEFORE
    assert f"3 + {N_BEFORE} stored" in studies("status").out
    page = studies("report", "wall", "--json")
    assert page.code == 0, page.err
    text = Path(project / page.document["stages"][0]["index"]).read_text(encoding="utf-8")
    assert f"begun with {N_BEFORE} stored simulations" in text
    assert "--max-calls 3 --from-stored" in text
    again = studies("reproduce", "wall-quick/adaptive")
    assert again.code == 0, again.err
    assert "to the last digit" in again.out
    # A page of a calibration that needed no call.
    assert studies(*WALL, "--from-stored", "--target", "0.5", "--json").stage["ledger"]["total_paper"] == 0
    page = studies("report", "wall", "--json")
    text = Path(project / page.document["stages"][0]["index"]).read_text(encoding="utf-8")
    assert f"after 0 model calls, begun with {N_BEFORE} stored simulations" in text


def test_simulations_of_a_check_are_begun_with_unless_a_search_had_begun_without(
    project: Path, studies: Run
) -> None:
    manifest = project / "mlruns" / "results" / "wall-quick" / "calibrate-adaptive.json"
    command = (*WALL, "--max-calls", str(N_BEFORE))
    before = stored_result(project)
    assert studies("check", "wall", "--jobs", "1").code == 0
    assert "finished before" in studies(*command).err
    manifest.unlink()  # as after a kill
    assert studies(*command, "--json").stage["n_simulated"] == 0
    assert stored_result(project) == before
    again = studies(*command, "--again", "--max-calls", "2", "--json").stage
    assert (again["n_warm_start"], again["n_simulated"]) == (149, 2)
    assert again["mse"] < before["mse"]
    alone = studies(*command, "--no-from-stored", "--json").stage
    assert (alone["n_simulated"], alone["mse"]) == (0, before["mse"])


def test_where_nothing_is_stored_it_begins_with_nothing(project: Path, studies: Run) -> None:
    shutil.rmtree(project / "data" / "wall" / "generated")
    answer = studies(*WALL, "--from-stored", "--max-calls", "8")
    assert answer.code == 0, answer.err
    assert "no good simulation within the bounds was stored" in answer.err
    assert "n_warm_start" not in stored_result(project)


def test_files_that_have_changed_since_are_named(project: Path, studies: Run) -> None:
    looks = ("status", "best")
    assert all("change" not in studies(look).out for look in looks)
    change_the_data(project)
    case = project / "fmus" / "wall" / "case.toml"
    case.write_text(case.read_text(encoding="utf-8") + "# another thought\n", encoding="utf-8")
    status, best = (studies(look).out for look in looks)
    assert "changed since" in status
    assert "case.toml, measured.csv" in status
    assert "made before case.toml and measured.csv changed" in best
    both = ["case.toml", "measured.csv"]
    assert studies("best", "--json").document["calibrations"][0]["changed_since"] == both
    assert studies("status", "--json").document["calibrations"][0]["changed_since"] == both
    case.write_bytes(b"\xe4")
    assert "made before case.toml and measured.csv changed" in studies("best").out
    # Where the file is not, as after an import, nothing is known of it.
    case.unlink()
    assert "made before measured.csv changed" in studies("best").out
