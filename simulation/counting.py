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
        if budget is not None and budget < 0:
            raise ValueError(f"budget is {budget}; give a number of rows, at least 0")
        super().__init__(model)
        self.budget = budget
        self.n_calls = 0

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
            raise BudgetExceeded(self._why_no_more(n))
        self.n_calls += n
        return self._model.simulate(theta)

    def _why_no_more(self, n: int) -> str:
        """Return why so many rows do not fit into the budget; a search ends with this reason."""
        budget = self.budget or 0
        left = budget - self.n_calls
        if left:
            return f"the next step takes {n} calls and the budget of {budget} has only {left} left"
        return f"the budget of {budget} {'call' if budget == 1 else 'calls'} is spent"
