"""Optimizers straight on the model: what is counted, how starts are drawn, and what an interruption costs."""

import json
import os
import signal
import time
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest
from paper_study_for_tests import study_in
from toy_rc import ToyRC

from simulation.counting import CountingModel
from simulation.errors import InputError
from simulation.measurement import Measurement, Samples
from simulation.parameters import Parameter, ParameterSpace
from studies.paper.direct import direct_folder, joined_history, row_over_seeds, run_direct_row, run_starts
from studies.paper.direct_journal import Journal
from studies.paper.direct_optimizers import StartResult, StartStoppedError, minimize_from, thinned
from studies.paper.direct_row import DirectRow, paper_rows, published_row, start_points

TRUTH = np.array([[1.7, 2.3e4]])
ROWS = [
    DirectRow("ls-trf", objective="residuals", tolerance=1e-6),
    DirectRow("ls-trf", objective="squared", coordinates="log"),
    DirectRow("slsqp", coordinates="log"),
    DirectRow("nelder-mead", coordinates="log", max_calls=80),
    DirectRow("powell", coordinates="log", max_calls=300),
    DirectRow("differential-evolution", max_calls=1500),
]


def toy_measurement(noise=0.05):
    model = ToyRC()
    y = model.simulate(TRUTH).y[0]
    y = y + noise * np.random.default_rng(0).standard_normal(y.shape)
    return Measurement.on_grid(model.time, y, model.output_names, np.array([0.5]))


def test_table_3_is_complete_and_evolution_has_whole_generations():
    rows = paper_rows(seed=3)
    assert len({one.row.name for one in rows}) == len(rows) == 15
    assert {one.row.seed for one in rows} == {3}
    calls = {one.row.title: one.published.n_calls for one in rows}
    assert calls["Nelder-Mead with 256 starts"] == 1_188_496
    assert calls["Differential evolution"] % (15 * 14) == 0
    assert published_row(replace(rows[2].row, seed=9)).mse == 0.0114
    assert published_row(DirectRow("powell", 5)) is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"method": "bfgs"}, "method = 'bfgs' is unknown"),
        ({"method": "powell", "objective": "residuals"}, "cannot minimize 'residuals'"),
        ({"method": "ls-trf"}, "cannot minimize 'scalar'"),
        ({"method": "powell", "start": 0}, "start is 0"),
        ({"method": "differential-evolution", "start": 4}, "no starting points"),
        ({"method": "powell", "max_calls": 0}, "max_calls is 0"),
        ({"method": "powell", "tolerance": 0.0}, "tolerance is 0"),
    ],
)
def test_a_row_that_makes_no_sense_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        DirectRow(**wrong)


def test_starts_begin_with_the_guess_stay_in_the_box_and_extend_each_other():
    space = ToyRC().parameter_space
    row = DirectRow("powell", 40, seed=2)
    starts = start_points(space, row)
    assert starts[0].tolist() == [1.0, 1e4]
    assert space.contains(starts).all()
    assert np.array_equal(start_points(space, replace(row, start=7)), starts[:7])
    assert not np.array_equal(start_points(space, replace(row, seed=1))[1:], starts[1:])


def test_starts_are_distributed_as_draws_repeated_until_one_lies_inside():
    space = ParameterSpace((Parameter("a", lower=0.2, upper=5.0, estimate=1.0),))
    ours = start_points(space, DirectRow("powell", 4000))[1:, 0]
    draws = np.random.default_rng(0).normal(1.0, 0.5 * 4.8, 40_000)
    theirs = draws[(draws >= 0.2) & (draws <= 5.0)]
    # Two samples of thousands agree in their quantiles to some 2 % of the range.
    assert np.quantile(ours, [0.1, 0.5, 0.9]) == pytest.approx(np.quantile(theirs, [0.1, 0.5, 0.9]), abs=0.12)


@pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
def test_calls_are_those_the_model_was_asked_and_the_error_is_that_of_the_point(row):
    measurement, counter = toy_measurement(), CountingModel(ToyRC())
    theta0 = start_points(counter.parameter_space, row)[0]
    found = minimize_from(counter, measurement, row, theta0)
    assert found.n_calls == counter.n_calls
    assert row.max_calls is None or found.n_calls <= row.max_calls
    assert found.mse == pytest.approx(measurement.mse(ToyRC().simulate(found.theta[None]).y)[0], rel=1e-12)
    assert found.mse <= measurement.mse(ToyRC().simulate(theta0[None]).y)[0]
    # 1 % above the noise, whatever the method.
    truth = measurement.mse(ToyRC().simulate(TRUTH).y)[0]
    assert found.mse <= 1.01 * truth
    assert np.all(np.diff(found.history[:, 1]) <= 0)
    assert found.history[-1].tolist() == [found.n_calls, found.mse]


@pytest.mark.parametrize("method", ["nelder-mead", "slsqp", "ls-trf"])
def test_rows_that_fail_are_bad_and_end_nothing(method):
    row = DirectRow(method, objective="residuals" if method == "ls-trf" else "scalar", coordinates="log")
    found = minimize_from(ToyRC(fails_above_r=1.8), toy_measurement(), row, np.array([1.0, 1e4]))
    assert found.mse < 0.1
    assert found.theta[0] <= 1.8


