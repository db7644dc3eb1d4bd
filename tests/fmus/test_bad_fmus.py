"""Batches of rows over FMUs that misbehave: exactly the bad rows fail, and nothing is left behind."""

import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

sys.path.insert(0, str(Path(__file__).parent / "bad"))
from bad_fmus import (
    COUNT_VARIABLE,
    PARAMETERS,
    build_bad_fmu,
    closed_form,
    make_theta,
)

from simulation import InputError, Parameter, ParameterSpace, PoolModel
from simulation.experiments import ExperimentRows, JoinedModel
from simulation.fmi.fmu import FmuSettings
from simulation.layout import Experiment, Layout
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.fork_server import end_fork_servers
from simulation.pool.worker_process import NewProcess
from simulation.scenario import Scenario

N = 300
# Side by side and at both ends of a run of rows.
BAD_ROWS = [0, 7, 8, 299]
TIME = np.arange(11) * 3600.0
# exp over ten steps and 300 K: some hundred roundings.
EXACT_K = 1e-9
TIMEOUT_S = 0.5

REASONS = {
    "CRASH": r"^2 times: the FMU crashed its process \(SIGSEGV\)",
    "HANG": r"^did not answer within 0\.5 s and was stopped$",
    "FATAL": r"Fatal.*the heap is broken",
    "ONCE": r"Error.*the valve is stuck",
}


@pytest.fixture(scope="session")
def bad_fmu(tmp_path_factory):
    """Compile an FMU at most once."""
    folder, built = tmp_path_factory.mktemp("bad"), {}

    def build(behaviour):
        if behaviour not in built:
            built[behaviour] = build_bad_fmu(behaviour, folder)
        return built[behaviour]

    return build


@pytest.fixture(scope="module", autouse=True)
def no_process_is_left():
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    yield
    # Nothing but the fork server; a zombie is a child as well.
    end_fork_servers()
    left = [c for c in psutil.Process().children(recursive=True) if c.pid not in before]
    # A database server of other tests starts processes when it likes.
    assert [c for c in left if "postgres" not in str(c)] == []


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    """The same for all tests: in other surroundings, another process is needed to fork workers from."""
    folder = tmp_path_factory.mktemp("surroundings")
    for name in ("temporary", "working"):
        (folder / name).mkdir()
    return folder


@pytest.fixture
def trace(surroundings, monkeypatch):
    """Folders for all that a batch may leave behind; checks that it leaves nothing."""
    temporary, working = surroundings / "temporary", surroundings / "working"
    count = surroundings / "count.csv"
    count.unlink(missing_ok=True)
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setenv(COUNT_VARIABLE, str(count))
    monkeypatch.chdir(working)
    yield count
    assert list(temporary.iterdir()) == []
    assert list(working.iterdir()) == []


def settings_of(fmu):
    bounds = {"k": (2e-5, 5e-4), "x0": (280.0, 320.0), "trouble": (0.0, 1.0)}
    return FmuSettings(
        path=fmu,
        parameter_space=ParameterSpace(tuple(Parameter(name, *bounds[name]) for name in PARAMETERS)),
        scenario=Scenario(TIME, np.empty((len(TIME) - 1, 0)), (), output_every=1),
        output_names=("y",),
        output_offsets=np.zeros(1),
    )


def simulated(fmu, theta, *, n_workers=2, **policy):
    model = PoolModel(settings_of(fmu).open, n_workers, policy=ExecutionPolicy(**policy))
    with model:
        return model.simulate(theta)


def test_experiments_of_an_fmu_that_makes_one_instance_per_process_do_not_meet(bad_fmu, trace):
    settings, columns = settings_of(bad_fmu("ONCE")), np.arange(3)
    experiments = tuple(Experiment(name, columns, np.array([k]), len(TIME)) for k, name in enumerate("ab"))
    layout = Layout(settings.parameter_space.names, ("y@a", "y@b"), TIME, experiments)
    rows, theta = ExperimentRows(layout, (settings, settings)), make_theta(6, [])
    with PoolModel(rows.open, 2) as pool:
        answer = JoinedModel(pool, rows, settings.parameter_space).simulate(theta)
    for k in range(2):
        np.testing.assert_allclose(answer.y[..., k], closed_form(theta, TIME), rtol=0, atol=EXACT_K)


