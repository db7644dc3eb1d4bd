"""Events in compiled models: closed forms in both versions and interfaces of FMI, mistakes as one line."""

import itertools

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

BALL = """
model M "Ball that bounces, hit by a hammer when it has bounced three times"
  parameter Real e(unit="1", min=0, max=1) = 0.8 "Part of the speed that a bounce leaves";
  parameter Real g(unit="m/s2") = 9.81 "Gravity";
  parameter Real hStart(unit="m") = 1 "Height at the start";
  Real h(unit="m", start=hStart, fixed=true) "Height";
  Real v(unit="m/s", start=0, fixed=true) "Speed";
  discrete Real n(unit="1", start=0, fixed=true) "Bounces";
  output Real y(unit="m") "Height";
  output Real count(unit="1") "Bounces";
equation
  der(h) = v;
  der(v) = -g;
  y = h;
  count = n;
  when h < 0 then
    reinit(v, if pre(n) > 1.5 then 5 else -e*pre(v));
    n = pre(n) + 1;
  end when;
end M;
"""
EVENTS = 'model = "M"\nevents = true\nmax_substep_s = 0.05\nstop_time_s = 2.5\nstep_size_s = 0.05\n'
VERSIONS = ('fmi_version = "2.0"\n', 'fmi_version = "3.0"\n')
KINDS = ("CoSimulation", "ModelExchange")


def bounce(time, e=0.8, g=9.81, height=1.0):
    """Height and number of bounces in closed form, until the fourth; the hammer acts at the third."""
    fall = np.sqrt(2 * height / g)
    speeds = [e * g * fall, e * e * g * fall, 5.0]
    starts = fall + np.concatenate([[0.0], np.cumsum([2 * v / g for v in speeds])])
    flight = np.searchsorted(starts, time, side="right")
    assert flight.max() <= 3
    y = height - 0.5 * g * time**2
    for k in range(1, 4):
        since = time - starts[k - 1]
        y = np.where(flight == k, speeds[k - 1] * since - 0.5 * g * since**2, y)
    return y, flight


def run(fmu, kind, step, stop=2.4, tolerance=1e-9, output=("y", "count")):
    answer = simulate_fmu(
        str(fmu),
        fmi_type=kind,
        stop_time=stop,
        output_interval=step,
        relative_tolerance=tolerance,
        output=list(output),
        record_events=False,
    )
    return answer["time"], [answer[name] for name in output]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_ball_bounces_where_its_parabolas_say(build, version):
    fmu = build(BALL, EVENTS + version)
    assert validate_fmu(str(fmu)) == []
    for kind, step in itertools.product(KINDS, (0.03, 0.4)):
        time, (y, count) = run(fmu, kind, step)
        expected, n = bounce(time)
        # Runge-Kutta is exact on parabolas; the integrator of a master is asked for 1e-9.
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 if kind == "CoSimulation" else 1e-6)
        np.testing.assert_array_equal(count, n)
