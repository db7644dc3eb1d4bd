"""The plainest way through an FMU's functions: one call after the other, by FMPy."""

from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

REPOSITORY = Path(__file__).parents[2]
OFFICE = REPOSITORY / "fmus" / "office" / "Office.fmu"
STOP_S = 1e9


class Driver:
    """An instance of an FMU, unpacked in a folder that the caller removes."""

    def __init__(self, fmu, folder, kind="co-simulation"):
        self.description = read_model_description(str(fmu))
        self.messages = []
        self.folder = extract(str(fmu), unzipdir=str(folder))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        interface = self.description.coSimulation or self.description.modelExchange
        make = FMU2Slave if kind == "co-simulation" else FMU2Model
        self.fmu = make(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=interface.modelIdentifier,
            instanceName="test",
        )
        self.fmu.instantiate(callbacks=_callbacks(self.messages))

    def refer(self, names):
        return [self.references[name] for name in names]

    def set(self, **values):
        self.fmu.setReal(self.refer(values), [float(value) for value in values.values()])

    def get(self, *names):
        return self.fmu.getReal(self.refer(names))

    def initialize(self, **values):
        self.fmu.reset()
        self.fmu.setupExperiment(startTime=0.0, stopTime=STOP_S)
        self.set(**values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def run(self, names, inputs, step, output):
        """Step with inputs held; the output before the first step and after each."""
        result = self.get(output)
        references = self.refer(names)
        for k, row in enumerate(inputs):
            self.fmu.setReal(references, [float(value) for value in row])
            self.fmu.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
            result += self.get(output)
        return result

    def close(self):
        self.fmu.freeInstance()


def _callbacks(messages):
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(
        lambda environment, name, status, category, message: messages.append(message.decode())
    )
    # Our FMUs allocate for themselves, as they declare.
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(lambda count, size: None)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(lambda memory: None)
    return callbacks
