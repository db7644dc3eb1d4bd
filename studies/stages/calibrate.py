"""The stage that calibrates: it needs a champion's folder alone, or its copy in the registry."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulation.errors import InputError
from simulation.whole_file import whole_file
from studies.console import Column
from studies.paths import size_name
from studies.physical_model import open_physical_model
from studies.recipe import Recipe, recipe_of
from studies.report.wording import difference_unit, squared
from studies.stages.knowledge import prior_inputs, prior_numbers, prior_of
from studies.stages.pipeline import Outcome, Study, Summary, digest_of, run_stage, write_json
from studies.stages.results import StoredCalibration, calibration_files, read_arrays
from studies.stages.simulate import datasets_of, say_reused
from studies.stages.tracking import log_calibration, tracker_of
from studies.stages.validation import show_validation, validate_calibration, validation_inputs
from studies.tracking.origin import environment
from studies.tuning.champion import (
    CHAMPION_FILE,
    ChampionInfo,
    load_champion,
    read_champion,
    restore_champion,
)

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate

PHASES = {"screen": "screen, surrogate evaluations", "polish": "polish, FMU calls"}


def sizes_with_champion(study: Study, asked: Sequence[int] | None) -> tuple[int, ...]:
    """Return the training-set sizes to calibrate with.

    A champion whose folder is missing is brought back from the registry.

    Args:
        study: the study.
        asked: the sizes the user named, None for all that have a surrogate of this case.

    Raises:
        InputError: an asked size has no surrogate, or there is none at all.
    """
    for n_train in asked or study.profile.data.n_train:
        _restore(study, n_train)
    folders = study.paths.champions(study.label).glob("n[0-9]*")
    there = sorted(int(folder.name[1:]) for folder in folders if (folder / CHAMPION_FILE).is_file())
    if asked:
        missing = [n_train for n_train in asked if n_train not in there]
        if missing:
            known = f"there are {', '.join(map(str, there))}" if there else "there is none yet"
            raise InputError(
                f"no surrogate of {study.label} for n_train = {missing[0]}, {known}; "
                f"type: studies tune {study.command} --n-train {missing[0]}"
            )
        return tuple(sorted(set(asked)))
    usable = [n_train for n_train in there if _is_usable(study, n_train)]
    if not usable:
        raise InputError(f"{study.label} has no surrogate yet; type: studies tune {study.command}")
    return tuple(usable)


def calibrate_stage(study: Study, n_train: int, *, again: bool = False) -> Outcome:
    """Calibrate with the stored surrogate of one training-set size.

    Args:
        study: the study.
        n_train: training-set size.
        again: calibrate though it is finished.
    """
    champion = read_champion(study.paths.champion(study.label, n_train), case_digest=study.case.digest)
    profile = study.profile
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        "is_log": study.case.parameter_space.is_log.tolist(),
        "champion": champion.files_sha256,
        "screening": asdict(profile.screening),
        "polish": asdict(profile.polish),
        "n_validation": profile.data.n_validation,
        "n_test": profile.data.n_test,
        "seed": profile.seed,
        **validation_inputs(study.case),
        **prior_inputs(study.case),
    }
    files = calibration_files(study, n_train)
    stage = f"calibrate-{size_name(n_train)}"

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        # On the CPU wherever it was trained: the same numbers on every machine of a kind.
        surrogate, _ = load_champion(
            study.paths.champion(study.label, n_train), case_digest=study.case.digest, device="cpu"
        )
        numbers, arrays, wall = calibrate(study, surrogate, n_train)
        numbers = _head(study, champion) | numbers
        numbers |= {"recipe": _recipe(study, champion), "environment": environment()}
        write_arrays(files.arrays, arrays)
        write_json(files.numbers, numbers)
        wall_s = time.time() - started_s
        stored = StoredCalibration(files, numbers, arrays, wall_s)
        log_calibration(study, stored, digest_of(inputs), started_s=started_s, wall_s=wall_s)
        left_out = ("recipe", "environment")
        kept = {k: v for k, v in numbers.items() if not k.endswith("_history") and k not in left_out}
        return {**kept, "file": study.paths.show(files.numbers), "wall": wall}, [files.numbers, files.arrays]

    if again:
        (study.results / f"{stage}.json").unlink(missing_ok=True)
    return run_stage(
        study,
        stage,
        what="differential evolution on the surrogate, then LS-TRF on the FMU",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"final MSE {summary['mse_polished']:.5f}",
    )


def calibrate(
    study: Study, surrogate: "Surrogate", n_train: int
) -> tuple[dict[str, Any], dict[str, Any], dict[str, float]]:
    """Calibrate and keep nothing but the simulations.

    Args:
        study: the study.
        surrogate: what the box is screened with.
        n_train: size of its training set.

    Returns:
        The numbers, the arrays and the wall times.
    """
    from studies.calibration.polish import LeastSquaresTRF
    from studies.calibration.screen import DifferentialEvolution
    from studies.calibration.two_phase import calibrate_two_phase
    from studies.surrogate_model import SurrogateModel

    measurement, profile = study.case.measurement, study.profile
    with open_physical_model(study) as physical, study.console.bars() as bars:
        result = calibrate_two_phase(
            SurrogateModel(
                surrogate,
                study.case.parameter_space,
                measurement.output_names,
                measurement.time,
                n_jobs=study.n_jobs,
            ),
            physical,
            measurement,
            screening=DifferentialEvolution(**asdict(profile.screening)),
            polishing=LeastSquaresTRF(max_calls=profile.polish.max_calls, ftol=profile.polish.ftol),
            seed=profile.seed,
            n_train=n_train,
            n_validation=profile.data.n_validation,
            n_test=profile.data.n_test,
            prior=prior_of(study.case),
            on_progress=lambda now: bars(PHASES[now.phase], now.n_done, now.n_total or now.n_done),
        )
    say_reused(study, f"calibrate-{size_name(n_train)}", physical)
    validated, simulated = validate_calibration(
        study, {"screened": result.theta_screened, "polished": result.theta}
    )
    numbers = result.to_dict() | validated | prior_numbers(study.case, result.theta)
    wall = {name: numbers.pop(name) for name in list(numbers) if name.startswith("wall")}
    arrays = {
        "time": measurement.time,
        "measured": measurement.y,
        "theta": result.theta,
        "theta_screened": result.theta_screened,
        "y_surrogate": result.y_surrogate,
        "y_screened": result.y_screened,
        "y_polished": result.y_polished,
        "history_calls": result.polish_history.n_calls,
        "history_mse": result.polish_history.best_mse,
        **simulated,
    }
    return numbers, arrays, wall


def _head(study: Study, champion: ChampionInfo) -> dict[str, Any]:
    """Return what a calibration's numbers belong to."""
    return {
        "label": study.label,
        "note": study.case.note,
        "case_sha256": study.case.digest,
        "measurement_sha256": study.case.measurement.digest,
        "n_train": champion.n_train,
        "surrogate_errors": champion.metrics,
        "surrogate": {"study": champion.study, "trial": champion.index, "sha256": champion.files_sha256},
    }


