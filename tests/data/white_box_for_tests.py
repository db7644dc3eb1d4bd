"""Where the campaign lies, and the plainest way through the white-box FMU's functions."""

import importlib.util
from ctypes import c_double
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model

REPOSITORY = Path(__file__).parents[2]
CAMPAIGN = REPOSITORY / "data" / "office"
WHITE_BOX = REPOSITORY / "fmus" / "office-whitebox" / "WhiteBoxOffice.fmu"


def is_installed(module):
    return importlib.util.find_spec(module) is not None


class WhiteBox:
    """The white-box FMU through its own functions, for co-simulation or model exchange."""

    def __init__(self, folder, kind):
        self.description = read_model_description(str(WHITE_BOX))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.states = [d.variable.derivative.name for d in self.description.derivatives]
        extract(str(WHITE_BOX), unzipdir=str(folder))
        self.fmu = kind(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier="WhiteBoxOffice",
            instanceName="test",
        )
        self.fmu.instantiate()

    def initialize(self, **values):
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(**values)
        self.fmu.exitInitializationMode()
        if isinstance(self.fmu, FMU2Model):
            self.fmu.newDiscreteStates()
            self.fmu.enterContinuousTimeMode()

    def set(self, **values):
        self.fmu.setReal([self.references[name] for name in values], [float(v) for v in values.values()])

    def get(self, name):
        return self.fmu.getReal([self.references[name]])[0]

    def derivatives(self, states):
        n = len(self.states)
        self.fmu.setContinuousStates((c_double * n)(*states), n)
        out = (c_double * n)()
        self.fmu.getDerivatives(out, n)
        return list(out)
