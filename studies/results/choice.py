"""What comparing model structures comes to."""

from dataclasses import dataclass

from studies.calibration.uncertainty.noise import Noise
from studies.results.saved import Error


@dataclass(frozen=True)
class Structure:
    """A model structure and what speaks for it.

    Attributes:
        case: Name of its case.
        label: Label of its calibration.
        n_parameters: Parameters that were calibrated.
        determined: Those that the data determine.
        mse: Error of its calibration. [first output's unit squared]
        aic: Akaike's information criterion, but for a constant that all structures have. [1]
        bic: The Bayesian one, with the samples that count as independent. [1]
        log_evidence: Logarithm of the evidence over bounds and priors, but for such a constant. [1]
        log_evidence_error: Difference of two estimates of it, of half the particles each. [1]
        probability: Of this structure among all that were compared, equally probable before. [1]
        left_out_mse: Error on blocks that a calibration did not see. [first output's unit squared]
        left_out: The same of each block. Length b. [first output's unit squared]
        white: Probability of residuals as correlated as its own if they were white. [1]
        larger: The smallest structure that has all its parameters and more; "" for none.
        ratio_p: Probability of a likelihood ratio as large as that of the two if this one were right;
            None without a larger one. [1]
        n_calls: Simulations of its calibration.
        n_judged: Simulations that its judgement took.
        by_equations: Whether state equations gave what is not simulated; else a Gaussian process.
    """

    case: str
    label: str
    n_parameters: int
    determined: tuple[str, ...]
    mse: Error
    aic: float
    bic: float
    log_evidence: float
    log_evidence_error: float
    probability: float
    left_out_mse: float
    left_out: tuple[float, ...]
    white: float
    larger: str
    ratio_p: float | None
    n_calls: int
    n_judged: int
    by_equations: bool


@dataclass(frozen=True)
class Choice:
    """Model structures compared on one measurement.

    Attributes:
        structures: In the order in which they were named.
        chosen: Name of the case that the data choose; "" where they do not decide.
        reason: Why, in words.
        noise: What the residuals of all are taken for: those of the structure of least error.
        noise_of: Name of the case of that structure.
        blocks: What was left out in turn, in words.
        is_explained: Whether the residuals of the most probable structure may be white noise.
    """

    structures: tuple[Structure, ...]
    chosen: str
    reason: str
    noise: Noise
    noise_of: str
    blocks: str
    is_explained: bool
