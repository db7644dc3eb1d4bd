"""The stage that simulates a calibrated model with other inputs, with the bands of its uncertainty."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from simulation.arrays import FloatArray
from simulation.case import of_experiment
from simulation.errors import MachineError
from simulation.foreign_text import not_a_formula
from simulation.other_inputs import settings_with_inputs
from simulation.whole_file import whole_file
from studies.calibration.uncertainty.bands import bands_of, noise_of_outputs
from studies.physical_model import open_physical_model
from studies.reporting.drawing import write_picture
from studies.reporting.figures_calibration import prediction_figure
from studies.results.outcome import Outcome
from studies.results.stage_results import Calibration, Prediction, Uncertainty
from studies.simulation_time import duration
from studies.stages.finished import stored_uncertainties
from studies.stages.knowledge import case_inputs
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_prediction
from studies.task import StageError, Task
from studies.words.wording import count


def predict_stage(
    task: Task, calibration: Outcome[Calibration], recording: Path | None, experiment: str | None = None
) -> Outcome[Prediction]:
    """Simulate a calibrated model with other inputs; the bands need a finished `studies uncertainty`.

    Args:
        task: The study.
        calibration: The calibration.
        recording: A CSV file with every column that drives an input of the case; None for the recording of
            an experiment.
        experiment: Name of an experiment of the case; None where it has none.

    Raises:
        InputError: The recording does not fit the case.
        StageError: The calibrated parameters cannot be simulated with it.
    """
    single, columns = of_experiment(task.case, experiment, needed_for="predict")
    settings = single.settings if recording is None else settings_with_inputs(single, recording)
    case = replace(single, settings=settings, scenario=settings.scenario)
    known = {one.result.calibration: one.result for one in stored_uncertainties(task)}.get(calibration.name)
    theta = calibration.result.point[None]
    if known is not None:
        theta = np.concatenate([theta, known.sample_theta])
    theta = np.ascontiguousarray(theta[:, columns])
    inputs = {
        **case_inputs(task.case),
        "model": case.model_digest,
        "theta": theta.tolist(),
        "noise": None if known is None else vars(known.noise),
    }
    source = f"experiment {experiment}" if recording is None else recording.name
    named = "-".join(filter(None, (experiment, None if recording is None else recording.stem)))
    place = re.sub(r"[^\w.-]", "_", named)[:100]
    if recording is not None:
        # Recordings of one name differ in what they hold.
        place += f"-{case.model_digest[:8]}"
    what = f"{count(len(theta), 'simulation')} with {source}{duration(task, len(theta))}"
    stage = Stage(task, f"predict-{calibration.name}-{place}", what, inputs, Prediction)
    table, picture = (stage.file.with_suffix(ending) for ending in (".csv", ".png"))

    def predict() -> Prediction:
        with open_physical_model(task, case=case) as model:
            y = model.simulate(theta).y
        if not np.isfinite(y[0]).all():
            raise StageError(f"the calibrated parameters cannot be simulated with {source}")
        found = Prediction(
            calibration=calibration.name,
            inputs=task.paths.recorded(case.path if recording is None else recording),
            table=task.paths.recorded(table),
            output_names=tuple(output.name for output in case.outputs),
            output_units=tuple(output.unit for output in case.outputs),
            level=None,
            n_sample=0,
            n_failed=0,
            time=settings.scenario.time,
            y=y[0],
        )
        if known is not None:
            # A deviation is that of the first output of all.
            share = case.measurement.uncertainty[0] / task.case.measurement.uncertainty[0]
            noise = share * noise_of_outputs(known.noise, case.measurement)
            found = _with_bands(noise, found, known, y[1:])
        with whole_file(table) as stream:
            columns = {not_a_formula(name): values for name, values in found.columns()}
            stream.write(pd.DataFrame(columns).to_csv(index=False).encode())
        figure = prediction_figure(found, None if recording is not None else case.measurement)
        try:
            write_picture(figure, picture, footnote=f"{task.label}, {source}")
        except MachineError as error:
            task.console.warn(f"{picture.name}: {error}; the table is complete without it")
        return found

    return stage.once(predict, files=[table], log=log_prediction)


def _with_bands(noise: FloatArray, found: Prediction, known: Uncertainty, y: FloatArray) -> Prediction:
    """Add the bands of a posterior sample, y (n, t, k)."""
    good = np.isfinite(y).all(axis=(1, 2))
    weights = known.weights[good]
    if not weights.sum() > 0.0:
        raise StageError("no simulation of the posterior sample succeeded with these inputs")
    bands = bands_of(y[good], weights / weights.sum(), noise, known.level)
    return replace(
        found,
        level=known.level,
        n_sample=len(y),
        n_failed=int(np.count_nonzero(~good)),
        simulated=bands.simulated,
        predictive=bands.predictive,
    )
