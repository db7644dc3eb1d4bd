"""Further seeds for the best and the default configuration: what is trained, chosen, said, and kept apart."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

import pytest
from optuna.trial import FrozenTrial
from toy_study_for_tests import LABEL, N_TUNED, essence, plain_study, runs_of, tuned_study

from studies.paths import ProjectPaths
from studies.profile import Confirmation
from studies.results.declaration import Declaration
from studies.results.trials import TunedStudy
from studies.tracking.runs import RunStore, load_surrogate
from studies.tuning.tune_studies import closed_studies, tune

TWO = Confirmation(seeds=2, top=2)
Tuned = tuple[ProjectPaths, TunedStudy]


@pytest.fixture(scope="module")
def confirmed(tuned: ProjectPaths, tmp_path_factory: pytest.TempPathFactory) -> Tuned:
    """The tuned project whose two best configurations, one the default, were trained with further seeds."""
    root = tmp_path_factory.mktemp("confirmed") / "project"
    shutil.copytree(tuned.root, root)
    paths = ProjectPaths(root)
    (found,) = tune([tuned_study(16)], paths=paths, n_trials=N_TUNED, n_jobs=2, n_parallel=2, confirm=TWO)
    return paths, found


def test_the_best_configurations_get_further_seeds(confirmed: Tuned) -> None:
    paths, found = confirmed
    spec = tuned_study(16)
    first, second = found.of(spec.name).usable[:2]
    assert first == found.default
    further = plain_study(paths, spec.confirmation.name).get_trials()
    assert [one.params for one in further] == [first.params] * 2 + [second.params] * 2
    seeds = {one.user_attrs["seed"] for one in (*further, *plain_study(paths, spec.name).get_trials())}
    assert len(seeds) == N_TUNED + 4
    means = {one.settings: fmean(found.confirmed[one.settings]) for one in (first, second)}
    best = found.best_trial  # a mean of several has no settings
    assert best is not None
    assert means[best.settings] == min(means.values())
    # Its weights are those of the seed that erred least on the validation set.
    assert best.value == min(one.value for one in found.usable if one.settings == best.settings and one.value)
    load_surrogate(RunStore(paths), best.run_id)
    gain = 1.0 - means[best.settings] / means[first.settings]
    size = found.summary()
    assert (size.gain, size.n_seeds) == (pytest.approx(gain), 2)
    (run,) = runs_of(paths, LABEL, role="study", study=spec.name)
    assert run.data.metrics["confirmed/gain"] == pytest.approx(gain)
    assert run.data.metrics["confirmed/gain_deviation"] == pytest.approx(size.gain_deviation)
    assert len(runs_of(paths, LABEL, role="confirmation", study=spec.confirmation.name)) == 4


def test_what_is_confirmed_is_finished_and_no_trial_of_the_budget(confirmed: Tuned) -> None:
    paths, found = confirmed
    specs = [tuned_study(16)]
    assert found.n_ended == N_TUNED
    assert found.summary().n_all == N_TUNED
    assert closed_studies(specs, paths, N_TUNED, TWO) is not None
    assert closed_studies(specs, paths, N_TUNED, Confirmation(seeds=3, top=2)) is None


@pytest.mark.slow
def test_the_sampler_and_the_pruner_do_not_see_them(
    confirmed: Tuned, copied: ProjectPaths, tmp_path: Path
) -> None:
    shutil.copytree(confirmed[0].root, tmp_path / "more")
    more, spec = ProjectPaths(tmp_path / "more"), tuned_study(16)
    for paths in (copied, more):
        tune([spec], paths=paths, n_trials=N_TUNED + 2, n_jobs=1)
    assert essence(plain_study(more, spec.name)) == essence(plain_study(copied, spec.name))


@pytest.mark.slow
def test_an_interruption_changes_no_confirmation(
    confirmed: Tuned, copied: ProjectPaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = tuned_study(16)
    # A training of the toy may take less than the usual pause.
    monkeypatch.setattr("studies.tuning.side_by_side.POLL_S", 0.02)

    def interrupt(of: Declaration, trials: Sequence[FrozenTrial]) -> None:
        if of.is_confirmation and any(one.state.name != "WAITING" for one in trials):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, confirm=TWO, on_trials=interrupt)
    assert closed_studies([spec], copied, N_TUNED, TWO) is None
    (found,) = tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, confirm=TWO)
    name = spec.confirmation.name
    assert essence(plain_study(copied, name)) == essence(plain_study(confirmed[0], name))
    assert found.confirmed == confirmed[1].confirmed
