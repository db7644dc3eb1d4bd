"""Variables inside an FMU that follow time alone, and what they do between two outputs."""

import numpy as np
import pytest

from simulation.arrays import FloatArray
from studies.calibration.state_equations.hidden_inputs import Course, LocalVariables
from studies.calibration.state_equations.states import StateSignals

N_OUTPUTS, EVERY, STEP_S = 145, 3, 600.0
TIME = EVERY * STEP_S * np.arange(N_OUTPUTS)
DAY = 2.0 * np.pi / 86400.0
OUTDOOR = 278.0 + 5.0 * np.sin(DAY * TIME) + 2.0 * np.cos(DAY * TIME / 2.3)
SUN = np.maximum(-300.0 * np.cos(DAY * TIME), 0.0)
USE = ((TIME / 3600.0) % 24.0 >= 8.0).astype(float)


def signals_of(names: tuple[str, ...], units: tuple[str, ...]) -> StateSignals:
    """One state in K without declared inputs, and variables beside it."""
    return StateSignals(
        states=("T",),
        derivatives=("der(T)",),
        inputs=(),
        units=("K",),
        depends_on=(frozenset({"T"}),),
        driven=np.empty((EVERY * (N_OUTPUTS - 1), 0)),
        step_s=STEP_S,
        every=EVERY,
        n_before=0,
        outputs=("T",),
        conversions=np.array([[1.0, 0.0]]),
        locals=names,
        local_units=units,
    )


def in_rows(*columns: FloatArray, n: int = 4) -> FloatArray:
    return np.tile(np.stack(columns, axis=-1), (n, 1, 1))


def test_what_follows_time_is_an_input_once_each() -> None:
    names = ("sun", "sun in kW", "outdoor in degC", "constant", "flow", "sun and outdoor", "gain", "broken")
    units = ("W/m2", "kW/m2", "degC", "1", "W", "1", "W", "1")
    locals_ = LocalVariables(signals_of(names, units))
    values = in_rows(
        SUN, SUN / 1000.0, OUTDOOR - 273.15, 0.2 + 0.0 * SUN, SUN, SUN + 7.0 * OUTDOOR, USE, np.nan * SUN
    )
    # One flow follows the state of each row; a gain is scaled by a parameter, and is a new input once.
    values[..., 4] += np.arange(4)[:, None] * np.sin(TIME / 7000.0)
    values[..., 6] *= np.array([1.0, 3.0, 0.5, 12.0])[:, None]
    locals_.note(values[:2])
    locals_.note(values[2:])
    found = locals_.as_inputs()
    assert found.inputs == ("outdoor in degC", "sun", "gain")
    assert found.units == ("K", "K", "W/m2", "W")
    assert found.n_hidden == 3
    np.testing.assert_allclose(found.at_outputs[:, 0], OUTDOOR)


def test_what_a_later_row_shows_to_follow_parameters_is_no_input() -> None:
    locals_ = LocalVariables(signals_of(("sun",), ("W/m2",)))
    locals_.note(in_rows(SUN))
    assert locals_.as_inputs().inputs == ("sun",)
    locals_.note(in_rows(SUN + 1e-3 * OUTDOOR, n=1))
    assert locals_.as_inputs().inputs == ()


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_a_schedule_jumps_at_any_place_between_two_outputs(place: int) -> None:
    steps = np.arange(EVERY * (N_OUTPUTS - 1))
    driven = ((steps - place) // (8 * EVERY) % 2).astype(float)
    seen = np.append(driven[::EVERY], driven[-1])
    if place == EVERY:
        # At an output itself the new value is seen.
        driven = np.repeat(seen[:-1], EVERY)
    else:
        seen[1:] = driven[EVERY - 1 :: EVERY]
    course = Course(seen[:, None], EVERY)
    courses = [course, *course.others(0)]
    assert any(np.array_equal(one.driven[:, 0], driven) for one in courses)


def test_weather_is_smooth_between_outputs() -> None:
    steps = STEP_S * (np.arange(EVERY * (N_OUTPUTS - 1)) + 0.5)
    # The mean of a sine over a step is that in its middle, but for a few millionths.
    expected = 278.0 + 5.0 * np.sin(DAY * steps) + 2.0 * np.cos(DAY * steps / 2.3)
    driven = Course(OUTDOOR[:, None], EVERY).driven[:, 0]
    assert np.abs(driven - expected).max() < 2e-3
