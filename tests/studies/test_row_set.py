"""A set of stored rows: what it is, and that it moves with its store."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_rc import ToyRC

from simulation.design import uniform_design
from simulation.errors import InputError
from simulation.store.store import SimulationStore
from studies.results.row_set import RowSet

TOY = ToyRC()
ROWS = TOY.simulate(uniform_design(TOY.parameter_space, 400, seed=0))


def test_a_set_is_its_rows_and_moves_with_the_store(tmp_path: Path) -> None:
    file, names = tmp_path / "rows.db", (ROWS.parameter_names, ROWS.output_names)
    with SimulationStore(
        file, model_digest="toy", parameter_names=names[0], output_names=names[1], time=ROWS.time
    ) as store:
        store.append(ROWS.take(np.arange(50)))
    (tmp_path / "sets").mkdir()
    RowSet(ROWS.theta[:50], file, tmp_path / "sets" / "train.npz").save()
    moved = tmp_path.rename(tmp_path.with_name("moved"))
    found = RowSet.load(moved / "sets" / "train.npz")
    assert (found.n, found.read().digest) == (50, ROWS.take(np.arange(50)).digest)
    assert found.read(20).digest == ROWS.take(np.arange(20)).digest
    replace(found, theta=ROWS.theta[:51]).save()
    with pytest.raises(InputError, match=r"train\.npz: 1 of 51 rows are not in .*; type: studies simulate"):
        RowSet.load(found.file).read()
