"""Promises that every forward model keeps, whatever it wraps."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation import CountingModel, ForwardModel, PoolModel, load_case
from simulation.store.store import SimulationStore
from simulation.store.stored_model import StoredModel

MODELS = [
    "toy-rc",
    "counting",
    "stored",
    "parallel",
    "fmu",
    "fmu-pool",
]


# Models live for the module: starting worker processes costs seconds.
@pytest.fixture(scope="module", params=MODELS)
def model(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForwardModel]:
    name = request.param
    if name.startswith("fmu"):
        case: Path = request.getfixturevalue("shared_decay_case")
        make_model = load_case(case).make_model
        with make_model() if name == "fmu" else PoolModel(make_model, 2) as model:
            yield model
    elif name == "stored":
        toy = ToyRC()
        with SimulationStore(
            tmp_path_factory.mktemp("contract") / "toy.db",
            model_digest="toy",
            parameter_names=toy.parameter_space.names,
            output_names=toy.output_names,
            time=toy.time,
        ) as store:
            yield StoredModel(toy, store)
    elif name == "parallel":
        with PoolModel(ToyRC, 2) as model:
            yield model
    else:
        yield ToyRC() if name == "toy-rc" else CountingModel(ToyRC())


def _rows(model: ForwardModel, n: int = 23) -> np.ndarray:
    rows = model.parameter_space.from_unit(
        np.random.default_rng(3).random((n, model.parameter_space.n_parameters))
    )
    if "mode" in model.parameter_space.names:
        # Every eighth row gives up half-way, the others are good.
        rows[:, model.parameter_space.names.index("mode")] = np.where(np.arange(n) % 8 == 5, 1.0, 0.0)
    return rows


def test_the_answer_has_the_rows_asked_for_in_their_order(model: ForwardModel):
    assert isinstance(model, ForwardModel)
    rows = _rows(model)
    before = rows.copy()
    answer = model.simulate(rows)
    rows[:] = 0.0  # the caller's rows stay the caller's
    assert np.array_equal(answer.theta, before)
    assert answer.y.shape == (len(rows), len(model.time), len(model.output_names))
    assert answer.y.dtype == model.time.dtype == np.float64
    assert answer.parameter_names == model.parameter_space.names
    assert answer.output_names == model.output_names
    assert np.array_equal(answer.time, model.time)
    assert answer.n == len(rows)
    assert [reason != "" for reason in answer.failures] == np.isnan(answer.y).all(axis=(1, 2)).tolist()
    assert np.isfinite(answer.y[~answer.failed]).all()
    empty = model.simulate(before[:0])
    assert empty.y.shape == (0, len(model.time), len(model.output_names))


def test_permuted_rows_give_permuted_answers(model: ForwardModel):
    rows = _rows(model)
    order = np.random.default_rng(4).permutation(len(rows))
    straight, permuted = model.simulate(rows), model.simulate(rows[order])
    assert permuted.digest == straight.take(order).digest


def test_the_same_row_gives_the_same_answer_alone_and_again(model: ForwardModel):
    rows = _rows(model)
    batch = model.simulate(rows)
    assert model.simulate(rows).digest == batch.digest
    for index in (0, 5, len(rows) - 1):
        assert model.simulate(rows[[index]]).digest == batch.take([index]).digest


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_a_bad_row_is_nan_with_a_reason_and_harms_no_other(model: ForwardModel, bad: float):
    rows = _rows(model)
    expected = model.simulate(rows)
    rows[2, 0] = bad
    answer = model.simulate(rows)
    assert answer.failed[2]
    assert answer.failures[2].startswith(f"parameter {model.parameter_space.names[0]} is ")
    assert np.isnan(answer.y[2]).all()
    others = np.arange(len(rows)) != 2
    assert answer.take(others).digest == expected.take(others).digest
