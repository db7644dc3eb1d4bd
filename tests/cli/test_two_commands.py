"""Two commands at once in one project; `tests/benchmarks/command_pairs.py` tries every two."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from held_for_tests import held, wrong_of
from made_once import made_once
from pairs_for_tests import Alone, make_base, wrong_of_pair

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "pairs", make_base)


def test_two_calibrations_at_once_leave_what_one_leaves(base: Path, tmp_path: Path) -> None:
    (tmp_path / "alone").mkdir()
    alone = {"calibrate": Alone.of(base, "calibrate", tmp_path / "alone")}
    (tmp_path / "both").mkdir()
    assert wrong_of_pair(base, ("calibrate", "calibrate"), alone, tmp_path / "both") == []
    # The same comparison sees what is spoilt.
    project = tmp_path / "both" / "project"
    before = held(project)
    with closing(sqlite3.connect(next(project.glob("data/wall/generated/simulations/*.db")))) as store, store:
        store.execute("delete from simulations where _id = (select max(_id) from simulations)")
    record = project / "mlruns" / "results" / "wall-tiny-d1-2" / "calibrate-adaptive.json"
    content = json.loads(record.read_bytes())
    content["result"]["mse"] *= 1.001
    record.write_text(json.dumps(content))
    seen = wrong_of(before, held(project))
    assert len(seen) == 2
    assert seen[0] == "1 rows lost"
    assert "calibrate-adaptive.json/result/mse" in seen[1]
