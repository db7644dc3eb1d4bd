"""PEtab problems with an FMU as their model: their objective is repeated, else one line says why not."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from c_fmu_for_tests import write_fmu
from decaying_case_for_tests import SOURCE
from project_for_tests import Run
from scipy.integrate import solve_ivp

from fmus.compiler.package import build_fmu
from simulation import PoolModel, load_case
from simulation.case import Case
from simulation.experiments import JoinedModel
from studies.new.petab_tables import read_petab

pytest.importorskip("petab")
HERE = Path(__file__).parent
PUBLISHED = HERE.parents[2] / "shared" / "data" / "petab"
K, U = 1.4e-4, 0.02
OBSERVABLES = "observableId\tobservableFormula\tnoiseFormula"
PARAMETERS = "parameterId\tparameterScale\tlowerBound\tupperBound\tnominalValue\testimate"
MEASURED = "observableId\tsimulationConditionId\tmeasurement\ttime\tnoiseParameters"


def published(name: str) -> Path:
    """Return a problem of the public collection, whose tables are not ours to ship."""
    file = PUBLISHED / name / f"{name}.yaml"
    if not file.is_file():
        pytest.skip(f"needs {name} of Benchmark-Models-PEtab in ../shared/data/petab")
    return file


def crauste(_: float, y: np.ndarray, p: dict[str, float]) -> list[float]:
    n, e, l, _, g = y  # noqa: E741 - the paper's letters
    return [
        -p["mu_N"] * n - p["delta_NE"] * n * g,
        p["delta_NE"] * n * g + p["rho_E"] * e * g - p["mu_EE"] * e * e - p["delta_EL"] * e,
        p["delta_EL"] * e - p["mu_LL"] * l * l - p["mu_LE"] * e * l - p["delta_LM"] * l,
        p["delta_LM"] * l,
        p["rho_P"] * g * g - p["mu_PE"] * e * g - p["mu_PL"] * l * g - p["mu_P"] * g,
    ]


def built(folder: Path, name: str, max_substep_s: float) -> Path:
    pytest.importorskip("pymoca")
    (folder / f"{name}.mo").write_text((HERE / f"{name}.mo").read_text())
    (folder / "build.toml").write_text(f'model = "{name}"\nmax_substep_s = {max_substep_s}\n')
    return build_fmu(folder, None)


def chi2(case: Case) -> float:
    """Return PEtab's sum of squares at the nominal values, as the note of the case says it."""
    with PoolModel(case.make_model, 1) as pool:
        model = pool if case.layout is None else JoinedModel(pool, case.experiment_rows, case.parameter_space)
        answer = model.simulate(case.parameter_space.expected[None])
    assert not answer.failures[0], answer.failures
    factor, beside = re.findall(r"chi2 = (\S+) MSE(?: \+ (\S+), of replicates)?", case.note)[0]
    return float(factor) * float(case.measurement.mse(answer.y)[0]) + float(beside or 0.0)


def test_the_published_objective_of_a_problem_with_four_observables(
    new_project: Path, tmp_path: Path, studies: Run
) -> None:
    file = published("Crauste_CellSystems2017")
    answer = studies("new", str(file), "--fmu", str(built(tmp_path, "Crauste", 1.0)))
    assert answer.code == 0, answer.err
    case = load_case(new_project / "fmus" / "crauste_cellsystems2017")
    table = pd.read_csv(file.parent / f"measurementData_{file.stem}.tsv", sep="\t")
    nominal = case.parameter_space.named(case.parameter_space.expected)
    found = solve_ivp(
        crauste, (0.0, 28.0), [8090.0, 0.0, 0.0, 0.0, 1.0], "Radau", dense_output=True, rtol=1e-10, atol=1e-8,
        args=(nominal,),
    )  # fmt: skip
    names = ["Naive", "EarlyEffector", "LateEffector", "Memory"]
    y = [found.sol(t)[names.index(one.removeprefix("observable_"))] for one, t in zip(
        table["observableId"], table["time"], strict=True
    )]  # fmt: skip
    expected = np.sum(((table["measurement"] - y) / table["noiseParameters"]) ** 2)
    assert chi2(case) == pytest.approx(expected, rel=1e-5)
    assert len(case.parameter_space.names) == 12


