"""`studies reproduce` of a pruned trial: it is trained as far as it was, with the same curves."""

from pathlib import Path

from project_for_tests import TINY_PROFILE, Run

from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import connect

# Errors are some kelvins: the first report prunes.
PRUNER = 'n_trials = 1\npruner = { name = "ThresholdPruner", upper = 1e-6 }'


def test_a_pruned_trial_is_made_again_as_far_as_it_came(project: Path, studies: Run) -> None:
    profile = TINY_PROFILE.replace("n_trials = 3", PRUNER).replace("max_epochs = 10", "max_epochs = 60")
    (project / "tiny.toml").write_text(profile, encoding="utf-8")
    studies("tune", "office", "--profile", "tiny.toml", "--quiet")
    client = connect(ProjectPaths(project).tracking_uri)
    experiment = client.get_experiment_by_name("office-tiny")
    assert experiment is not None
    (pruned,) = client.search_runs([experiment.experiment_id], "tags.pruned = 'True'")
    curve = client.get_metric_history(pruned.info.run_id, "curve/validation_mae")
    assert 0 < curve[-1].step < 60
    answer = studies("reproduce", pruned.info.run_id, "--json")
    assert answer.code == 0, answer.out + answer.err
    rows = {row["name"]: row for row in answer.document["numbers"]}
    assert rows["curve/validation_mae"]["is_equal"]
    assert "test/mae" not in rows
