"""Calibrating the most relevant parameters alone: which they are, and what the others are held at."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from studies.partly_fixed import PartlyFixedModel
from studies.physical_model import open_physical_model
from studies.recipe import file_digest
from studies.report.restricted import condition_sentence
from studies.report.wording import count
from studies.stages.knowledge import prior_of
from studies.stages.pipeline import Study, digest_of, read_json

if TYPE_CHECKING:
    from studies.calibration.adaptive import Adaptive

N_TRAJECTORIES = 4
"""Of Morris' method: each costs a simulation per parameter and one more."""


@dataclass(frozen=True)
class Restriction:
    """Which parameters are held at what, and how that was chosen.

    Attributes:
        n_free: Parameters that are calibrated.
        fixed: Values of the others by name. [per parameter]
        why: Where each of these comes from, in words.
        shares: Each parameter's share in what varies; None where it is not known. [1]
        source: "Sobol" or "Morris".
        n_calls: Rows asked of the model for this calibration to find that out.
        n_calls_before: Rows that the stored Sobol indices had cost before.
    """

    n_free: int
    fixed: Mapping[str, float]
    why: Mapping[str, str]
    shares: Mapping[str, float | None]
    source: str
    n_calls: int
    n_calls_before: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain values; `Restriction(**values)` is the same again."""
        return asdict(self)


def restriction_of(told: Mapping[str, Any]) -> Restriction | None:
    """Return the restriction that a calibration's numbers or a recipe tell of, None for none."""
    if "restriction" not in told:
        return None
    return Restriction(**{one.name: told["restriction"][one.name] for one in fields(Restriction)})


def recipe_part(restriction: Restriction | None) -> dict[str, Any]:
    """Return what a recipe says of a restriction; empty without one."""
    return {} if restriction is None else {"restriction": restriction.to_dict()}


def held_numbers(case: Case, restriction: Restriction | None) -> dict[str, Any]:
    """Return on what fixed values the numbers of free parameters rest; empty without a restriction."""
    if restriction is None:
        return {}
    # MLflow's copy of a recipe has names by the alphabet: words follow the case.
    units = {p.name: p.unit for p in case.parameter_space.parameters if p.name in restriction.fixed}
    fixed = {name: restriction.fixed[name] for name in units}
    why = {name: restriction.why[name] for name in units}
    in_words = condition_sentence(fixed, why, units)
    return {"restriction": {"n_free": restriction.n_free, "fixed": fixed, "why": why, "in_words": in_words}}


def checked_size(case: Case, n_free: int) -> int:
    """Return how many parameters are to be calibrated.

    Raises:
        InputError: Nothing would be fixed.
    """
    p = case.parameter_space.n_parameters
    if n_free >= p:
        raise InputError(
            f"--most-relevant {n_free} fixes nothing, {case.name} has {count(p, 'parameter')}; give at most "
            f"{p - 1}, or leave it away"
        )
    return n_free


def calls_for_relevance(study: Study) -> int:
    """Return the rows that finding out the relevance will be counted with: none where Sobol indices lie."""
    return 0 if _sobol_digest(study) else N_TRAJECTORIES * (study.case.parameter_space.n_parameters + 1)


def calls_for_check(case: Case, settings: "Adaptive", restriction: Restriction | None) -> int:
    """Return the rows that are kept back for a check of what the fixing cost: none where few are left."""
    if restriction is None:
        return 0
    n_check = case.parameter_space.n_parameters + 1
    n_left = settings.max_calls - restriction.n_calls - n_check
    return n_check if n_left >= 2 * settings.design_size(restriction.n_free) else 0


def told_kept(converged: bool, max_calls: int, n_kept: int) -> str:
    """Say where the rest of a spent budget went; "" where it is not spent or went nowhere else."""
    if converged or not n_kept:
        return ""
    return f" (of {count(max_calls, 'call')}, {n_kept} are for finding and checking what is relevant)"


def restriction_inputs(study: Study, n_free: int | None) -> dict[str, Any]:
    """Return what a restricted calibration depends on beyond the case; empty without a restriction."""
    if n_free is None:
        return {}
    held = {name: value for name, (value, _) in held_at(study.case.parameter_space).items()}
    known = _sobol_digest(study) or digest_of({"n_trajectories": N_TRAJECTORIES})
    return {"restriction": {"n_free": n_free, "relevance": known, "held_at": held}}


