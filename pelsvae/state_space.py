"""The decoder that knows the inputs: theta and the code make a linear network, which the inputs drive.

Eq. 3 to 7 stay as they are. What is new is that the decoder's layers are replaced by a linear network of
states (`linear_network`), of which every element is

    e = e0 + W f(theta) + V z,

with f the logarithms of positive parameters. So capacities and conductances are constants times powers of the
parameters, and the code z adds what powers leave unexplained; V is zero before training. Juliane Aka's group
went the same way with neural differential equations (B-NODE: A and B linear in the latent parameters).
"""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from pelsvae.config import SurrogateConfig
from pelsvae.linear_network import kernels
from pelsvae.linear_network.drive import Drive
from pelsvae.linear_network.form import MOST_LOG, SCALE, START, UNITS, Form, modes, stores
from pelsvae.linear_network.kernels import Floats, Ints
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
    makes: Tensor
    to_states: Tensor
    to_inputs: Tensor
    to_outputs: Tensor
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
        for name in ("makes", "to_states", "to_inputs", "to_outputs"):
            self._set(name, torch.tensor(getattr(form, name)))
        inputs = [(drive.potentials - level) / unit, drive.sources]
        if config.states == "modes":
            inputs += [drive.patterns[drive.pattern], np.ones((len(drive.pattern), 1))]
        self.inputs = np.ascontiguousarray(np.hstack(inputs), dtype=np.float32)
        is_switched = config.states == "stores"
        self.pattern = drive.pattern if is_switched else np.zeros_like(drive.pattern)
        self.n_patterns = len(drive.patterns) if is_switched else 1
        self.places = [np.flatnonzero(self.pattern == one) for one in range(self.n_patterns)]
        self.shape = outputs.mean.shape

    def _set(self, name: str, value: Tensor) -> None:
        self.register_buffer(name, value, persistent=False)

    def decoder(self, z: Tensor, theta: Tensor) -> Tensor:
        """Mean of L decoded samples, Eq. 7: z (L, b, z), theta (b, f) -> x (b, d)."""
        powers = torch.where(self.is_power, theta[:, self.column].double() * self.stretch, 0.0)
        starts = theta[:, self.start_column].double() * self.start_stretch
        n_samples, b, _ = z.shape
        elements = self.constants + powers @ self.powers.T + z.double() @ self.of_code.T  # (L, b, q)
        y = self._solved(elements.reshape(n_samples * b, -1), starts.repeat(n_samples, 1))
        return y.reshape(n_samples, b, -1).mean(dim=0)

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f) -> x (b, d); the mean code, as draws change little here."""
        del eps
        mean, _ = self.regressor(theta)
        return self.decoder(mean[None], theta)

    def prior(self, width: float, sparsity: float) -> Tensor:
        """Return minus the logarithm of the weights' probability before anything is known.

        Few powers differ from zero, so each costs the logarithm of its size (Candès, Wakin and Boyd 2008,
        doi:10.1007/s00041-008-9045-x).

        Args:
            width: Below it a power is free to vanish.
            sparsity: What each costs.
        """
        form, drive = self.form, self.drive
        mean, deviation = torch.tensor(form.mean), torch.tensor(form.deviation)
        cost = 0.5 * ((self.constants - mean) / deviation).square().sum()
        cost = cost + sparsity * torch.log(self.powers.square() + width**2).sum()
        cost = cost + 0.5 * self.of_code.square().sum()
        cost = cost + 0.5 * (self.start / START).square().sum() + 0.5 * self.of_start.square().sum()
        if drive.time_powers.any():
            # Units: the powers of time of what an element is a product of add up to its own.
            by_unit = torch.tensor(np.where(drive.is_start, 0.0, drive.time_powers))
            known = torch.tensor(np.flatnonzero(np.isfinite(form.powers)))
            off = self.powers[known] @ by_unit - torch.tensor(form.powers)[known]
            cost = cost + 0.5 * (off / UNITS).square().sum()
        return cost

    def _solved(self, elements: Tensor, starts: Tensor) -> Tensor:
        """Solve the network: elements (n, q), start parameters (n, w) -> outputs (n, t k)."""
        form, drive, n = self.form, self.drive, len(elements)
        n_logs, s, c = self.makes.shape[1], form.n_states, self.inputs.shape[1]
        rates = torch.exp((elements[:, :n_logs] @ self.makes.T).clamp(-MOST_LOG, form.most))
        made = torch.cat([torch.ones_like(rates[:, :1]), rates, elements[:, n_logs:]], dim=1).T
        a = (self.to_states @ made).reshape(self.n_patterns, s, s, n)
        b = (self.to_inputs @ made).reshape(self.n_patterns, s, c, n)
        cd = (self.to_outputs @ made).reshape(len(form.summed), s + c, n).float()
        first = (self.start[:, None] + starts @ self.of_start.transpose(1, 2)).transpose(1, 2)  # (e, s, n)
        x = Walked.apply(
            a, b, first, self.inputs, self.pattern, self.places, drive
        )  # reported states (t of all, s, n)
        parts: list[Tensor] = [x] * self.shape[1]
        begin = 0
        for place, (steps, reported) in enumerate(drive.experiments()):
            here = x[begin : begin + reported.size]
            begin += reported.size
            # The first states are outputs as they are.
            found = list(here.unbind(dim=1))
            if form.summed:
                seen = torch.from_numpy(self.inputs[steps][np.maximum(reported - 1, 0)])  # (t, c)
                sums = torch.einsum("lsn,tsn->ltn", cd[:, :s], here)
                sums = sums + torch.einsum("lcn,tc->ltn", cd[:, s:], seen)
                for output, one in zip(form.summed, sums, strict=True):
                    found.insert(output, one)
            for column, y in zip(drive.columns[place], found, strict=False):
                # A shorter experiment keeps its last values, as simulated rows do.
                parts[column] = torch.cat([y, y[-1:].expand(self.shape[0] - len(y), n)])
        # Rows first at last: in what precedes they lie last.
        return torch.stack(parts, dim=1).reshape(-1, n).T


class Walked(torch.autograd.Function):
    """States of linear networks at the reported times, with their slopes by the adjoint."""

    @staticmethod
    def forward(  # type: ignore[override]  # torch declares any arguments
        ctx: Any,
        a: Tensor,
        b: Tensor,
        first: Tensor,
        inputs: Floats,
        pattern: Ints,
        places: list[Ints],
        drive: Drive,
    ) -> Tensor:
        """Matrices a (r, s, s, n), b (r, s, c, n), first states (e, s, n) -> states (t of all, s, n)."""
        r, s, _, n = a.shape
        matrices = np.ascontiguousarray(a.detach().numpy().transpose(1, 2, 0, 3)).reshape(s, s, r * n)
        norm = float(np.abs(matrices).sum(axis=1).max()) * drive.step
        n_doublings = max(0, math.ceil(math.log2(max(norm, 1e-9) / kernels.MOST_NORM)))
        series = np.empty((kernels.N_TERMS, s, s, r * n))
        doubled = np.empty((2, n_doublings + 1, s, s, r * n))
        kernels.exponentials(matrices, drive.step, series, doubled)
        exponential, integral = doubled[:, -1].reshape(2, s, s, r, n)
        by_inputs = b.detach().numpy()
        gains = np.einsum("ijrn,rjcn->rinc", integral, by_inputs).astype(np.float32).reshape(r, s * n, -1)
        # Single precision suffices for states: 1e-6 of their scale, and half the time.
        single = np.ascontiguousarray(exponential.transpose(2, 0, 1, 3), dtype=np.float32)
        driven = np.empty((len(pattern), s, n), dtype=np.float32)
        for one, steps in enumerate(places):
            driven[steps] = _product(inputs[steps], gains[one].T).reshape(-1, s, n)
        walks, reported = list[Floats](), list[Floats]()
        for place, (steps, times) in enumerate(drive.experiments()):
            x = np.empty((steps.stop - steps.start + 1, s, n), dtype=np.float32)
            begin = np.ascontiguousarray(first[place].detach().numpy(), dtype=np.float32)
            kernels.walk(single, driven[steps], begin, pattern[steps], x)
            walks.append(x)
            reported.append(x[times])
        ctx.kept = (
            matrices,
            series,
            doubled,
            single,
            integral,
            by_inputs,
            walks,
            inputs,
            pattern,
            places,
            drive,
        )
        return torch.from_numpy(np.concatenate(reported))

    @staticmethod
    def backward(ctx: Any, *by_results: Tensor) -> tuple[Tensor | None, ...]:
        """Slopes by the reported states (t of all, s, n) -> slopes by a, b and the first states."""
        matrices, series, doubled, single, integral, by_inputs, walks, inputs, pattern, places, drive = (
            ctx.kept
        )
        r, s, _, n = single.shape
        by_reported = by_results[0].numpy()
        by_exponential = np.zeros(single.shape)
        by_driven = np.empty((len(pattern), s, n), dtype=np.float32)
        by_first, begin = list[Floats](), 0
        for x, (steps, times) in zip(walks, drive.experiments(), strict=True):
            by_x = np.zeros_like(x)
            by_x[times] = by_reported[begin : begin + times.size]
            begin += times.size
            by_exponential += kernels.walk_adjoint(single, by_x, pattern[steps], x)
            by_driven[steps] = by_x[1:]
            by_first.append(by_x[0])
        by_gains = np.stack(
            [_product(by_driven[one].reshape(-1, s * n).T, inputs[one]).reshape(s, n, -1) for one in places]
        ).astype(np.float64)  # (r, s, n, c)
        by_integral = np.einsum("rinc,rjcn->ijrn", by_gains, by_inputs)
        by_b = np.einsum("ijrn,rinc->rjcn", integral, by_gains)
        by_a = kernels.exponentials_adjoint(
            matrices,
            drive.step,
            series,
            doubled,
            np.ascontiguousarray(by_exponential.transpose(1, 2, 0, 3)).reshape(s, s, r * n),
            np.ascontiguousarray(by_integral).reshape(s, s, r * n),
        )
        slopes = by_a.reshape(s, s, r, n).transpose(2, 0, 1, 3), by_b, np.stack(by_first).astype(np.float64)
        return *(torch.from_numpy(np.ascontiguousarray(one)) for one in slopes), None, None, None, None


def _product(left: Floats, right: Floats) -> Floats:
    """Return a matrix product by torch, whose threads `n_threads` sets: NumPy's would take every core."""
    product: Floats = (torch.from_numpy(left) @ torch.from_numpy(right)).numpy()
    return product


def _powers_of(theta: ThetaStandardizer, drive: Drive) -> tuple[Ints, Array]:
    """Return which feature a parameter's power is of, and what that is multiplied by. Shapes (p,), (p,).

    A logarithm as it is, so that a power of 1 is a product; else the parameter over its half range.
    """
    p = theta.n_parameters
    column, stretch = np.arange(p), np.full(p, OVER_HALF_RANGE)
    column[theta.log_columns] = p + np.arange(theta.log_columns.size)
    stretch[theta.log_columns] = theta.deviation[p:]
    return column, stretch