def test_an_interrupted_evolution_goes_on_as_if_nothing_had_been(tmp_path):
    row, measurement, theta0 = DirectRow("differential-evolution", max_calls=300), toy_measurement(), TRUTH[0]
    undisturbed = minimize_from(ToyRC(), measurement, row, theta0)
    file = tmp_path / "row.journal"
    heard = []

    def stop_at_100(best_mse):
        heard.append(best_mse)
        if len(heard) == 100:
            raise StartStoppedError

    with pytest.raises(StartStoppedError), Journal(file) as journal:
        minimize_from(ToyRC(), measurement, row, theta0, journal=journal, on_call=stop_at_100)
    file.write_bytes(file.read_bytes()[:-5])  # a crash in the middle of an entry
    counter = CountingModel(ToyRC())
    with Journal(file) as journal:
        resumed = minimize_from(counter, measurement, row, theta0, journal=journal)
    assert counter.n_calls == undisturbed.n_calls - 99
    assert (resumed.mse, resumed.n_calls) == (undisturbed.mse, undisturbed.n_calls)
    assert np.array_equal(resumed.history, undisturbed.history)
    with Journal(file) as journal:  # nothing is left to do
        minimize_from(counter, measurement, row, theta0, journal=journal)
    assert counter.n_calls == undisturbed.n_calls - 99


def test_a_journal_of_other_points_is_not_believed(tmp_path):
    row, measurement = DirectRow("differential-evolution", max_calls=150), toy_measurement()
    file = tmp_path / "row.journal"
    with Journal(file) as journal:
        minimize_from(ToyRC(), measurement, replace(row, seed=1), TRUTH[0], journal=journal)
    with Journal(file) as journal:
        found = minimize_from(ToyRC(), measurement, row, TRUTH[0], journal=journal)
    assert found.mse == minimize_from(ToyRC(), measurement, row, TRUTH[0]).mse


def test_answers_of_another_problem_are_not_believed(tmp_path):
    row = DirectRow("differential-evolution", max_calls=15 * 14 * 20)
    study = study_in(tmp_path, n_jobs=1)
    measured = study.case.measurement
    warmer = tuple(Samples(one.time, one.values + 1.0) for one in measured.samples)
    edited = replace(measured, samples=warmer)
    other = replace(study, case=replace(study.case, measurement=edited))

    def interrupt_at_the_first_answers():
        while not any(file.stat().st_size for file in direct_folder(study).glob("*.journal")):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    Thread(target=interrupt_at_the_first_answers, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        run_starts(study, row)
    (journal,) = direct_folder(study).glob("*.journal")
    assert journal.stat().st_size > 0
    (found,) = run_starts(other, row)
    with other.case.make_model() as model:
        assert found.mse == pytest.approx(edited.mse(model.simulate(found.theta[None]).y)[0], rel=1e-12)
    assert not list(direct_folder(study).glob("*.journal"))


def test_histories_are_joined_as_if_starts_had_been_made_in_turn():
    def start(mse, history):
        return StartResult(np.zeros(1), np.zeros(1), mse, int(history[-1][0]), 0.0, "", np.array(history))

    joined = joined_history([start(2.0, [[1, 5.0], [4, 2.0]]), start(1.0, [[1, 3.0], [6, 1.0]])])
    assert joined.tolist() == [[1, 5.0], [4, 2.0], [10, 1.0], [10, 1.0]]


def test_a_thinned_history_keeps_both_ends_and_the_order():
    history = np.column_stack([np.arange(1, 5001), np.linspace(9, 1, 5000)])
    kept = thinned(history)
    assert len(kept) < 100
    assert kept[[0, -1]].tolist() == history[[0, -1]].tolist()
    assert np.all(np.diff(kept[:, 0]) > 0)


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    study = study_in(tmp_path_factory.mktemp("project"))
    row = DirectRow("ls-trf", 4, "residuals", tolerance=1e-4)
    told = []
    return study, row, run_direct_row(study, row, lambda *n: told.append(n)), told


def comparable(numbers):
    return {key: part for key, part in numbers.items() if key not in ("wall_s", "finished")}


def test_a_row_reports_its_best_start_and_all_calls(computed):
    study, row, numbers, told = computed
    with np.load(direct_folder(study) / f"{row.name}.npz") as arrays:
        assert numbers["mse"] == arrays["mse"].min() <= numbers["mse_of_the_guess"] == arrays["mse"][0]
        assert numbers["n_calls"] == arrays["n_calls"].sum() == arrays["history_calls"][-1]
        assert arrays["theta0"].shape == arrays["theta"].shape == (4, 14)
    assert (
        numbers["command"] == f"studies reproduce-paper office --profile smoke --only table3 --row {row.name}"
    )
    assert told[-1] == (4, 4)
    assert json.loads((direct_folder(study) / f"{row.name}.json").read_text()) == numbers


def test_a_finished_row_is_read_and_more_starts_extend_fewer(computed):
    study, row, numbers, _ = computed
    assert run_direct_row(study, row) == numbers
    told = []
    guess = run_direct_row(study, replace(row, start="guess"), lambda *n: told.append(n))
    assert told == []  # no process was started: the start is there
    assert guess["mse"] == numbers["mse_of_the_guess"]
    more = run_direct_row(study, replace(row, start=5))
    assert more["mse"] <= numbers["mse"] <= guess["mse"]


def test_a_resumed_row_is_the_undisturbed_one(computed, tmp_path):
    study, row, numbers, _ = computed
    other = study_in(tmp_path, n_jobs=1)
    lines = (direct_folder(study) / f"{row.series}.starts.jsonl").read_bytes().split(b"\n")
    folder = direct_folder(other)
    folder.mkdir(parents=True)
    kept = folder / f"{row.series}.starts.jsonl"
    # The head, one start, and half of another: what a killed process leaves.
    kept.write_bytes(b"\n".join([*lines[:2], lines[2][:100]]))
    assert comparable(run_direct_row(other, row)) == comparable(numbers)


def test_seeds_give_quartiles(computed):
    study, row, _, _ = computed
    rows = [replace(row, start="guess", seed=seed) for seed in (0, 0)]
    spread = row_over_seeds(study, rows)
    assert spread["mse_quartiles"] == pytest.approx([spread["mse"][0]] * 3)