@pytest.mark.parametrize("behaviour", REASONS)
def test_exactly_the_bad_rows_fail_and_say_why(behaviour, bad_fmu, trace):
    theta = make_theta(N, BAD_ROWS)
    answer = simulated(bad_fmu(behaviour), theta, timeout_s=TIMEOUT_S if behaviour == "HANG" else None)
    assert np.flatnonzero(answer.failed).tolist() == BAD_ROWS
    np.testing.assert_array_equal(answer.theta, theta)
    good = ~answer.failed
    expected = closed_form(theta[good], TIME)
    np.testing.assert_allclose(answer.y[good, :, 0], expected, rtol=0, atol=EXACT_K)
    assert np.isnan(answer.y[BAD_ROWS]).all()
    for row in BAD_ROWS:
        assert re.search(REASONS[behaviour], answer.failures[row]), answer.failures[row]


@pytest.mark.parametrize("behaviour", ["LEAK", "NO_RESET", "PRINTS", "WRITES"])
def test_what_is_always_bad_falsifies_no_row(behaviour, bad_fmu, trace, capfd):
    theta = make_theta(N, BAD_ROWS)
    answer = simulated(bad_fmu(behaviour), theta, max_growth_mb=100.0)
    assert not answer.failed.any()
    np.testing.assert_allclose(answer.y[:, :, 0], closed_form(theta, TIME), rtol=0, atol=EXACT_K)
    assert capfd.readouterr() == ("", "")


def has_loaded(process):
    """Only the processes that run the FMU have its library mapped; one that was replaced may just end."""
    try:
        return any(one.path.endswith("bad.so") for one in process.memory_maps())
    except psutil.NoSuchProcess:
        return False


def test_an_fmu_that_keeps_its_first_parameters_gets_a_process_for_each_row(bad_fmu, trace):
    theta = make_theta(6, [])
    answer = simulated(bad_fmu("FROZEN"), theta)
    assert not answer.failed.any()
    np.testing.assert_allclose(answer.y[:, :, 0], closed_form(theta, TIME), rtol=0, atol=EXACT_K)


@pytest.mark.parametrize("behaviour", ["LOADS", "STUCK"])
def test_an_fmu_that_hangs_when_it_is_opened_takes_its_time_out(behaviour, bad_fmu, trace):
    began = time.monotonic()
    with pytest.raises(InputError, match=r"did not open within 0\.5 s and was stopped; raise simulation"):
        simulated(bad_fmu(behaviour), make_theta(3, []), timeout_s=TIMEOUT_S)
    assert time.monotonic() - began < 60.0, "0.5 s, and the start of a process on a busy machine"


def until(condition):
    """Whether it becomes true within a minute."""
    deadline = time.monotonic() + 60.0
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.05)
    return condition()


def daemons():
    """Processes that an FMU started and that left everything but our family."""
    return [one.pid for one in psutil.process_iter(["cmdline"]) if one.info["cmdline"] == ["a-daemon", "987"]]


@pytest.mark.parametrize("end", ["close", "killed supervisor"])
def test_a_daemon_that_an_fmu_starts_ends_with_its_process(end, bad_fmu, trace):
    fmu, before = bad_fmu("DAEMON"), daemons()
    with PoolModel(settings_of(fmu).open, 1) as model:
        assert not model.simulate(make_theta(6, []), NewProcess.WHEN_NEEDED).failed.any()
        loaded = [one for one in psutil.Process().children(recursive=True) if has_loaded(one)]
        (worker,) = [one for one in loaded if one.parent() not in loaded]  # not a daemon of it
        # One simulation takes less time than the daemon needs to begin.
        assert until(lambda: set(daemons()) - set(before)), "each instance starts one"
        if end != "close":
            worker.parent().kill()
            assert until(lambda: daemons() == before)
            # And the rows go on in a new one.
            assert not model.simulate(make_theta(6, [])).failed.any()
    assert daemons() == before
