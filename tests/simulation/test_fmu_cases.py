"""Case files around an FMU with variables of every type: driven by switches, read inside."""

from pathlib import Path

import kinds_fmu
import numpy as np
import pytest
from case_for_tests import edit

from simulation import InputError, load_case

CASE = Path(__file__).with_name("kinds.toml").read_text()
ROWS_PER_H = np.array([[0.36], [1.44], [0.36]])


@pytest.fixture(scope="module", params=kinds_fmu.KINDS)
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return kinds_fmu.build_kinds_fmu(tmp_path_factory.mktemp("kinds"), **request.param)


def write_case(folder: Path, fmu: Path, *, output: str = "y") -> Path:
    """Write a case of half a day, its inputs known every 1800 s."""
    path = folder / "case.toml"
    path.write_text(CASE.format(fmu=fmu, output=output))
    lines = ["time_s,u,on,level,y"]
    lines += [f"{1800 * i},0.001,{'true' if i % 3 else 'false'},{i % 5 - 2},300" for i in range(26)]
    (folder / "recording.csv").write_text("\n".join(lines) + "\n")
    return path


def expected(k: np.ndarray, x: float) -> np.ndarray:
    """y every 1800 s with "warm" (4 letters) and size (2), k given step by step. Shape (25,)."""
    held = [0, *range(24)]
    states = [x]
    for each in k:
        decay = np.exp(-each * 1800.0)
        states.append(states[-1] * decay + 0.001 * (1.0 - decay) / each)
    shift = [2 + 4 + i % 5 - 2 + (10 if i % 3 else 0) for i in held]
    return np.array(states) + shift


@pytest.mark.parametrize("output", ["y", "inner"])
def test_switches_and_levels_follow_a_recording(fmu: Path, tmp_path: Path, output: str):
    """An output still sees the inputs of the step that ends with it, whether it is declared as one or not."""
    with load_case(write_case(tmp_path, fmu, output=output)).open_model() as model:
        answer = model.simulate(ROWS_PER_H)
    assert answer.failures == ("", "", "")
    for (k,), y in zip(ROWS_PER_H / 3600.0, answer.y[:, :, 0], strict=True):
        np.testing.assert_allclose(y, expected(np.full(24, k), 300.0)[12:], rtol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('column = "on"', 'column = "level"', r"inputs\[on\]: level is -2 at 0 s, .* Boolean; give 0 or 1"),
        ('column = "level"', 'column = "u"', r"inputs\[level\]: u is 0\.001 at 0 s, .*; give whole numbers"),
    ],
)
def test_what_does_not_fit_is_one_line(fmu: Path, tmp_path: Path, old: str, new: str, message: str):
    path = write_case(tmp_path, fmu)
    edit(tmp_path, (old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_case(path)
    assert "\n" not in str(caught.value)
