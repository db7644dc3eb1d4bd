"""Values that some experiments share, under names that the FMU does not know."""

from pathlib import Path

import numpy as np
import pytest
from decaying_case_for_tests import DecayingCase

from simulation import InputError, PoolModel, load_case
from simulation.experiments import JoinedModel

PARAMETER = '[[parameters]]\nname = "{}"\nlower = 2e-5\nupper = 5e-4\nunit = "1/s"\nscale = "log"\n'
EXPERIMENTS = """
[[experiments]]
name = "a"
shared = { k = "k of north" }

[[experiments]]
name = "b"
shared = { k = "k of north" }
fixed = { x0 = 300.0 }

[[experiments]]
name = "c"
shared = { k = "k of south" }
"""


def written(folder: Path, experiments: str, *names: str) -> Path:
    file = DecayingCase().write(folder)
    text = file.read_text()
    begin, end = text.index('[[parameters]]\nname = "k"'), text.index('[[parameters]]\nname = "x0"')
    tables = "".join(map(PARAMETER.format, names))
    file.write_text(text[:begin] + tables + text[end:] + experiments)
    return file


def simulated(file: Path, theta: list[float]) -> np.ndarray:
    case = load_case(file)
    with PoolModel(case.make_model, 1) as pool:
        model = pool if case.layout is None else JoinedModel(pool, case.experiment_rows, case.parameter_space)
        answer = model.simulate(np.array([theta]))
    assert not answer.failures[0], answer.failures
    return answer.y[0]


def test_experiments_that_give_a_value_one_name_share_it(tmp_path: Path) -> None:
    file = written(tmp_path / "shared", EXPERIMENTS, "k of north", "k of south")
    assert load_case(file).parameter_space.names == ("x0", "k of north", "k of south")
    y = simulated(file, [310.0, 1e-4, 2e-4])
    alone = DecayingCase().write(tmp_path / "alone")
    rows = [[1e-4, 310.0], [1e-4, 300.0], [2e-4, 310.0]]
    np.testing.assert_array_equal(y, np.column_stack([simulated(alone, row) for row in rows]))


def test_two_parameters_of_an_experiment_may_have_one_value(tmp_path: Path) -> None:
    # Which mode that is makes no difference: it is none of those that fail.
    both = EXPERIMENTS.replace(
        'shared = { k = "k of south" }', 'shared = { k = "k of south", mode = "k of south" }'
    )
    names, theta = ("k of north", "k of south"), [310.0, 1e-4, 2e-4]
    file, other = (written(tmp_path / one, text, *names) for one, text in (("a", both), ("b", EXPERIMENTS)))
    np.testing.assert_array_equal(simulated(file, theta), simulated(other, theta))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'shared = { k = "k of north" }',
            'shared = { k = "k of east" }',
            "'k of east' is none of .*parameters",
        ),
        ('shared = { k = "k of north" }', 'shared = { q = "k of north" }', "q"),
        (
            'shared = { k = "k of north" }',
            'shared = { k = "k of north", mode = "x0" }',
            "x0 is a variable of the FMU",
        ),
        (
            'shared = { k = "k of south" }',
            'shared = { k = "k of south" }\nheld_out = true',
            "k of south.* has a value of its own .*fixed = { k = ",
        ),
    ],
)
def test_what_is_shared_with_nothing_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = written(tmp_path, EXPERIMENTS.replace(old, new, 1), "k of north", "k of south")
    with pytest.raises(InputError, match=said) as refused:
        load_case(file)
    assert "\n" not in str(refused.value)
