"""What `studies status` and `studies best` say of a tuned project."""

from toy_study_for_tests import LABEL, N_TUNED, plain_study, toy_study, tuned_study

from studies.best import best_blocks, best_document
from studies.console import Block, Said, Table
from studies.finished import read_project
from studies.paths import ProjectPaths
from studies.status import status_blocks, status_document
from studies.tuning.results import latest_studies, read_studies
from studies.tuning.tune import tune


def columns(blocks: list[Block]) -> dict[str, list[str]]:
    """Return the cells of the first table by heading."""
    table = next(block for block in blocks if isinstance(block, Table))
    return {column.title: [str(row[at]) for row in table.rows] for at, column in enumerate(table.columns)}


def told(blocks: list[Block]) -> str:
    return "\n".join(block.text for block in blocks if isinstance(block, Said))


def test_best_shows_hyperparameters_and_errors_beside_pca_gp(tuned: ProjectPaths) -> None:
    blocks = best_blocks(read_project(tuned), None)
    cells = columns(blocks)
    assert cells["n_train"] == ["16", "24"]
    best = plain_study(tuned, tuned_study(16).name).best_trial
    assert cells["n_latent"][0] == str(best.params["n_latent"])
    assert cells["n_hidden"][0] == str(best.params["n_hidden"])
    assert float(cells["beta"][0]) == float(f"{best.params['beta']:.3g}")
    for name in ("MAE", "P90", "MAE val", "PCA+GP MAE", "PCA+GP P90"):
        assert all(float(cell) > 0.0 for cell in cells[name])
    assert cells["trials"] == [str(N_TUNED)] * 2
    assert "one seed each" in told(blocks)
    assert "mlflow.pyfunc.load_model" in told(blocks)


def test_best_as_a_document(tuned: ProjectPaths) -> None:
    document = best_document(read_project(tuned), None)
    assert document["optuna_storage"] == tuned.optuna_url
    assert document["mlflow_tracking_uri"] == tuned.tracking_uri
    assert [size["n_train"] for size in document["sizes"]] == [16, 24]
    for size in document["sizes"]:
        trial = plain_study(tuned, size["study"]).best_trial
        assert size["params"] == trial.params
        assert size["run_id"] == trial.user_attrs["mlflow_run_id"]
        assert (size["mae"], size["p90"]) == (trial.user_attrs["test/mae"], trial.user_attrs["test/p90"])
        assert size["model_uri"] == f"models:/{LABEL}-n{size['n_train']:04d}@champion"
        assert set(size["baseline"]) >= {"test/mae", "test/p90"}
        assert 2 * size["n_proposed"] >= N_TUNED
        assert size["gain"] >= 0.0
    (one,) = best_document(read_project(tuned), [24])["sizes"]
    assert one["n_train"] == 24


def test_status_shows_every_study(tuned: ProjectPaths) -> None:
    blocks = status_blocks(read_project(tuned))
    cells = columns(blocks)
    assert cells["study"] == [f"{LABEL}/n0016", f"{LABEL}/n0024"]
    assert cells["trials"] == [f"{N_TUNED}/{N_TUNED}"] * 2
    assert cells["to go"] == ["done"] * 2
    assert {"n_latent", "n_hidden", "beta", "MAE", "P90", "PCA+GP"} <= set(cells)
    assert f"2 studies: {2 * N_TUNED} of {2 * N_TUNED} trials done" in told(blocks)


def test_status_as_a_document(tuned: ProjectPaths) -> None:
    document = status_document(read_project(tuned))
    tuned_ones = [study for study in document["studies"] if not study["is_baseline"]]
    assert len(document["studies"]) == 4
    for study in tuned_ones:
        assert study["n_complete"] + study["n_pruned"] == study["n_planned"] == N_TUNED
        assert study["n_running"] == study["n_waiting"] == 0
        assert study["to_go_s"] == 0.0
        assert {"n_latent", "n_hidden", "beta"} == set(study["params"])


def test_a_study_on_its_way_shows_its_running_trial_and_the_time_to_go(copied: ProjectPaths) -> None:
    spec = tuned_study(16)
    tune([spec], paths=copied, n_trials=N_TUNED + 8, n_jobs=1, until_s=0.0)
    trial = plain_study(copied, spec.name).ask()
    trial.report(1.25, 6)
    project = read_project(copied)
    blocks, document = status_blocks(project), status_document(project)
    cells = columns(blocks)
    assert cells["trials"][0] == f"{N_TUNED}/{N_TUNED + 8}"
    assert cells["running"][0] == "1"
    assert cells["to go"][0] != "done"
    (shown,) = [one for one in document["studies"] if one["study"] == spec.name]
    assert shown["n_running"] == 1
    assert shown["to_go_s"] > 0.0
    running = [block for block in blocks if isinstance(block, Table)][1]
    assert running.rows[0][0] == f"{spec.name} trial {N_TUNED}"
    assert running.rows[0][1:2] == ["6/12"]
    assert running.rows[0][2] == "1.25"


def test_an_empty_project_says_what_to_type(project: ProjectPaths) -> None:
    empty = read_project(project)
    assert "type: studies run" in told(status_blocks(empty))
    assert "No completed trial" in told(best_blocks(empty, None))
    assert best_document(empty, None)["sizes"] == []


def test_studies_of_other_data_are_told_apart(tuned: ProjectPaths) -> None:
    studies = read_studies(tuned, label=LABEL)
    assert set(latest_studies(studies)) == {(16, False), (16, True), (24, False), (24, True)}
    assert latest_studies(studies, "0" * 64) == {}
    assert read_studies(tuned, label="other") == []
    assert toy_study(16).name.startswith(f"{LABEL}/n0016/")
