"""Which elements a linear network has, and how its matrices are made of them.

The first elements are logarithms: of capacities, conductances and gains, or of decay rates and frequencies.
What a matrix holds are their exponentials and quotients, `rates`. The others enter as they are. A matrix is a
constant matrix times (1, rates, others), so that it is made by one product.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pelsvae.linear_network.drive import Array, Drive

# Outputs are scaled to this standard deviation: an office's, in K, for which all that follows was chosen.
SCALE = 3.0
# Logarithms of capacities (the outputs' and others'), conductances, and couplings to inputs before anything
# is known, and their standard deviations. [1]
CAPACITIES, CONDUCTANCE, COUPLING, SPREAD = (1.0, 3.0, 2.0, 4.0, 0.0), -1.0, -4.0, 2.5
# Standard deviations of a state at the start, and of the sum of powers of time.
START, UNITS = 10.0, 0.05
# Logarithm of what a sum multiplies states and inputs with.
SUMMED = -2.0
# Deviation of what enters as it is.
SIGNED = 1.0
# Logarithms beyond which a rate is limited, and the most rates in a step. Rounding.
MOST_LOG, MOST_IN_A_STEP = 25.0, 25.0


@dataclass(frozen=True, eq=False)
class Form:
    """Elements of a network and how they make its matrices; rates v, other elements g.

    Attributes:
        n_states: States s.
        mean: Elements before anything is known. Shape (q,).
        deviation: Their standard deviations. Shape (q,).
        makes: Which logarithms make that of a rate: 1 or -1. Shape (v, q - g).
        to_states: What makes A of each pattern. Shape (r * s * s, 1 + v + g).
        to_inputs: What makes B of each pattern. Shape (r * s * c, 1 + v + g).
        summed: Outputs that are sums of states and inputs, l of them; the others are the first states.
        to_outputs: What makes C and D of these. Shape (l * (s + c), 1 + v + g).
        powers: Sum of powers of time that units demand of an element, NaN where none. Shape (q,).
        most: Most logarithm of a rate.
    """

    n_states: int
    mean: Array
    deviation: Array
    makes: Array
    to_states: Array
    to_inputs: Array
    summed: tuple[int, ...]
    to_outputs: Array
    powers: Array
    most: float


class _Elements:
    """Collects elements and what they make."""

    def __init__(
        self, n_states: int, drive: Drive, n_inputs: int, n_patterns: int, summed: tuple[int, ...]
    ) -> None:
        self.shapes = {
            "a": (n_patterns, n_states, n_states),
            "b": (n_patterns, n_states, n_inputs),
            "c": (len(summed), n_states + n_inputs),
        }
        self.n_states, self.drive, self.summed = n_states, drive, summed
        self.means, self.powers = list[float](), list[float]()
        self.makes = list[dict[int, float]]()
        self.made = [self._nothing()]
        self.signed = list[dict[str, NDArray[np.float64]]]()

    def _nothing(self) -> dict[str, Array]:
        return {name: np.zeros(shape) for name, shape in self.shapes.items()}

    def logarithm(self, mean: float, power: float) -> int:
        self.means.append(mean)
        self.powers.append(power)
        return len(self.means) - 1

    def rate(self, parts: dict[int, float], on: Array, places: Sequence[tuple[str, int, int, float]]) -> None:
        """Add a rate made of elements, and where it goes: matrix, row, column, sign."""
        self.makes.append(parts)
        self.made.append(self._nothing())
        for matrix, i, j, sign in places:
            self.made[-1][matrix][..., i, j] += sign if matrix == "c" else sign * on

    def plain(self, matrix: str, i: int, j: int) -> None:
        """Add an element that is an entry of a matrix."""
        self.signed.append(self._nothing())
        self.signed[-1][matrix][..., i, j] = 1.0

    def form(self) -> Form:
        n_logs, n_plain = len(self.means), len(self.signed)
        makes = np.zeros((len(self.makes), n_logs))
        for row, parts in enumerate(self.makes):
            for element, sign in parts.items():
                makes[row, element] += sign
        whole = [*self.made, *self.signed]
        stacked = {name: np.array([one[name].ravel() for one in whole]).T.copy() for name in self.shapes}
        return Form(
            self.n_states,
            np.array([*self.means, *[0.0] * n_plain]),
            np.array([*[SPREAD] * n_logs, *[SIGNED] * n_plain]),
            makes,
            stacked["a"],
            stacked["b"],
            self.summed,
            stacked["c"],
            np.array([*self.powers, *[np.nan] * n_plain]),
            float(np.log(MOST_IN_A_STEP / self.drive.step)),
        )


def stores(drive: Drive, n_stores: int) -> Form:
    """Return a network of stores: C_i dx_i/dt = sum G_ij (x_j - x_i) + sum H_ik (p_k - x_i) + sum F_il q_l.

    Outputs in the first one's unit are the first states; others are sums of states and inputs. Inputs of B
    are the potentials, then the sources. A switch adds to a potential's conductance while it is on.

    Args:
        drive: What drives it.
        n_stores: States; at least one beside those that are outputs.
    """
    a, b = drive.potentials.shape[1], drive.sources.shape[1]
    alike = np.flatnonzero(drive.is_alike)
    s = max(n_stores, alike.size + 1)
    summed = tuple(np.flatnonzero(~drive.is_alike).tolist())
    found = _Elements(s, drive, a + b, len(drive.patterns), summed)
    on = np.ones(len(drive.patterns))
    for i in range(s):
        found.logarithm(CAPACITIES[min(i, len(CAPACITIES) - 1)], 0.0)
    for i in range(s):
        for j in range(i + 1, s):
            # What flows between two states moves both.
            one = found.logarithm(CONDUCTANCE, -1.0)
            for here, there in ((i, j), (j, i)):
                found.rate({one: 1.0, here: -1.0}, on, [("a", here, there, 1.0), ("a", here, here, -1.0)])
        for j in range(a):
            for switch in range(-1, drive.patterns.shape[1]):
                one = found.logarithm(COUPLING, -1.0)
                is_on = on if switch < 0 else drive.patterns[:, switch]
                found.rate({one: 1.0, i: -1.0}, is_on, [("a", i, i, -1.0), ("b", i, j, 1.0)])
        for j, powers_of_time in enumerate(drive.source_powers, a):
            # A heat flow in W has -3 powers of time: those of an input and its gain together.
            one = found.logarithm(COUPLING, -3.0 - powers_of_time)
            found.rate({one: 1.0, i: -1.0}, on, [("b", i, j, 1.0)])
    for output in range(len(summed)):
        for column in range(s + a + b):
            # A heat flow is a conductance times a difference: what it is a sum of has powers of parameters.
            # What is negative is the second one of two rates.
            for sign in (1.0, -1.0):
                found.rate({found.logarithm(SUMMED, np.nan): 1.0}, on, [("c", output, column, sign)])
    return found.form()


def modes(drive: Drive, n_modes: int) -> Form:
    """Return damped modes: pairs of states with A = [[-d, f], [-f, -d]], and any B, C, D.

    Any linear model whose eigenvalues differ has this form. Inputs of B are the potentials, the sources, the
    switches and a constant; the matrices are the same in all patterns.

    Args:
        drive: What drives them.
        n_modes: Pairs of states.
    """
    c = drive.potentials.shape[1] + drive.sources.shape[1] + drive.patterns.shape[1] + 1
    found, on = _Elements(2 * n_modes, drive, c, 1, tuple(range(drive.n_outputs))), np.ones(1)
    longest = drive.step * float(np.diff(drive.bounds).max())
    # From the whole length down to ten output steps, evenly in the logarithm.
    decays = -np.linspace(np.log(longest), np.log(5.0), n_modes + 2)[1:-1]
    for mode, decay in enumerate(decays):
        i, j = 2 * mode, 2 * mode + 1
        found.rate({found.logarithm(decay, np.nan): 1.0}, on, [("a", i, i, -1.0), ("a", j, j, -1.0)])
        found.rate({found.logarithm(decay, np.nan): 1.0}, on, [("a", i, j, 1.0), ("a", j, i, -1.0)])
    for i in range(2 * n_modes):
        for j in range(c):
            found.plain("b", i, j)
    for output in range(drive.n_outputs):
        for column in range(2 * n_modes + c):
            found.plain("c", output, column)
    return found.form()
