"""Constraints, where a case is calibrated without a surrogate."""

from pathlib import Path

import pandas
import pytest
from project_for_tests import Run, add_case, stored_simulations

COMMANDS = (
    ("calibrate", "wall", "--no-state-equations", "--max-calls", "14"),
    ("uncertainty", "wall", "--max-calls", "30"),
    ("calibrate", "wall", "--again"),
)


@pytest.mark.slow
def test_no_row_of_a_search_or_a_sample_breaks_a_constraint(project: Path, studies: Run) -> None:
    file = add_case(project)
    text = file.read_text(encoding="utf-8")
    text = text.replace("schema = 1\n", 'schema = 1\nconstraints = ["C1 < C2", "G23 < G12"]\n')
    text = text.replace("window_d = [1, 5]", "window_d = [1, 2]", 1).replace("validation_d = [5, 7]\n", "")
    file.write_text(text, encoding="utf-8")

    n_before = 0
    for command in COMMANDS:
        answer = studies(*command)
        assert answer.code == 0, answer.err
        rows = pandas.concat(stored_simulations(project, "wall").values())
        assert (rows["C1"] <= rows["C2"]).all(), command
        assert (rows["G23"] <= rows["G12"]).all(), command
        assert len(rows) > n_before, command
        n_before = len(rows)
