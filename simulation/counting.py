"""The one place where calls of a model are counted and limited."""

import numpy as np

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.trajectories import Trajectories


class BudgetExceeded(RuntimeError):  # noqa: N818 - the end of a budget is an event, not a mistake
    """A batch was refused because it would exceed the budget; none of its rows was simulated."""


class CountingModel(WrappedModel):
    """A model that counts the rows it is asked for and refuses to exceed a budget.

    Optimizers are never trusted to count: SciPy leaves finite differences out of `nfev`, for one.

    Attributes:
        budget: Most rows that may ever be asked for; None for no limit.
        n_calls: Rows asked for so far, failed ones included.
    """

    def __init__(self, model: ForwardModel, budget: int | None = None) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
            budget: Most rows that may ever be asked for; None for no limit.
        """
        super().__init__(model)
        self.budget = budget
        self.n_calls = 0

    def pay(self, n_rows: int) -> None:
        """Count rows that were asked in another way; a negative number gives them back."""
        self.n_calls += n_rows

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Count the rows and simulate them.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The wrapped model's answer.

        Raises:
            BudgetExceeded: If the rows would exceed the budget; nothing is simulated or counted then.
        """
        n = len(np.asarray(theta))
        if self.budget is not None and self.n_calls + n > self.budget:
            left = self.budget - self.n_calls
            # A search ends with this reason.
            raise BudgetExceeded(
                f"the next step takes {n} calls and the budget of {self.budget} has only {left} left"
                if left
                else f"the budget of {self.budget} {'call' if self.budget == 1 else 'calls'} is spent"
            )
        self.n_calls += n
        return self._model.simulate(theta)
