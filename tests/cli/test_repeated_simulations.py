"""What commands say and do where simulations of one FMU depend on each other, or are not repeated at all."""

import sys
from pathlib import Path

import numpy as np
import pytest
from bad_cases_for_tests import make_bad_case
from project_for_tests import Run

from simulation.store.store import SimulationStore

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "simulation"))

from forgetful_fmu import forgetful_settings


def make_forgetful_case(project: Path, fault: str, n: int = 73) -> Path:
    """Make a case of an FMU that forgets to forget, measured by itself; return its file."""
    settings = forgetful_settings(project, fault)
    folder = project / "fmus" / "room"
    folder.mkdir(parents=True)
    settings.path.rename(folder / "room.fmu")
    (project / "data" / "room").mkdir(parents=True)
    with forgetful_settings(project).open() as model:
        y = model.simulate(np.array([[1.2e-4, 305.0]])).y[0, :n, 0]
    edges, inputs = settings.scenario.time_communication, settings.scenario.inputs[:, 0]
    rows = ["time_s,u,y"]
    rows += [
        f"{at:g},{u:.6f},{value:.4f}" for at, u, value in zip(edges, np.r_[inputs, 280.0], y, strict=True)
    ]
    (project / "data" / "room" / "recording.csv").write_text("\n".join(rows) + "\n")
    file = folder / "case.toml"
    boxes = "".join(
        f'[[parameters]]\nname = "{one.name}"\nlower = {one.lower}\nupper = {one.upper}\nunit = "1"\n'
        for one in settings.parameter_space.parameters
    )
    file.write_text(
        'schema = 1\nname = "room"\nfmu = "room.fmu"\ndata = "../../data/room"\n'
        "[time]\nwindow_s = [0, 43200]\ncommunication_step_s = 600\noutput_step_s = 600\n"
        '[[inputs]]\nname = "u"\nunit = "1"\nfile = "recording.csv"\ncolumn = "u"\ninterpolation = "held"\n'
        '[[outputs]]\nname = "y"\nunit = "1"\nfile = "recording.csv"\ncolumn = "y"\nuncertainty = 0.01\n'
        + boxes
    )
    return file


def stores(project: Path) -> list[Path]:
    return sorted((project / "data" / "room" / "generated" / "simulations").glob("*.db"))


def test_a_random_fmu_is_named_by_calibrate(project: Path, studies: Run) -> None:
    make_bad_case(project, "RANDOM")
    found = studies("calibrate", "bad", "--max-calls", "12", "--json").stage
    assert found["is_random"]
    assert found["n_repeated"] == 1
    assert "The FMU is not deterministic" in studies("calibrate", "bad", "--max-calls", "12").out


def test_a_calibration_is_right_whatever_a_reset_forgets(project: Path, studies: Run) -> None:
    make_forgetful_case(project, "DISCRETE_STATE")
    found = studies("calibrate", "room", "--max-calls", "30", "--json").stage
    assert not found["is_random"]
    assert found["n_repeated"] == 1
    assert np.allclose(list(found["theta"].values()), [1.2e-4, 305.0], rtol=1e-3)
    for file in stores(project):
        with SimulationStore.at(file) as store:
            assert store.first(store.theta).all()


@pytest.mark.slow
def test_a_command_begins_anew_where_simulations_are_found_wrong(
    project: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simulation.pool.pool_model._UNNOTICED_S", 0.0)
    make_forgetful_case(project, "COUNTER")
    answer = studies("simulate", "room", "--profile", "smoke", "--jobs", "1")
    assert answer.code == 0, answer.err
    assert "the FMU does not forget one simulation before the next" in answer.err
    assert "the command begins anew" in answer.err
    (file,) = stores(project)
    with SimulationStore.at(file) as store:
        assert store.is_reuse_given_up
        assert len(store.theta) == 32 + 32 + 32
        assert not len(store.theta_reused)
    assert list(file.parent.glob("*.own-process"))
    found = studies("calibrate", "room", "--max-calls", "12", "--json").stage
    assert found["has_own_processes"]
