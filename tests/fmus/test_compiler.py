"""The compiler on small models: numbers against closed forms and ODE solvers, mistakes as one line each."""

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
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


@pytest.mark.parametrize("capacity", [1e4, 30.0])
def test_runge_kutta_follows_a_nonlinear_model_also_where_it_is_stiff(build, tmp_path, capacity):
    # With 30 J/K the time constant is 3 s: a substep of 60 s alone would explode.
    fmu = build(COOLING, RK4)
    assert validate_fmu(str(fmu)) == []
    driver = Driver(fmu, tmp_path / "unpacked")
    driver.initialize(C=capacity, TEnv=280.0)
    result = driver.run(["TEnv"], [[280.0]] * 12, 600.0, "T")
    driver.close()
    # The allowed error of 1e-9 relative per substep, over 120 to 3,000 substeps of a decaying solution.
    np.testing.assert_allclose(result, solve_cooling(280.0, capacity, 12, 600.0), rtol=0, atol=1e-5)


def test_a_solution_that_escapes_is_an_error(build, tmp_path):
    source = """
model M "Escapes in finite time"
  parameter Real k(unit="1/s") = 1 "Rate";
  Real x(unit="1", start=1, fixed=true) "State";
  output Real y(unit="1") "Output";
equation
  der(x) = k*x^2;
  y = x;
end M;
"""
    driver = Driver(build(source, RK4), tmp_path / "unpacked")
    driver.initialize()
    with pytest.raises(FMICallException, match="fmi2DoStep"):
        driver.fmu.doStep(0.0, 2.0)
    assert "diverge" in driver.messages[-1]
    driver.initialize(k=0.1)
    driver.fmu.doStep(0.0, 2.0)
    assert driver.get("y")[0] == pytest.approx(1.25, rel=1e-7)
    driver.close()


def test_both_solvers_agree_on_an_affine_model(build, tmp_path):
    source = """
model M "Two masses with a junction of no storage between them"
  parameter Real G1(unit="W/K") = 3 "One side";
  parameter Real G2(unit="W/K") = 5 "Other side";
  input Real Q(unit="W", start=0) "Heating of the junction";
  output Real TJ(unit="K") "Junction";
  Real T1(unit="K", start=300, fixed=true) "One";
  Real T2(unit="K", start=280, fixed=true) "Other";
  Real Q1(unit="W") "Flow";
  Real Q2(unit="W") "Flow";
equation
  Q1 = G1*(T1 - TJ);
  Q2 = G2*(T2 - TJ);
  Q1 + Q2 + Q = 0;
  1000*der(T1) = -Q1;
  2000*der(T2) = -Q2;
end M;
"""
    results = []
    for solver in ("exact", "rk4"):
        fmu = build(source, f'model = "M"\nsolver = "{solver}"\ntolerance = 1e-11\n', folder=solver)
        driver = Driver(fmu, tmp_path / f"unpacked-{solver}")
        driver.initialize()
        results.append(driver.run(["Q"], [[0.0], [100.0], [-50.0]], 500.0, "TJ"))
        driver.close()
    np.testing.assert_allclose(results[0], results[1], rtol=0, atol=1e-6)
    # A closed form: both masses tend to their common mean, over C1 C2/(C1 + C2)/G of 15/8 W/K.
    junction = (3.0 * 300.0 + 5.0 * 280.0) / 8.0
    assert results[0][0] == pytest.approx(junction, rel=1e-12)
    difference = 20.0 * np.exp(-500.0 / (1000.0 * 2000.0 / 3000.0 / (15.0 / 8.0)))
    mean = (1000.0 * 300.0 + 2000.0 * 280.0) / 3000.0
    expected = (3.0 * (mean + difference * 2 / 3) + 5.0 * (mean - difference / 3)) / 8.0
    assert results[0][1] == pytest.approx(expected, rel=1e-12)


HEAD = (
    'model M "Test"\n  Real x(unit="1", start=0, fixed=true) "State";\n  output Real y(unit="1") "Output";\n'
)
WRONG_MODELS = {
    "nonlinear loop": (HEAD + "equation\n  der(x) = -x;\n  y + y^3 = x;\nend M;", "nonlinear"),
    "equation missing": (HEAD + "equation\n  der(x) = -x;\nend M;", "1 equations for 2 unknowns"),
    "undetermined": (HEAD + "equation\n  der(x) = -x;\n  x = 1;\nend M;", "no equation determines"),
    "output without unit": (
        HEAD.replace('y(unit="1")', "y") + "equation\n  der(x) = -x;\n  y = x;\nend M;",
        "no unit",
    ),
    "unknown unit": (
        HEAD.replace('y(unit="1")', 'y(unit="furlong")') + "equation\n  der(x) = -x;\n  y = x;\nend M;",
        "furlong",
    ),
    "start not fixed": (
        HEAD.replace(", fixed=true", "") + "equation\n  der(x) = -x;\n  y = x;\nend M;",
        "fixed=true",
    ),
    "initial equation": (
        HEAD + "initial equation\n  x = 1;\nequation\n  der(x) = -x;\n  y = x;\nend M;",
        "initial equations",
    ),
    "parameter without value": (
        HEAD + '  parameter Real p(unit="1") "P";\nequation\n  der(x) = -p*x;\n  y = x;\nend M;',
        "has no value",
    ),
    "no state": (
        'model M "Test"\n  output Real y(unit="1") "Output";\nequation\n  y = 1;\nend M;',
        "has no state",
    ),
    "no Modelica": ("model M\n  Real x\nend M;", "does not parse"),
    "array": (
        HEAD + '  Real z[2](each unit="1") "A";\nequation\n  der(x) = -x;\n  y = x;\n  z = {1, 2};\nend M;',
        "array",
    ),
}