def test_the_published_objective_of_a_problem_with_one_observable(
    new_project: Path, tmp_path: Path, studies: Run
) -> None:
    file = published("Rahman_MBS2016")
    assert studies("new", str(file), "--fmu", str(built(tmp_path, "Rahman", 0.1))).code == 0
    # From the simulated values that the collection has beside it.
    assert chi2(load_case(new_project / "fmus" / "rahman_mbs2016")) == pytest.approx(0.0358074, rel=1e-5)


def decay(time: np.ndarray, u: float, x0: float) -> np.ndarray:
    return x0 * np.exp(-K * time) + u * (1.0 - np.exp(-K * time)) / K


def first_version(folder: Path, **changes: str) -> Path:
    """Write a problem of two conditions with replicates; the tables that are named may be others."""
    at = np.array([600.0, 1800.0, 3600.0])
    rows = ["observableId\tsimulationConditionId\tmeasurement\ttime\tnoiseParameters"]
    for condition, u in (("weak", U), ("strong", 2.0 * U)):
        for t, y in zip(at, decay(at, u, 300.0), strict=True):
            rows += [f"obs\t{condition}\t{float(y + off)!r}\t{t:g}\t0.5" for off in (0.25, -0.25)]
    tables = {
        "measurements": "\n".join(rows),
        "conditions": f"conditionId\tu\nweak\t{U}\nstrong\t{2.0 * U}",
        "observables": "observableId\tobservableFormula\tnoiseFormula\nobs\ty\t2 * noiseParameter1_obs",
        "parameters": "parameterId\tparameterScale\tlowerBound\tupperBound\tnominalValue\testimate\t"
        "objectivePriorType\tobjectivePriorParameters\n"
        f"k\tlog10\t2e-5\t5e-4\t{K}\t1\tparameterScaleNormal\t-4;0.3\nx0\tlin\t280\t340\t300\t0\t\t",
    }
    for name, text in (tables | changes).items():
        (folder / f"{name}.tsv").write_text(text + "\n")
    problem = folder / "decay.yaml"
    problem.write_text(
        "format_version: 1\nparameter_file: parameters.tsv\nproblems:\n"
        "- condition_files: [conditions.tsv]\n  measurement_files: [measurements.tsv]\n"
        "  observable_files: [observables.tsv]\n  sbml_files: [none.xml]\n"
    )
    return problem


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    return write_fmu(tmp_path / "decay.fmu", SOURCE.with_suffix(".xml").read_text(), SOURCE)


def test_conditions_are_experiments_and_replicates_one_sample(
    new_project: Path, tmp_path: Path, fmu: Path, studies: Run
) -> None:
    file = first_version(tmp_path)
    assert studies("new", str(file), "--fmu", str(fmu)).code == 0
    case = load_case(new_project / "fmus" / "decay")
    assert [one.name for one, _ in case.members] == ["strong", "weak"]
    # Two of each moment, off by a quarter each with a deviation of 1: nothing else is left.
    assert chi2(case) == pytest.approx(12 * 0.25**2, rel=1e-5)
    (k,) = case.parameter_space.parameters
    assert (k.scale, k.estimate) == ("log", K)
    assert k.prior is not None
    assert (k.prior.centre, k.prior.deviation) == pytest.approx((1e-4, 10.0**0.3))
    (found,) = studies("calibrate", "decay", "--max-calls", "20", "--jobs", "1", "--json").document["stages"]
    assert found["theta"]["k"] == pytest.approx(K, rel=0.05)
    (new_project / "own").mkdir()
    (new_project / "own" / "y.csv").write_text("mine")
    for words in ((), ("--to", "own")):
        again = studies("new", str(file), "--fmu", str(fmu), *words)
        assert (again.code, again.err.count("\n")) == (2, 1)
        assert "is never overwritten" in again.err
    assert [one.name for one in (new_project / "own").iterdir()] == ["y.csv"]