def _recipe(study: Study, champion: ChampionInfo) -> Recipe:
    """Return what rebuilds a calibration, its surrogate included."""
    return recipe_of(
        study,
        "calibration",
        command="studies calibrate",
        n_train=champion.n_train,
        datasets=datasets_of(study.profile, champion.n_train, champion.digests),
        surrogate={
            "study": champion.study,
            "trial": champion.index,
            "config": champion.config,
            "seed": champion.seed,
            "digests": champion.digests,
            "files_sha256": champion.files_sha256,
        },
    )


def _restore(study: Study, n_train: int) -> None:
    folder = study.paths.champion(study.label, n_train)
    has_tracking = study.paths.storage is not None or study.paths.tracking_database.is_file()
    if (folder / CHAMPION_FILE).is_file() or not has_tracking:
        return
    restore_champion(
        folder, lambda scratch: tracker_of(study.paths).fetch_champion(study.label, n_train, scratch)
    )


def _is_usable(study: Study, n_train: int) -> bool:
    try:
        read_champion(study.paths.champion(study.label, n_train), case_digest=study.case.digest)
    except InputError as error:
        study.console.warn(f"n_train = {n_train} is left out: {error}")
        return False
    return True


def show_calibrations(study: Study, outcomes: list[Outcome], target: float | None) -> None:
    """Print one row per training-set size, as the paper's Table 4, and what it cost."""
    titles = ["n_train", "MAE val", "MAE test", "MSE surrogate", "MSE screened", "gap"]
    titles += ["polish calls", "final MSE", "calls (paper)", "calls (all)"]
    columns = [Column(title, True) for title in titles]
    if target is not None:
        columns.append(Column(f"calls to {target:g}", True))
    rows = []
    for outcome in outcomes:
        found = outcome.summary
        errors, ledger = found["surrogate_errors"], found["ledger"]
        row = [
            found["n_train"],
            f"{errors['val/mae']:.3f}",
            f"{errors['test/mae']:.3f}",
            _mse(found["mse_surrogate"]),
            _mse(found["mse_screened"]),
            _mse(found["screening_gap"]),
            ledger["n_polish"],
            _mse(found["mse_polished"]),
            ledger["total_paper"],
            ledger["total_honest"],
        ]
        if target is not None:
            row.append(calls_to(study, found["n_train"], target) or "not reached")
        rows.append(row)
    unit = difference_unit(study.case.outputs[0].unit)
    units = f"MAE of the surrogate in {unit}; MSE in {squared(unit)}; " if unit else ""
    study.console.table(
        f"{study.label}: calibration ({units}MSE screened and final by the FMU)", columns, rows
    )
    show_validation(study, outcomes)
    if study.case.note:
        study.console.result(f"Note: {study.case.note}")


def calls_to(study: Study, n_train: int, target: float) -> int | None:
    """Return the calls (training, screening check, polish) after which the error was at most the target."""
    from studies.calibration import History

    arrays = read_arrays(calibration_files(study, n_train).arrays)
    return History(arrays["history_calls"], arrays["history_mse"]).calls_to(target)


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file in one step."""
    with whole_file(file) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(a) for name, a in arrays.items()})


def _mse(value: float | None) -> str:
    return "failed" if value is None else f"{value:.4f}"
