"""A stranger's Optuna database: whatever its cells hold, a command ends with one line at most."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from made_once import made_once
from project_for_tests import Run, make_project
from studies_for_tests import declared, declared_baseline, write_study

from simulation.foreign_text import has_control
from studies.paths import ProjectPaths
from studies.tuning.storage import open_storage

HUGE, HOSTILE, HALF = "1" + "0" * 400, r'"\u001b[31m\n"', r'"\ud800"'
CHOICE = '{"name": "CategoricalDistribution", "attributes": {"choices": [%s]}}'
JSON = [
    "no json",
    "[1]",
    "3.5",
    None,
    b"\xff",
    "[" * 100_000,
    HUGE,
    "1e999",
    "NaN",
    HOSTILE,
    HALF,
    '{"a": 1}',
]
CELLS: dict[tuple[str, str], list[object]] = {
    ("studies", "study_name"): ["../../x\x1b[31m\n"],
    ("study_user_attributes", "value_json"): JSON,
    ("study_directions", "direction"): ["x", "MAXIMIZE"],
    ("trials", "state"): ["NOSTATE", 17],
    ("trials", "number"): ["x", -1, 1e300, 7],
    ("trials", "datetime_start"): ["no time", None, 5, "0001-01-01 00:00:00.000000"],
    ("trials", "study_id"): [99],
    ("trial_values", "value"): ["x", b"\xff", 1e308, -1e308, None],
    ("trial_values", "value_type"): ["INF_POS", "NOTYPE"],
    ("trial_values", "objective"): [5],
    ("trial_params", "param_value"): ["x", 1e308, None],
    ("trial_params", "distribution_json"): ["{}", "no", CHOICE % HOSTILE],
    ("trial_params", "param_name"): ["\x1b[31m"],
    ("trial_user_attributes", "value_json"): [*JSON, '{"wall_s": "x"}', '{"wall_s": -1e308}'],
    ("trial_intermediate_values", "intermediate_value"): ["x", 1e308],
    ("trial_intermediate_values", "intermediate_value_type"): ["NOTYPE"],
    ("version_info", "schema_version"): [99, "x"],
    ("alembic_version", "version_num"): ["zzz"],
}
"""What stands in the place of all values of a column, one after the other."""
STATEMENTS = [
    "update study_user_attributes set value_json = replace(value_json, '\"office-quick\"', '\"../../x\"')",
    f"update study_user_attributes set value_json = replace(value_json, '\"office-quick\"', '{HALF}')",
    f"update study_user_attributes set value_json = replace(value_json, '\"office-quick\"', '{HOSTILE}')",
    f"update study_user_attributes set value_json = replace(value_json, '\"degC\"', '{HOSTILE}')",
    f"update study_user_attributes set value_json = '{HUGE}' where key = 'n_trials'",
    "update study_user_attributes set value_json = '-5' where key = 'n_trials'",
    *(
        f"update trial_params set param_value = 0, distribution_json = '{CHOICE % text}'"
        for text in (HOSTILE, HALF)
    ),
    *(
        f"insert into trial_system_attributes (trial_id, key, value_json) select trial_id, {pair} from trials"
        for pair in ("'fixed_params', '[5]'", "'failed_trial', '\"x\"'")
    ),
    "delete from trial_values",
    "delete from study_directions",
    "drop table trials",
    "alter table trials rename column state to status",
    "create trigger t after insert on trials begin delete from trials; end",
]
COMMANDS = (("status",), ("best",), ("best", "--json"))


def make_tuned(root: Path) -> None:
    make_project(root, with_store=False)
    write_study(root, declared("office-quick", 64), n_trials=8)
    write_study(root, declared_baseline("office-quick", 64), n_trials=1)
    storage = open_storage(ProjectPaths(root))
    storage.remove_session()
    storage.engine.dispose()


Doctor = Callable[..., None]


@pytest.fixture
def doctor(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Doctor:
    """Change the database of a project with two studies, a new one each time, in which commands then work."""

    def doctor(statement: str, *values: object) -> None:
        root = tmp_path / f"project-{len([*tmp_path.iterdir()])}"
        shutil.copytree(made_once(tmp_path_factory, "tuned-by-hand", make_tuned), root)
        monkeypatch.chdir(root)
        with closing(sqlite3.connect(root / "mlruns" / "optuna.db")) as database, database:
            assert database.execute(statement, values).rowcount, "nothing is changed"

    return doctor


def assert_one_line(studies: Run, *, is_refused: bool = False) -> None:
    for command in COMMANDS:
        answer = studies(*command)
        lines = answer.err.splitlines()
        assert answer.code in ((2,) if is_refused else (0, 2)), answer.err
        assert len(lines) == bool(answer.code), answer.err
        assert not [line for line in (*lines, *answer.out.splitlines()) if has_control(line)]
        if answer.code == 0 and "--json" in command:
            assert "best" in json.dumps(answer.document)


@pytest.mark.parametrize("cell", CELLS, ids=".".join)
def test_cells_of_wrong_kinds_and_sizes_are_one_line(
    cell: tuple[str, str], doctor: Doctor, studies: Run
) -> None:
    table, column = cell
    for value in CELLS[cell]:
        doctor(f"update or ignore {table} set {column} = ?", value)
        assert_one_line(studies)


@pytest.mark.parametrize("statement", STATEMENTS)
def test_a_doctored_database_is_one_line(statement: str, doctor: Doctor, studies: Run) -> None:
    doctor(statement)
    assert_one_line(studies)


def test_what_is_damaged_is_named(doctor: Doctor, studies: Run) -> None:
    doctor("update trial_values set value = 'x'")
    assert_one_line(studies, is_refused=True)
    said = studies("status").err
    assert "mlruns/optuna.db: a study or trial in it is damaged (could not convert" in said
    assert "restore it from a copy, or move it away" in said
