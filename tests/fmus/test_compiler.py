"""The compiler on small models: numbers against closed forms and ODE solvers, mistakes as one line each."""

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from fmu_for_tests import Driver
from scipy.integrate import solve_ivp

COOLING = """
model M "Body that radiates and convects"
  parameter Real C(unit="J/K", min=1) = 1e4 "Heat capacity";
  parameter Real k(unit="W", min=0) = 2.0 "Coefficient";
  parameter Real TStart(unit="K") = 350 "Start";
  input Real TEnv(unit="K", start=280) "Surroundings";
  output Real Q(unit="W") "Loss";
  Real T(unit="K", start=TStart, fixed=true) "Body";
protected
  Real dT(unit="K") "Difference";
equation
  dT = T - TEnv;
  Q = (if TEnv > 250 then k else 0)*dT*(dT^2 + 0.01)^0.125 + 5.67e-8*abs(-0.1)*(max(T, 1)^4 - TEnv^4);
  C*der(T) = -Q*(1 + 0.1*sin(time/100));
end M;
"""
RK4 = 'model = "M"\nsolver = "rk4"\n'


def cooling_rate(t, y, env, capacity=1e4):
    difference = y[0] - env
    loss = 2.0 * difference * (difference**2 + 0.01) ** 0.125 + 5.67e-9 * (y[0] ** 4 - env**4)
    return [-loss * (1 + 0.1 * np.sin(t / 100)) / capacity]


def solve_cooling(env, capacity, n_steps, step):
    y, t, result = [350.0], 0.0, [350.0]
    for _ in range(n_steps):
        solution = solve_ivp(
            cooling_rate, (t, t + step), y, args=(env, capacity), method="Radau", rtol=1e-11, atol=1e-9
        )
        t, y = t + step, solution.y[:, -1]
        result.append(y[0])
    return np.array(result)


def test_runge_kutta_follows_a_nonlinear_model_also_where_it_is_stiff(build, tmp_path):
    fmu = build(COOLING, RK4)
    assert validate_fmu(str(fmu)) == []
    driver = Driver(fmu, tmp_path / "unpacked")
    # With 30 J/K the time constant is 3 s: a substep of 60 s alone would explode.
    for capacity in (1e4, 30.0):
        driver.initialize(C=capacity, TEnv=280.0)
        result = driver.run(["TEnv"], [[280.0]] * 12, 600.0, "T")
        # The allowed error of 1e-9 relative per substep, over 120 to 3,000 substeps of a decaying solution.
        np.testing.assert_allclose(result, solve_cooling(280.0, capacity, 12, 600.0), rtol=0, atol=1e-5)
    driver.close()


EVENTS = f"{RK4}events = true\n"
HEAD = """
model M "Test"
  Real x(unit="1", start=0, fixed=true) "State";
  output Real y(unit="1") "Output";
equation
  der(x) = 1;
"""
WHEN = "when x > 1 then\n"
WRONG = {
    "nonlinear loop": (f"{HEAD}y + y^3 = x;\nend M;", RK4, "nonlinear"),
    "undetermined": (f"{HEAD}x = 1;\nend M;", RK4, "no equation determines"),
    "reinit": (f"{HEAD}{WHEN}reinit(x, 0);\nend when;\nend M;", EVENTS, "`variable = expression` alone"),
    "if": (f"{HEAD}y = if x > 1 then 1 else 0;\nend M;", EVENTS, "if is not understood beside events"),
    "not discrete": (f"{HEAD}{WHEN}y = 1;\nend when;\nend M;", EVENTS, "declare it as discrete"),
    "without events": (f"{HEAD}{WHEN}y = 1;\nend when;\nend M;", RK4, "write events = true"),
    "noEvent": (f"{HEAD}y = noEvent(x);\nend M;", EVENTS, r"noEvent\(\) is not understood"),
    "solver": (COOLING, 'model = "M"\nsolver = "euler"', "solver = 'euler': .* should be 'exact' or 'rk4'"),
    "setting": (COOLING, 'model = "M"\nsubstep = 3', "substep = 3: Unexpected keyword"),
    "not linear": (COOLING, 'model = "M"\nsolver = "exact"', "not affine"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_compiled_is_one_clear_line(build, name):
    from fmus.compiler.settings import CompileError

    source, settings, message = WRONG[name]
    with pytest.raises(CompileError, match=message) as caught:
        build(source, settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_model_exchange_only_offers_no_co_simulation(build, tmp_path, version):
    source = 'model M "Test"\n  Real x(unit="1", start=1, fixed=true) "State";\n'
    source += '  output Real y(unit="1") "Output";\nequation\n  der(x) = -x/1000;\n  y = x;\nend M;'
    fmu = build(source, f'model = "M"\nmodel_exchange_only = true\nfmi_version = "{version}"\n')
    assert validate_fmu(str(fmu)) == []
    description = read_model_description(str(fmu))
    assert description.coSimulation is None
    assert description.modelExchange is not None
    answer = simulate_fmu(str(fmu), stop_time=1000.0, output_interval=100.0, relative_tolerance=1e-8)
    assert answer["y"][-1] == pytest.approx(np.exp(-1.0), abs=1e-6)
