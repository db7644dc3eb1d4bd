"""Arrays of FMI 3.0: elements are used as y[1], RC[2], gain[1,2], in both interfaces; others are refused."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_fmu_for_tests import write_fmu
from scipy.optimize import least_squares

from simulation import InputError, load_case
from simulation.fmi.description import read_description

SOURCE = Path(__file__).with_name("arrays.c")
TRUE_RC, TRUE_X0, NOISE_K = (5000.0, 9000.0), (295.0, 288.0), 0.05
TIME = np.arange(0.0, 36001.0, 600.0)

OUTPUT = """
[[outputs]]
name = "{name}"
unit = "K"
file = "data.csv"
column = "{name}"
uncertainty = 0.05
"""
INPUT = """
[[inputs]]
name = "{name}"
unit = "K"
file = "data.csv"
column = "{name}"
interpolation = "held"
"""
PARAMETER = """
[[parameters]]
name = "{name}"
lower = {low}
upper = {high}
unit = "{unit}"
"""


def truth() -> tuple[np.ndarray, np.ndarray]:
    """Return inputs, held over steps, and states of the two rooms. Shape (t, 2) each. [K]."""
    u = 283.0 + np.stack([6.0 * np.sin(TIME / 5000.0), 4.0 * np.cos(TIME / 3000.0)], axis=1)
    x = np.empty_like(u)
    x[0] = TRUE_X0
    for i in range(len(TIME) - 1):
        x[i + 1] = u[i] + (x[i] - u[i]) * np.exp(-600.0 / np.array(TRUE_RC))
    return u, x


def write(folder: Path, *, inputs: str = "", parameters: str = "", outputs: str = "", more: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    write_fmu(folder / "arrays.fmu", SOURCE.with_suffix(".xml").read_text(), SOURCE, platform="x86_64-linux")
    u, x = truth()
    y = x + NOISE_K * np.random.default_rng(0).standard_normal(x.shape)
    rows = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack([TIME, u, y])]
    (folder / "data.csv").write_text("\n".join(["time_s,u[1],u[2],y[1],y[2]", *rows]) + "\n")
    head = 'schema = 1\nname = "rooms"\nfmu = "arrays.fmu"\n{more}\n[time]\nwindow_s = [0, 36000]\n'
    text = head.format(more=more) + "communication_step_s = 600\noutput_step_s = 600\n"
    text += inputs or "".join(INPUT.format(name=name) for name in ("u[1]", "u[2]"))
    # In another order than the array has.
    text += outputs or "".join(OUTPUT.format(name=name) for name in ("y[2]", "y[1]"))
    boxes = [("RC[1]", 1000, 30000, "s"), ("x0[2]", 280, 300, "K"), ("RC[2]", 1000, 30000, "s")]
    text += parameters or "".join(
        PARAMETER.format(name=name, low=low, high=high, unit=unit) for name, low, high, unit in boxes
    )
    (folder / "case.toml").write_text(text)
    return folder / "case.toml"


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
def test_the_truth_is_recovered(tmp_path: Path, interface: str) -> None:
    """One element of x0 is calibrated, the other fixed: neither undoes the other."""
    file = write(tmp_path / "rooms", more=f'interface = "{interface}"\nrelative_tolerance = 1e-7')
    file.write_text(file.read_text() + '\n[fixed]\n"x0[1]" = 295.0\n"gain[1,2]" = 0.0\n')
    case = load_case(file)
    with case.open_model() as model:

        def residuals(v: np.ndarray) -> np.ndarray:
            answer = model.simulate(np.array([[v[0] * 1000.0, v[1], v[2] * 1000.0]]))
            assert not answer.failures[0], answer.failures
            return case.measurement.compared(answer.y)[0]

        found = least_squares(residuals, [3.0, 290.0, 3.0], diff_step=1e-4)
    assert np.sqrt(np.mean(found.fun**2)) < 2.0 * NOISE_K
    np.testing.assert_allclose(found.x * [1000.0, 1.0, 1000.0], [5000.0, 288.0, 9000.0], rtol=0.01)


def test_elements_of_a_matrix_are_in_the_order_of_rows(tmp_path: Path) -> None:
    outputs = OUTPUT.format(name="y[1]")
    file = write(tmp_path / "rooms", outputs=outputs)
    file.write_text(file.read_text() + '\n[fixed]\n"gain[1,1]" = 0.0\n"gain[1,2]" = 1.0\n')
    with load_case(file).open_model() as model:
        y = model.simulate(np.array([[5000.0, 288.0, 9000.0]])).y[0, :, 0]
    np.testing.assert_allclose(y, truth()[1][:, 1], rtol=1e-9)


def test_what_is_declared(tmp_path: Path) -> None:
    fmu = read_description(write(tmp_path / "rooms").with_name("arrays.fmu"))
    assert fmu.names("output") == ("y[1]", "y[2]")
    assert [fmu.variables[name].start for name in ("RC[1]", "RC[2]", "gain[1,2]", "gain[2,2]")] == [
        3600,
        7200,
        0,
        1,
    ]
    assert (fmu.states, fmu.derivatives) == (("x[1]", "x[2]"), ("der(x)[1]", "der(x)[2]"))
    assert fmu.variables["walls"].shape == (3,)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"outputs": OUTPUT.format(name="y").replace('column = "y"', 'column = "y[1]"')},
            r"has no output named y; it has: y\[1\], y\[2\]",
        ),
        ({"inputs": INPUT.format(name="u[1]")}, r"inputs u\[1\] to u\[2\] are one array.* also u\[2\]"),
        (
            {"parameters": PARAMETER.format(name="walls", low=0, high=1, unit="1")},
            r"parameters\[walls\]: walls is an array \(3\) of arrays.fmu, whose elements no case can use: "
            "its size is a structural parameter",
        ),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path: Path, change: dict[str, str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_case(write(tmp_path / "rooms", **change))


def test_an_array_is_no_obstacle_of_an_fmu_that_is_unpacked_again(tmp_path: Path) -> None:
    """The same rows from a reset instance and from a new one."""
    case = load_case(write(tmp_path / "rooms"))
    theta = np.array([[5000.0, 288.0, 9000.0], [3000.0, 290.0, 8000.0], [5000.0, 288.0, 9000.0]])
    with case.open_model() as model:
        rows = model.simulate(theta).y
    with case.open_model() as model:
        np.testing.assert_array_equal(model.simulate(theta[1:]).y, rows[1:])
    np.testing.assert_array_equal(rows[0], rows[2])
    assert zipfile.is_zipfile(case.fmu.path)