@pytest.mark.slow
def test_conditions_give_variables_estimated_parameters(
    new_project: Path, tmp_path: Path, fmu: Path, studies: Run
) -> None:
    at, starts = np.array([600.0, 1800.0, 3600.0, 9000.0]), {"cold": 290.0, "warm": 330.0}
    rows = [
        f"obs\t{name}\t{float(y)!r}\t{t:g}\t0.05"
        for name, start in starts.items()
        for t, y in zip(at, decay(at, U, start), strict=True)
    ]
    file = first_version(
        tmp_path,
        measurements="\n".join([MEASURED, *rows]),
        conditions=f"conditionId\tu\tx0\ncold\t{U}\tstart_cold\nwarm\t{U}\tstart_warm",
        parameters=f"{PARAMETERS}\nk\tlog10\t2e-5\t5e-4\t1e-4\t1\nstart_cold\tlin\t280\t340\t300\t1\n"
        "start_warm\tlin\t280\t340\t300\t1",
    )
    answer = studies("new", str(file), "--fmu", str(fmu))
    assert answer.code == 0, answer.err
    (found,) = studies("calibrate", "decay", "--max-calls", "40", "--jobs", "1", "--json").document["stages"]
    expected = {"k": K, "start_cold": 290.0, "start_warm": 330.0}
    assert {name: pytest.approx(value, rel=0.01) for name, value in expected.items()} == found["theta"]


def test_the_second_version(new_project: Path, tmp_path: Path, fmu: Path, studies: Run) -> None:
    at = np.array([600.0, 1800.0, 3600.0])
    rows = [f"obs\te1\t{float(y)!r}\t{t:g}\t0.5" for t, y in zip(at, decay(at, U, 300.0) + 1.0, strict=True)]
    tables = {
        "measurements": "\n".join(["observableId\texperimentId\tmeasurement\ttime\tnoiseParameters", *rows]),
        "conditions": f"conditionId\ttargetId\ttargetValue\nc1\tu\t{U}",
        "experiments": "experimentId\ttime\tconditionId\ne1\t0\tc1",
        "observables": "observableId\tobservableFormula\tnoiseFormula\tnoisePlaceholders\tnoiseDistribution\n"
        "y\ty\ts1\ts1\tnormal\nobs\ty\ts1\ts1\tnormal",
        "parameters": "parameterId\tlowerBound\tupperBound\tnominalValue\testimate\tpriorDistribution\t"
        f"priorParameters\nk\t2e-6\t5e-4\t{K}\ttrue\tlog-normal\t-9;0.7\nx0\t280\t340\t300\tfalse\t\t",
    }
    for name, text in tables.items():
        (tmp_path / f"{name}.tsv").write_text(text + "\n")
    kinds = ("parameter", "condition", "experiment", "measurement", "observable")
    listed = "".join(f"{kind}_files: [{kind}s.tsv]\n" for kind in kinds)
    (tmp_path / "second.yml").write_text(f"format_version: 2.0.0\n{listed}")
    answer = studies("new", str(tmp_path / "second.yml"), "--fmu", str(fmu))
    assert answer.code == 0, answer.err
    case = load_case(new_project / "fmus" / "second")
    assert chi2(case) == pytest.approx(3 * (1.0 / 0.5) ** 2, rel=1e-5)
    (k,) = case.parameter_space.parameters
    assert k.scale == "log"
    assert k.prior is not None
    assert (k.prior.centre, k.prior.deviation) == pytest.approx((np.exp(-9.0), np.exp(0.7)))


NOISY = {
    "parameters": f"{PARAMETERS}\nk\tlog10\t2e-5\t5e-4\t{K}\t1\nsd\tlog10\t0.01\t10\t0.25\t1\n"
    "x0\tlin\t280\t340\t300\t0",
    "observables": f"{OBSERVABLES}\nobs\ty\t2 * noiseParameter1_obs",
}


