import pytest
from fmpy.fmi2 import FMU2Model
from white_box_for_tests import CAMPAIGN, WhiteBox, is_installed


@pytest.fixture
def generator(monkeypatch):
    """The generator's module, imported as the command line would."""
    if not is_installed("pvlib"):
        pytest.skip("pvlib is not installed: pip install -e '.[modelica]'")
    monkeypatch.syspath_prepend(str(CAMPAIGN))
    import generate

    return generate


@pytest.fixture
def exchange(tmp_path):
    box = WhiteBox(tmp_path / "exchange", FMU2Model)
    yield box
    box.fmu.freeInstance()
