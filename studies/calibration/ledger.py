"""The ledger: every row that a calibration asked of the physical model."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Ledger:
    """Rows asked of the physical model, by purpose. [1].

    Attributes:
        n_train: Training set of the surrogate.
        n_validation: Validation set.
        n_test: Test set.
        n_screen_checks: Physical simulations of screened points.
        n_polish: Polishing.
        n_adaptive: An adaptive calibration, which has none of the above. What it simulates in one of k
            experiments alone counts as the k-th part of a row.
    """

    n_train: int = 0
    n_validation: int = 0
    n_test: int = 0
    n_screen_checks: int = 0
    n_polish: int = 0
    n_adaptive: int = 0

    @property
    def total_paper(self) -> int:
        """The paper's count: all that found the parameters, without validation and test sets."""
        return self.n_train + self.n_screen_checks + self.n_polish + self.n_adaptive

    @property
    def total_calls(self) -> int:
        """All that surrogate and calibration asked of the physical model; the doctor and Sobol ask apart."""
        return self.total_paper + self.n_validation + self.n_test

    def to_dict(self) -> dict[str, int]:
        """Return the counts and both totals."""
        return asdict(self) | {"total_paper": self.total_paper, "total_calls": self.total_calls}
