import importlib.util
import shutil
import sys

import pytest
from fmu_for_tests import OFFICE, REPOSITORY, Driver

# The compiler is a tool of the repository, not of the installed packages.
sys.path.insert(0, str(REPOSITORY))


@pytest.fixture(scope="session")
def compiler():
    """The compiler, or a skip that says what it lacks."""
    for module in ("casadi", "pymoca"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed: pip install -e '.[modelica]'")
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    from fmus.compiler import package

    return package


@pytest.fixture
def office(tmp_path):
    driver = Driver(OFFICE, tmp_path / "office")
    yield driver
    driver.close()


@pytest.fixture
def build(compiler, tmp_path):
    """Compile a Modelica text; the settings are lines of a build file."""

    def compile_text(source, settings, folder="model"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "M.mo").write_text(source)
        (tmp_path / folder / "build.toml").write_text(settings)
        return compiler.build_fmu(tmp_path / folder)

    return compile_text
