"""Trains a PELS-VAE with a state-space decoder by Eq. 5 and the priors of its elements."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import BestWeights, EpochReport
from pelsvae.loss import LossTerms, objective, reconstruction
from pelsvae.network_training import learning_rate, step_of_adam
from pelsvae.state_space import StateSpaceVae

# Optimizer steps of an epoch, whatever the number of rows: so few rows as 32 need as many steps as 2,000.
STEPS_PER_EPOCH = 8
# Learning rates of elements and of first states, in that of the layers.
OF_ELEMENTS, OF_STARTS = 10.0, 30.0
# Part of the training in which the code is zero: powers come first, the code explains what they leave.
WITHOUT_CODE = 0.4
# Width of the powers' cost, first and last; it falls as a power of the progress.
WIDE, NARROW, NARROWER = 0.5, 0.1, 0.03
# The noise that rows are weighed by: first, and how much it may fall in a step; it is never below what single
# precision shows.
FIRST_NOISE, NOISE_FALL, LEAST_NOISE = 25.0, 0.97, 1e-8
LONGEST_GRADIENT = 1.0
# Values of a trajectory that count as independent beside the priors: with 6 an office of 64 rows erred least.
INDEPENDENT = 6.0


def train_state_space(
    network: StateSpaceVae,
    config: SurrogateConfig,
    theta: Tensor,
    x: Tensor,
    *,
    validation_error: Callable[[], float | None],
    generator: torch.Generator,
    on_epoch: Callable[[EpochReport], None] | None,
) -> tuple[int, int, str]:
    """Train a network in place and leave it with the weights of the best validated epoch.

    The loss is Eq. 5 with beta over the most probable variance of the error, so that beta weighs it
    against the code whatever the error's size, and the priors over the number of rows.

    Args:
        network: Encoder, state-space decoder and regressor.
        config: Batches, optimizer, epochs.
        theta: Features of theta. Shape (n, f). [1]
        x: Scaled trajectories. Shape (n, d). [1]
        validation_error: Judges the network as it stands; None where nothing does.
        generator: Of batches and draws.
        on_epoch: Called after each validated epoch.

    Returns:
        The best epoch; the last one; why it ended.

    Raises:
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    n, size = len(x), min(config.batch_size, len(x))
    elements: list[Tensor] = [network.constants, network.powers]
    starts: list[Tensor] = [network.start, network.of_start]
    taken = {id(weight) for weight in (*elements, *starts)}
    layers: list[Tensor] = [weight for weight in network.parameters() if id(weight) not in taken]
    weights = [*elements, *starts, *layers]
    step_elements = EigenAdam(elements).step
    step_starts, step_layers = step_of_adam(starts, 0.0), step_of_adam(layers, config.weight_decay)
    noise, epoch = FIRST_NOISE, 0
    best = BestWeights(weights, config.max_epochs, on_epoch)
    n_steps = config.max_epochs * STEPS_PER_EPOCH
    for number in range(n_steps):
        progress = number / n_steps
        rows = torch.randperm(n, generator=generator)[:size] if size < n else torch.arange(n)
        terms, noise = _loss(network, config, theta[rows], x[rows], progress, noise, generator)
        for weight in weights:
            weight.grad = None
        (terms.total / (2.0 * config.beta)).backward()
        width = max(WIDE * NARROWER**progress, NARROW)
        network.add_slopes_of_prior(width, config.sparsity, 0.5 / (INDEPENDENT * n))
        nn.utils.clip_grad_norm_([w for w in weights if w.grad is not None], LONGEST_GRADIENT)
        rate = learning_rate(config, progress)
        step_elements(OF_ELEMENTS * rate)
        step_starts(OF_STARTS * rate)
        if progress > WITHOUT_CODE:
            step_layers(rate)
        epoch, rest = divmod(number + 1, STEPS_PER_EPOCH)
        if rest or (epoch % config.validate_every and epoch < config.max_epochs):
            continue
        mae = validation_error()
        best.judge(epoch, mae, torch.stack(terms).detach().tolist(), LossTerms._fields[1:], "learning_rate")
        if best.stopped or epoch - best.epoch >= config.patience:
            break
    best.restore()
    usual = "max_epochs" if epoch == config.max_epochs else "patience"
    return best.epoch, epoch, best.stopped or usual


def _loss(
    network: StateSpaceVae,
    config: SurrogateConfig,
    theta: Tensor,
    x: Tensor,
    progress: float,
    noise: float,
    generator: torch.Generator,
) -> tuple[LossTerms, float]:
    """Return the terms of Eq. 5 for a batch, and the noise that rows are weighed by."""
    zero, z = x.new_zeros(()), config.n_latent
    if progress <= WITHOUT_CODE:
        error = reconstruction(network.decoder(x.new_zeros(1, len(x), z), theta), x)
        terms = LossTerms(error, zero, error, zero, zero)
    else:
        eps = torch.randn(config.n_latent_samples, len(x), z, generator=generator)
        terms = objective(network, x, theta, eps=eps, beta=1.0, detach_encoder=config.detach_encoder)
    noise = max(float(terms.reconstruction.detach()), NOISE_FALL * noise, LEAST_NOISE)
    total = terms.total + (config.beta / noise - 1.0) * terms.reconstruction
    return LossTerms(total, *(one.detach() for one in terms[1:])), noise


class EigenAdam:
    """Adam in the eigenbasis of a matrix' gradients: elements are ill-conditioned.

    Vyas et al. 2024, arXiv:2409.11321 (SOAP); blocks side by side are one matrix.
    """

    MEMORY, FIRST_MEMORY, N_STEPS = 0.95, 0.9, 10  # of squares and of means; steps between two eigenbases

    def __init__(self, blocks: Sequence[Tensor]) -> None:
        """Begin with nothing seen.

        Args:
            blocks: Tensors of equal length. Shapes (q,) or (q, c).
        """
        self.blocks, self.n = blocks, 0

    def step(self, learning_rate: float) -> None:
        """Take a step along the blocks' gradients."""
        by = torch.cat([one.grad.reshape(len(one), -1) for one in self.blocks if one.grad is not None], dim=1)
        memory = self.MEMORY
        if not self.n:
            self.left, self.right = by @ by.T, by.T @ by
            self.mean, self.square = torch.zeros_like(by), torch.zeros_like(by)
        self.left = memory * self.left + (1.0 - memory) * by @ by.T
        self.right = memory * self.right + (1.0 - memory) * by.T @ by
        if self.n % self.N_STEPS == 0:
            self.of_left, self.of_right = (torch.linalg.eigh(one)[1] for one in (self.left, self.right))
        self.n += 1
        self.mean = self.FIRST_MEMORY * self.mean + (1.0 - self.FIRST_MEMORY) * by
        turned = self.of_left.T @ by @ self.of_right
        self.square = memory * self.square + (1.0 - memory) * turned.square()
        towards = self.of_left.T @ self.mean @ self.of_right / (1.0 - self.FIRST_MEMORY**self.n)
        towards = towards / ((self.square / (1.0 - memory**self.n)).sqrt() + 1e-12)
        whole, begin = self.of_left @ towards @ self.of_right.T, 0
        with torch.no_grad():
            for one in self.blocks:
                width = one.numel() // len(one)
                one -= learning_rate * whole[:, begin : begin + width].reshape(one.shape)
                begin += width
