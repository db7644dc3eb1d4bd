"""What cannot be simulated fails where it is set, with a message, and harms no later run."""

import math

import pytest
from fmpy.fmi1 import FMICallException

WRONG = [
    *((name, math.nan) for name in ("b", "UWin", "TTABSInit", "TAirInit")),
    *((name, math.inf) for name in ("cInt", "TWallInit")),
    *((name, 0.0) for name in ("b", "cInt", "cExt1", "cTABS", "rInt", "rExt1", "rExt2", "rZone", "rPipe")),
    *((name, -1.0) for name in ("b", "cInt", "cExt1", "cTABS", "rInt", "rExt1", "rExt2", "rZone", "rPipe")),
    *((name, -1.0) for name in ("UWin", "VSUP", "TTABSInit", "TAirInit")),
    ("TAmb", math.nan),
    ("occ", math.inf),
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_a_wrong_value_ends_the_initialization(office, name, value):
    with pytest.raises(FMICallException, match="fmi2ExitInitializationMode"):
        office.initialize(**{name: value})
    assert len(office.messages) == 1
    assert "check the parameters" in office.messages[0] or f"{name} = " in office.messages[0]


def test_after_a_failure_a_reset_instance_is_as_new(office):
    office.initialize()
    office.fmu.doStep(0.0, 600.0)
    expected = office.get("TAir")
    with pytest.raises(FMICallException):
        office.initialize(cInt=0.0)
    with pytest.raises(FMICallException, match="fmi2DoStep"):
        office.fmu.doStep(0.0, 600.0)
    office.initialize()
    office.fmu.doStep(0.0, 600.0)
    assert office.get("TAir") == expected
