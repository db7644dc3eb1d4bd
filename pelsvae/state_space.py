"""The decoder that knows the inputs: theta and the code make a linear network, which the inputs drive.

Eq. 3 to 7 stay as they are. What is new is that the decoder's layers are replaced by a linear network of
states (`linear_network`), of which every element is

    e = e0 + W f(theta) + V z,

with f the logarithms of positive parameters. So capacities and conductances are constants times powers of the
parameters, and the code z adds what powers leave unexplained; V is zero before training. Juliane Aka's group
went the same way with neural differential equations (B-NODE: A and B linear in the latent parameters).
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pelsvae.config import SurrogateConfig
from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import SCALE, START, UNITS, Form, modes, stores
from pelsvae.linear_network.kernels import Ints
from pelsvae.linear_network.solver import Solver
from pelsvae.network import PelsVae
from pelsvae.standardize import Array, OutputStandardizer, ThetaStandardizer

# Spread of elements between trainings with different seeds, of the order of what is not known of them.
FIRST_DEVIATION, FIRST_POWER = 0.7, 0.02
# A standardized parameter over its half range, where it is spread evenly.
OVER_HALF_RANGE = 3.0**-0.5
# Logarithm of the code's variance before training, and size of the last layers: the code begins near zero.
FIRST_LOG_VARIANCE, FIRST_CODE = -4.0, 0.1


def scaled_outputs(y: NDArray[np.float64], drive: Drive) -> OutputStandardizer:
    """Return the scaling of outputs: one level and one unit for all in the first output's unit.

    Args:
        y: Training trajectories. Shape (n, t, k). [output's unit]
        drive: What drives the model.
    """
    n_times, n_columns = y.shape[1:]
    level, unit = np.zeros(n_columns), np.ones(n_columns)
    of_output = {int(c): j for row in drive.columns for j, c in enumerate(row)}
    groups: dict[int, list[int]] = {}
    for column in range(n_columns):
        output = of_output[column]
        groups.setdefault(-1 if drive.is_alike[output] else output, []).append(column)
    for columns in groups.values():
        values = y[:, :, columns]
        level[columns] = values.mean()
        unit[columns] = float(values.std()) / SCALE or 1.0
    return OutputStandardizer(np.tile(level, (n_times, 1)), unit)


class StateSpaceVae(PelsVae):
    """PELS-VAE with a linear network of states as its decoder.

    Shapes: b rows, f features of theta, p parameters, q elements, s states, c inputs, d outputs (t x k).

    Attributes:
        drive: What drives the network.
        form: Its elements.
    """

    column: Tensor
    stretch: Tensor
    is_power: Tensor
    start_column: Tensor
    start_stretch: Tensor
    mean: Tensor
    deviation: Tensor
    has_units: Tensor
    of_elements: Tensor
    of_parameters: Tensor
    rows_at_once = 64  # so many rows' states stay near a core

    def __init__(
        self,
        theta: ThetaStandardizer,
        outputs: OutputStandardizer,
        drive: Drive,
        config: SurrogateConfig,
        generator: torch.Generator,
    ) -> None:
        """Build encoder and regressor, and a network whose elements are near what is probable beforehand.

        Args:
            theta: Parameters to features.
            outputs: Outputs to scaled ones (`scaled_outputs`).
            drive: What drives the model.
            config: Form and size of the network, width and depth of encoder and regressor.
            generator: Source of the initial weights (CPU).
        """
        super().__init__(theta.n_features, outputs.mean.size, config, generator)
        self.drive = drive
        build = stores if config.states == "stores" else modes
        self.form: Form = build(drive, config.n_stores)
        form, z = self.form, config.n_latent
        p, s, q = theta.n_parameters, form.n_states, form.mean.size
        with torch.no_grad():
            for last in (self.encoding.last, self.regressing.last):
                last.weight.mul_(FIRST_CODE)
                last.bias.mul_(FIRST_CODE)
                last.bias[z:] = FIRST_LOG_VARIANCE

        def drawn(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator, dtype=torch.float64)

        starts = np.flatnonzero(drive.is_start)
        n_experiments = len(drive.every)
        self.constants = nn.Parameter(torch.tensor(form.mean) + FIRST_DEVIATION * drawn(q))
        self.powers = nn.Parameter(FIRST_POWER * drawn(q, p))
        self.of_code = nn.Parameter(torch.zeros(q, z, dtype=torch.float64))
        self.start = nn.Parameter(torch.zeros(n_experiments, s, dtype=torch.float64))
        self.of_start = nn.Parameter(torch.zeros(n_experiments, s, starts.size, dtype=torch.float64))
        # Derived from drive and scaling, hence in no file.
        column, stretch = _powers_of(theta, drive)
        alike = int(drive.columns[0][np.flatnonzero(drive.is_alike)[0]])
        unit, level = outputs.deviation[alike], outputs.mean[0, alike]
        self._set("column", torch.tensor(column))
        self._set("stretch", torch.tensor(stretch))
        self._set("is_power", torch.tensor(~drive.is_start))
        self._set("start_column", torch.tensor(starts))
        self._set("start_stretch", torch.tensor(theta.deviation[starts] * drive.start_ratio[starts] / unit))
        inputs = [(drive.potentials - level) / unit, drive.sources]
        if config.states == "modes":
            inputs += [drive.patterns[drive.pattern], np.ones((len(drive.pattern), 1))]
        # Switches are inputs of modes: one pattern.
        pattern = drive.pattern if config.states == "stores" else np.zeros_like(drive.pattern)
        self.solver = Solver(form, drive, np.hstack(inputs), pattern, len(outputs.mean))
        self._set("mean", torch.tensor(form.mean))
        self._set("deviation", torch.tensor(form.deviation))
        time_powers = drive.time_powers if drive.time_powers.size else np.zeros(p)
        has_units = np.isfinite(form.powers) & time_powers.any()
        self._set("has_units", torch.tensor(np.flatnonzero(has_units)))
        self._set("of_elements", torch.tensor(form.powers[has_units]))
        self._set("of_parameters", torch.tensor(np.where(drive.is_start, 0.0, time_powers)))

    def _set(self, name: str, value: Tensor) -> None:
        self.register_buffer(name, value, persistent=False)

    def decoder(self, z: Tensor, theta: Tensor) -> Tensor:
        """Mean of L decoded samples, Eq. 7: z (L, b, z), theta (b, f) -> x (b, d)."""
        powers = torch.where(self.is_power, theta[:, self.column].double() * self.stretch, 0.0)
        starts = theta[:, self.start_column].double() * self.start_stretch
        n_samples, b, _ = z.shape
        elements = self.constants + powers @ self.powers.T + z.double() @ self.of_code.T  # (L, b, q)
        first = self.start[:, None] + starts @ self.of_start.transpose(1, 2)  # (e, b, s)
        first = first.repeat(1, n_samples, 1).transpose(1, 2)
        y: Tensor = Solved.apply(elements.reshape(n_samples * b, -1), first, self.solver)
        return y.reshape(n_samples, b, -1).mean(dim=0)

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f) -> x (b, d); the mean code, as draws change little here."""
        del eps
        mean, _ = self.regressor(theta)
        return self.decoder(mean[None], theta)

    def add_slopes_of_prior(self, width: float, sparsity: float, weight: float) -> None:
        """Add to the gradients those of minus the logarithm of what is probable before anything is known.

        Few powers differ from zero, so each costs the logarithm of its size (Candès, Wakin and Boyd 2008,
        doi:10.1007/s00041-008-9045-x). Written out, as autograd would take as long as the network's solution.

        Args:
            width: Below it a power is free to vanish.
            sparsity: What each costs.
            weight: Multiplies all slopes.
        """
        with torch.no_grad():
            by_powers = (2.0 * sparsity * self.powers).div_(self.powers.square() + width**2)
            if len(self.has_units):
                # Units: the powers of time of what an element is a product of add up to its own.
                off = self.powers[self.has_units] @ self.of_parameters - self.of_elements
                by_powers[self.has_units] += torch.outer(off, self.of_parameters / UNITS**2)
            for weights, slopes in (
                (self.constants, (self.constants - self.mean) / self.deviation**2),
                (self.powers, by_powers),
                (self.of_code, self.of_code),
                (self.start, self.start / START**2),
                (self.of_start, self.of_start),
            ):
                assert weights.grad is not None, "the slopes of the loss come first"
                weights.grad.add_(slopes, alpha=weight)


class Solved(torch.autograd.Function):
    """Outputs of linear networks by `Solver`, with their slopes."""

    @staticmethod
    def forward(ctx: Any, elements: Tensor, first: Tensor, solver: Solver) -> Tensor:  # type: ignore[override]
        """Elements (n, q), first states (e, s, n) -> outputs (n, t k); torch declares any arguments."""
        ctx.solver = solver
        y, ctx.solution = solver.solve(np.ascontiguousarray(elements.numpy().T), first.numpy())
        return torch.from_numpy(y.T)

    @staticmethod
    def backward(ctx: Any, *by_results: Tensor) -> tuple[Tensor | None, ...]:
        """Slopes by the outputs -> slopes by elements and first states."""
        by_y = np.ascontiguousarray(by_results[0].numpy().T)
        by_elements, by_first = ctx.solver.slopes(by_y, ctx.solution)
        return torch.from_numpy(by_elements.T), torch.from_numpy(by_first), None


def _powers_of(theta: ThetaStandardizer, drive: Drive) -> tuple[Ints, Array]:
    """Return which feature a parameter's power is of, and what that is multiplied by. Shapes (p,), (p,).

    A logarithm as it is, so that a power of 1 is a product; else the parameter over its half range.
    """
    p = theta.n_parameters
    column, stretch = np.arange(p), np.full(p, OVER_HALF_RANGE)
    column[theta.log_columns] = p + np.arange(theta.log_columns.size)
    stretch[theta.log_columns] = theta.deviation[p:]
    return column, stretch