def held_at(space: ParameterSpace) -> dict[str, tuple[float, str]]:
    """Return what each parameter is held at where it is fixed, and where that comes from."""
    held = {}
    for parameter, expected in zip(space.parameters, space.expected.tolist(), strict=True):
        if parameter.prior is not None:
            held[parameter.name] = parameter.prior.centre, "its prior"
        else:
            held[parameter.name] = (
                expected,
                "the middle of its bounds" if parameter.estimate is None else "its estimate",
            )
    return held


def find_restriction(study: Study, n_free: int) -> Restriction:
    """Find the most relevant parameters, by stored Sobol indices or else by Morris' method on the FMU.

    Args:
        study: the study.
        n_free: how many are calibrated.
    """
    from studies.calibration.problem import CalibrationProblem
    from studies.relevance import morris_relevance, sobol_relevance
    from studies.sensitivity import SobolIndices

    case, say = study.case, study.console.say
    if _sobol_digest(study):
        indices = SobolIndices.load(study.results / "sensitivity.npz")
        say(f"relevance: by the stored Sobol indices, {count(indices.n_calls, 'call')} before, not counted")
        found, n_calls, n_before = sobol_relevance(indices, case.measurement), 0, indices.n_calls
    else:
        n_asked = count(calls_for_relevance(study), "call")
        say(f"relevance: by Morris' elementary effects, {n_asked}, counted")
        with open_physical_model(study) as physical:
            problem = CalibrationProblem(physical, case.measurement)
            found = morris_relevance(problem, n_trajectories=N_TRAJECTORIES, seed=study.profile.seed)
        n_calls, n_before = found.n_calls, 0
    free = found.most(n_free)
    held = {name: one for name, one in held_at(case.parameter_space).items() if name not in free}
    return Restriction(
        n_free=n_free,
        fixed={name: value for name, (value, _) in held.items()},
        why={name: why for name, (_, why) in held.items()},
        shares={
            name: float(share) if np.isfinite(share) else None
            for name, share in zip(found.names, found.shares, strict=True)
        },
        source=found.source,
        n_calls=n_calls,
        n_calls_before=n_before,
    )


def restriction_numbers(
    study: Study, restriction: Restriction | None, theta: FloatArray, *, n_calls_left: int
) -> tuple[dict[str, Any], int]:
    """Return what a restricted calibration's numbers say of it, and the rows that its check asked.

    Args:
        study: the study.
        restriction: the restriction, None for none.
        theta: the calibrated point. Shape (p,). [per parameter]
        n_calls_left: rows that the budget still holds for a check of what the fixing cost.
    """
    if restriction is None:
        return {}, 0
    from studies.calibration.freeing import freeing
    from studies.calibration.problem import CalibrationProblem

    space = study.case.parameter_space
    check: dict[str, Any] | None = None
    if n_calls_left > space.n_parameters:
        is_free = np.array([name not in restriction.fixed for name in space.names])
        with open_physical_model(study) as physical:
            problem = CalibrationProblem(physical, study.case.measurement, prior_of(study.case))
            found = freeing(problem, space.to_unit(theta), is_free)
        alone = dict(zip(space.names, map(_known, found.gain_alone), strict=True))
        check = {
            "gain": _known(found.gain),
            "gain_alone": {name: alone[name] for name in restriction.fixed},
            "n_calls": found.n_calls,
        }
    content = {**restriction.to_dict(), "check": check}
    return {"restriction": content}, 0 if check is None else check["n_calls"]


def _known(gain: float) -> float | None:
    return float(gain) if np.isfinite(gain) else None


def free_space(case: Case, restriction: Restriction | None) -> ParameterSpace:
    """Return the free parameters: all of them without a restriction."""
    return case.parameter_space.without(() if restriction is None else restriction.fixed)


def parts_of(model: ForwardModel, restriction: Restriction | None) -> PartlyFixedModel:
    """Return a model that is asked the free parameters alone: all of them without a restriction."""
    return PartlyFixedModel(model, restriction.fixed if restriction is not None else {})


def _sobol_digest(study: Study) -> str:
    """Return the digest of stored Sobol indices of this case, "" where there are none.

    It is that of the indices themselves: done again, the same settings may come to others.
    """
    manifest, file = read_json(study.results / "sensitivity.json"), study.results / "sensitivity.npz"
    if manifest is None or manifest["inputs"]["case"] != study.case.digest or not file.is_file():
        return ""
    return file_digest(file)
