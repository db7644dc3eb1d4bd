"""The model of a case driven by another recording of its inputs, without any measurement."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from simulation.case import Case
from simulation.case_data import on_one_axis, read_columns
from simulation.case_meters import inputs_as_means
from simulation.case_parts import conversions, input_values
from simulation.case_periods import MOST_STEPS
from simulation.case_reading import read_experiments
from simulation.errors import InputError
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario


def settings_with_inputs(case: Case, recording: Path) -> FmuSettings:
    """Return the settings of a case's model for the whole time of another recording of its inputs.

    The simulation starts with the first row, with the start values and the fixed values of the case. Times in
    seconds are the model's own, unless the case has `zero = "first"`. Timestamps count from the case's
    `zero`, or from the first row.

    Args:
        case: The case.
        recording: A CSV file with every column that drives an input of the case, or a folder with files of
            the names in the case file; the file of the first input sets the time.

    Raises:
        InputError: The case has no inputs, a column is missing, has gaps, or is shorter than an output step.
    """
    file = next(one.file for one in read_experiments(case.path) if one.name == case.experiment)
    if not file.inputs:
        raise InputError(
            f"{case.path}: the model has no [[inputs]]; there is nothing that {recording} drives"
        )
    recordings = read_columns(file, [], lambda name: recording / name if recording.is_dir() else recording)
    file, leading = inputs_as_means(file, case.fmu), file.inputs[0].file
    data = on_one_axis(file, recordings, leading)
    begin_s, end_s = data.recordings[leading].time[[0, -1]].tolist()
    step, every = case.communication_step_s, case.scenario.output_every
    n_outputs = int((end_s - begin_s) / case.output_step_s * (1.0 + 1e-9))
    if not 1 <= n_outputs <= MOST_STEPS // every:
        raise InputError(
            f"{recording}: has {n_outputs:,} output steps of {case.output_step_s:g} s; 1 to "
            f"{MOST_STEPS // every:,} can be simulated, so record longer or cut the file"
        )
    edges = begin_s + step * np.arange(n_outputs * every + 1, dtype=np.float64)
    changes = conversions(case.fmu, "input", file.inputs)
    inputs, at_edges = input_values(file, case.fmu, data, changes, edges)
    scenario = Scenario(edges, inputs, case.scenario.input_names, every, inputs_at_edges=at_edges)
    return replace(case.settings, scenario=scenario)