@pytest.mark.parametrize("is_cell", [True, False])
def test_an_estimated_parameter_of_the_noise_has_its_nominal_value(
    new_project: Path, tmp_path: Path, fmu: Path, studies: Run, is_cell: bool
) -> None:
    """In a cell of the measurements, or in the formula: the objective at nominal values is PEtab's."""
    changes = dict(NOISY)
    if not is_cell:
        changes["observables"] = f"{OBSERVABLES}\nobs\ty\t2 * sd"
    file = first_version(tmp_path, **changes)
    if is_cell:
        table = tmp_path / "measurements.tsv"
        table.write_text(table.read_text().replace("\t0.5\n", "\tsd\n"))
    answer = studies("new", str(file), "--fmu", str(fmu))
    assert answer.code == 0, answer.err
    case = load_case(new_project / "fmus" / "decay")
    assert case.parameter_space.names == ("k",)
    assert chi2(case) == pytest.approx(12 * (0.25 / 0.5) ** 2, rel=1e-5)
    assert "Of the noise, sd is held at its nominal value: estimate it afterwards" in case.note


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            NOISY | {"observables": f"{OBSERVABLES}\nobs\ty\t1000 * k"},
            "k is estimated as a parameter of the model and of the noise",
        ),
        ({"observables": f"{OBSERVABLES}\nobs\t2 * y\t1"}, "obs is 2 * y, which is no variable of decay.fmu"),
        ({"observables": f"{OBSERVABLES}\nobs\ty\tsd"}, "depends on what is estimated or simulated (sd)"),
        ({"observables": f"{OBSERVABLES}\nobs\ty\t0.1 * y"}, "depends on what is estimated or simulated (y)"),
        (
            {"observables": f"{OBSERVABLES}\tobservableTransformation\nobs\ty\t1\tlog10"},
            "obs is compared as log10",
        ),
        ({"observables": f"{OBSERVABLES}\tnoiseDistribution\nobs\ty\t1\tlaplace"}, "noise of obs is laplace"),
        (
            {"parameters": f"{PARAMETERS}\nq\tlin\t0\t1\t0.5\t1"},
            "q is estimated, and decay.fmu has no variable",
        ),
        ({"measurements": f"{MEASURED}\nobs\tweak\t1\tinf\t1"}, "a steady state has no moment in a case"),
        (
            {"measurements": f"{MEASURED}\nother\tweak\t1\t1\t1"},
            "measurements of other, which is no observable",
        ),
        (
            {"measurements": f"{MEASURED}\nobs\tmild\t1\t1\t1"},
            "the condition mild, which is declared nowhere",
        ),
        ({"measurements": f"{MEASURED}\nobs\tweak\t1\t1\t0"}, "the noise of obs is 0; give one above 0"),
        (
            {"measurements": "nonsense\n1"},
            "no measurement table of PEtab (no column observableId)",
        ),
        ({"measurements": f"{MEASURED}\nobs\tweak\tmuch\t1\t1"}, "could not convert string to float: 'much'"),
    ],
)
def test_what_a_case_cannot_say_is_one_line(
    new_project: Path, tmp_path: Path, fmu: Path, studies: Run, changes: dict[str, str], said: str
) -> None:
    answer = studies("new", str(first_version(tmp_path, **changes)), "--fmu", str(fmu))
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1), answer.err
    assert said in answer.err
    assert not (new_project / "fmus" / "decay").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("format_version: 3", "versions 1 and 2 can be read"),
        ("nonsense", "no PEtab problem"),
        ("format_version: 1\nparameter_file: ../p.tsv\nproblems: [{condition_files: [], "
         "measurement_files: [], observable_files: []}]", "lies outside its folder"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_problem_is_one_line(tmp_path: Path, content: str, said: str) -> None:
    file = tmp_path / "problem.yaml"
    file.write_text(content)
    with pytest.raises(ValueError, match=said) as refused:
        read_petab(file)
    assert "\n" not in str(refused.value)


def test_the_model_of_a_problem_has_to_be_named(new_project: Path, tmp_path: Path, studies: Run) -> None:
    answer = studies("new", str(first_version(tmp_path)))
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert "--fmu Model.fmu" in answer.err
