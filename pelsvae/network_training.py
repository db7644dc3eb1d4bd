"""Trains the three networks by Eq. 5: epochs, batches, the course of the learning rate, the best weights."""

import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.optim.adamw import adamw

from pelsvae.config import SurrogateConfig
from pelsvae.device import denormals_flushed
from pelsvae.epochs import BestWeights, EpochReport
from pelsvae.loss import LossTerms, objective
from pelsvae.network import PelsVae

_Step = Callable[[Tensor, float], LossTerms]
# One-cycle schedule of Smith and Topin 2019, arXiv:1708.07120.
_WARM_UP = 0.2  # part of a one-cycle schedule in which the learning rate rises
_START = 0.04  # of the peak learning rate, where one-cycle begins
SHORT_MEMORY = 0.99  # of the squares of gradients
_END = 1e-3  # of the peak learning rate, where one-cycle ends


@denormals_flushed()
def train_network(
    network: PelsVae,
    config: SurrogateConfig,
    theta: Tensor,
    x: Tensor,
    *,
    validation_error: Callable[[], float | None],
    generator: torch.Generator,
    on_epoch: Callable[[EpochReport], None] | None,
) -> tuple[int, int, str]:
    """Train a network in place by Eq. 5 and leave it with the weights of the best validated epoch.

    Args:
        network: Encoder, decoder and regressor.
        config: Batches, draws, optimizer, epochs.
        theta: Features of theta. Shape (n, f). [1]
        x: Standardized trajectories. Shape (n, d). [1]
        validation_error: Judges the network as it stands; None where nothing does, and patience waits for
            nothing.
        generator: Of the order of the batches; its seed is that of the draws too.
        on_epoch: Called after each validated epoch.

    Returns:
        The best epoch; the last one; why it ended.

    Raises:
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    n = len(x)
    size = min(config.batch_size, n)
    starts = range(0, n, size)
    # Draws are made where they are used; batches are drawn on the CPU, the same for every device.
    noise = torch.Generator(x.device).manual_seed(generator.initial_seed())
    weights: list[Tensor] = list(network.parameters())
    # Where the latent code has settled on the prior its gradients vanish, and with Adam's usual memory of a
    # thousand steps the first larger one is a leap: seen as spikes of the loss, and once as NaN.
    memory = SHORT_MEMORY if config.optimizer == "adamw" else 0.999
    step_weights = step_of_adam(weights, config.weight_decay, memory)
    best = BestWeights(weights, config.max_epochs, on_epoch)
    n_done, n_steps = 0, config.max_epochs * len(starts)

    def step(rows: Tensor, learning_rate: float | Tensor) -> LossTerms:
        """Learn from a batch; rows has shape (b,)."""
        x_batch, theta_batch = x[rows], theta[rows]  # (b, d), (b, f)
        eps = torch.randn(
            config.n_latent_samples, len(rows), config.n_latent, generator=noise, device=x.device
        )  # (L, b, z)
        terms = objective(
            network, x_batch, theta_batch, eps=eps, beta=config.beta, detach_encoder=config.detach_encoder
        )
        for weight in weights:
            # None rather than zeros: backward() then writes gradients instead of adding to them.
            weight.grad = None
        terms.total.backward()
        step_weights(learning_rate)
        return terms

    learn: _Step = _replayed(step, noise) if x.is_cuda else step
    order = torch.arange(n, device=x.device)
    for epoch in range(1, config.max_epochs + 1):
        if size < n:
            order = torch.randperm(n, generator=generator).to(x.device)
        sums = torch.zeros(5, device=x.device)
        is_reported = epoch % config.validate_every == 0 or epoch == config.max_epochs
        for start in starts:
            rows = order[start : start + size]
            terms = learn(rows, learning_rate(config, n_done / n_steps))
            n_done += 1
            if is_reported:
                # Weighted, as the last batch may be smaller; only in epochs that are reported.
                sums += torch.stack(terms).detach() * (len(rows) / n)
        if not is_reported:
            continue
        mae = validation_error()
        best.judge(epoch, mae, sums.tolist(), LossTerms._fields[1:], "learning_rate or beta")
        if best.stopped or epoch - best.epoch >= config.patience:
            break
    best.restore()
    usual = "max_epochs" if epoch == config.max_epochs else "patience"
    return best.epoch, epoch, best.stopped or usual


def _replayed(step: Callable[[Tensor, float | Tensor], LossTerms], noise: torch.Generator) -> _Step:
    """Record a training step as a CUDA graph, once per batch size, and replay it.

    A step is some hundred kernels, and to launch them one by one takes longer than they run.

    Args:
        step: Learns from rows, shape (b,), with a learning rate; leaves what it returns on the device.
        noise: Source of the step's draws, on the device.

    Returns:
        The same step. What it returns is overwritten by the next one.
    """
    stream = torch.cuda.Stream(noise.device)
    recordings: dict[int, tuple[torch.cuda.CUDAGraph, Tensor, Tensor, LossTerms]] = {}

    def replay(rows: Tensor, learning_rate: float) -> LossTerms:
        if len(rows) in recordings:
            graph, held_rows, held_rate, result = recordings[len(rows)]
            held_rows.copy_(rows)
            held_rate.fill_(learning_rate)
            graph.replay()
            return result
        held_rows, held_rate = rows.clone(), torch.tensor(learning_rate, device=noise.device)
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            # What happens once only, as loading kernels, cannot be recorded.
            first = step(held_rows, held_rate)
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        graph.register_generator_state(noise)
        with torch.cuda.graph(graph, stream=stream, capture_error_mode="thread_local"):
            recordings[len(rows)] = graph, held_rows, held_rate, step(held_rows, held_rate)
        return first

    return replay


def step_of_adam(
    weights: list[Tensor], weight_decay: float, memory: float = SHORT_MEMORY
) -> Callable[[float | Tensor], None]:
    """Return what takes a step of Adam or AdamW with a learning rate.

    torch's function, not its class: to make one loads torch's compiler, two seconds in every process.
    """
    means, squares = ([torch.zeros_like(weight) for weight in weights] for _ in range(2))
    n_steps = [weight.new_zeros((), dtype=torch.float32) for weight in weights]

    def step(rate: float | Tensor) -> None:
        gradients = [weight.grad for weight in weights if weight.grad is not None]
        with torch.no_grad():
            # Without an optimizer object: 2.7 instead of 4.1 s for `refined` at n = 32, with equal bits.
            adamw(
                weights, gradients, means, squares, [], n_steps,
                fused=True, amsgrad=False, maximize=False,
                lr=rate, beta1=0.9, beta2=memory, weight_decay=weight_decay, eps=1e-8,
            )  # fmt: skip

    return step


def learning_rate(config: SurrogateConfig, progress: float) -> float:
    """Return the learning rate at a progress in [0, 1); one-cycle is a cosine up, then a cosine down."""
    if config.schedule == "constant":
        return config.learning_rate
    if progress < _WARM_UP:
        low, phase = _START, 1.0 - progress / _WARM_UP
    else:
        low, phase = _END, (progress - _WARM_UP) / (1.0 - _WARM_UP)
    return config.learning_rate * (low + (1.0 - low) * 0.5 * (1.0 + math.cos(math.pi * phase)))