@pytest.mark.parametrize("name", WRONG_MODELS)
def test_a_model_that_cannot_be_compiled_is_one_clear_line(build, name):
    from fmus.compiler.errors import CompileError

    source, message = WRONG_MODELS[name]
    with pytest.raises(CompileError, match=message) as caught:
        build(source, RK4)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("", "key model is missing"),
        ('model = "M"\nsolver = "euler"', "solver = 'euler' is unknown"),
        ('model = "M"\nsubstep = 3', "unknown key 'substep'"),
        ('model = "M"\nmax_substep_s = 0', "must be positive"),
        ('model = "M"\nmax_substep_s = "3"', "must be a finite number"),
        ('model = "M"\nstop_time_s = 0', "must exceed"),
        ('model = "M"\nname = "a b"', "letters, digits"),
        ("model = ", "cannot be read"),
        ('model = "M"\nsolver = "exact"', "not affine"),
        ('model = "Other"', "Other"),
    ],
)
def test_a_wrong_build_file_is_one_clear_line(build, settings, message):
    from fmus.compiler.errors import CompileError

    with pytest.raises(CompileError, match=message) as caught:
        build(COOLING, settings)
    assert "\n" not in str(caught.value)


def test_a_constant_of_a_component_out_of_its_limits_is_found_when_building(build):
    from fmus.compiler.errors import CompileError

    source = """
package M
  model Part
    parameter Real C(unit="J/K", min=0) "Capacity";
    Real T(unit="K", start=300, fixed=true) "Temperature";
  equation
    C*der(T) = 300 - T;
  end Part;
  model Whole "Test"
    Part part(C=-1);
    output Real y(unit="K") "Output";
  equation
    y = part.T;
  end Whole;
end M;
"""
    with pytest.raises(CompileError, match=r"part\.C = -1\.0"):
        build(source, 'model = "M.Whole"\n')


@pytest.mark.parametrize(
    ("unit", "powers", "factor"),
    [
        ("1", {}, 1.0),
        ("K", {"K": 1}, 1.0),
        ("W/(m2.K)", {"kg": 1, "s": -3, "K": -1}, 1.0),
        ("m2.K/W", {"kg": -1, "s": 3, "K": 1}, 1.0),
        ("J/(kg.K)", {"m": 2, "s": -2, "K": -1}, 1.0),
        ("m3/h", {"m": 3, "s": -1}, 1.0 / 3600.0),
        ("kW", {"kg": 1, "m": 2, "s": -3}, 1e3),
        ("1/s", {"s": -1}, 1.0),
        ("m2/(s2.K)", {"m": 2, "s": -2, "K": -1}, 1.0),
    ],
)
def test_units_resolve_into_base_units(compiler, unit, powers, factor):
    from fmus.compiler.units import parse_unit

    base = parse_unit(unit)
    assert base.powers == powers
    assert base.factor == pytest.approx(factor, rel=1e-15)


def test_a_celsius_has_an_offset(compiler):
    from fmus.compiler.units import parse_unit

    assert parse_unit("degC").offset == 273.15


@pytest.mark.parametrize("unit", ["", "W/", "W/m2.K", "W^2", "furlong", "m 2"])
def test_malformed_units_are_refused(compiler, unit):
    from fmus.compiler.errors import CompileError
    from fmus.compiler.units import parse_unit

    with pytest.raises(CompileError, match="unit"):
        parse_unit(unit)


@pytest.mark.parametrize(
    ("unit", "expected"), [("K", "K/s"), ("W/m2", "W/(m2.s)"), ("W/(m2.K)", "W/(m2.K.s)"), ("1", "1/s")]
)
def test_units_of_time_derivatives(compiler, unit, expected):
    from fmus.compiler.units import derivative_unit, parse_unit

    assert derivative_unit(unit) == expected
    assert parse_unit(expected).powers["s"] == parse_unit(unit).powers.get("s", 0) - 1
