"""A user's own class of surrogates, installed as a package: tuned per size, calibrated with, made again."""

import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from mlflow_store_for_tests import give_store

from simulation.errors import InputError
from studies.own_surrogate import own_class
from studies.profile import load_profile
from studies.search_space import OwnConfig

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "own-surrogate.md").read_text("utf-8")
PROFILE = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)[0]
SMALL = {
    "n_train = [32, 64]": "n_train = [16]\nn_validation = 12\nn_test = 12",
    "n_trials = 8": "n_trials = 2",
}


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A Python of its own that has the packages of this one, and the classes of the page installed."""
    folder = tmp_path_factory.mktemp("venv")
    venv.create(folder, symlinks=True)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "base.pth").write_text("\n".join(one for one in sys.path if one), "utf-8")
    classes = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    (packages / "my_surrogates.py").write_text("\n\n".join(classes), "utf-8")
    return folder / "bin" / "python"


def answer(python: Path, root: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-m", "studies", *words]
    return subprocess.run(command, cwd=root, env={**os.environ}, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Ridge", "Net"])
def test_a_class_of_the_page_is_tuned_calibrated_with_and_made_again(
    name: str, python: Path, tmp_path: Path
) -> None:
    if name == "Ridge":
        pytest.importorskip("sklearn")
    give_store(tmp_path)
    profile = PROFILE
    changes = {**SMALL, "max_calls = 100": "max_calls = 12", ":Ridge": f":{name}"}
    if name == "Net":
        changes |= {"alpha = ": "learning_rate = ", "n_components = 20": "epochs = 50"}
        profile = re.sub(r"^gamma.*\n", "", profile, flags=re.M)
    for old, new in changes.items():
        assert old in profile
        profile = profile.replace(old, new)
    (tmp_path / "own.toml").write_text(profile, "utf-8")
    tuned = answer(python, tmp_path, "tune", "wall", "--profile", "own.toml", "--json")
    assert tuned.returncode == 0, tuned.stderr
    (size,) = json.loads(tuned.stdout)["stages"][-1]["result"]["studies"]
    assert size["surrogate"] == f"my_surrogates:{name}"
    assert size["n_complete"] == 2
    assert size["model_uri"] == "models:/wall-own-n0016/1"
    paper = ("calibrate", "wall", "--method", "paper", "--profile", "own.toml", "--json")
    calibrated = answer(python, tmp_path, *paper)
    assert calibrated.returncode == 0, calibrated.stderr
    result = json.loads(calibrated.stdout)["stages"][-1]["result"]
    assert result["mse"] < result["screening"]["mse"]
    again = answer(python, tmp_path, "reproduce", size["run_id"], "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["equal"]


def test_a_profile_names_a_class_and_its_keywords(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(PROFILE, "utf-8")
    tuning = load_profile(str(file)).tuning
    assert tuning.surrogate == "my_surrogates:Ridge"
    assert list(tuning.space) == ["alpha", "gamma"]
    config = OwnConfig(tuning.surrogate).replace(gamma=0.1, alpha=1.0)
    assert config == OwnConfig(tuning.surrogate).replace(alpha=1.0, gamma=0.1)
    assert (config.alpha, config.gamma) == (1.0, 0.1)
    with pytest.raises(AttributeError):
        config.beta  # noqa: B018


@pytest.mark.parametrize(
    ("name", "said"),
    [("no_such:Class", "no package 'no_such' is installed"), ("a b:C", "is no module:Class")],
)
def test_a_class_that_is_not_installed_is_refused(name: str, said: str) -> None:
    with pytest.raises(InputError, match=f"^tuning.surrogate: .*{said}"):
        own_class(name)
