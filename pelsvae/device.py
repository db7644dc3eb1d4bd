"""Where and how torch computes: device by name, thread count and flushed denormals for a while."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from pelsvae.config import Device

# Without it searches on 512 rows made 2,600 to 4,900 page faults a step, a third of the time.
_LARGEST_KEPT = 2**25 - 2**16  # bytes; just below glibc's DEFAULT_MMAP_THRESHOLD_MAX


def resolve_device(device: Device) -> torch.device:
    """Turn a device setting into a torch device.

    Args:
        device: "auto", "cpu" or "cuda".

    Returns:
        The device; for "auto" CUDA where there is one.

    Raises:
        ValueError: CUDA was asked for where there is none.
    """
    if device == "cuda" and not torch.cuda.is_available():
        raise ValueError("device 'cuda' asked for, but torch finds no CUDA device here; use 'auto' or 'cpu'")
    return torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")


@contextmanager
def n_threads_set(n_threads: int | None) -> Iterator[None]:
    """Let torch use so many CPU threads inside the block, and as many as before after it.

    Args:
        n_threads: Threads, or None to change nothing.
    """
    before = torch.get_num_threads()
    if n_threads is None or n_threads == before:
        yield
        return
    torch.set_num_threads(n_threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def denormals_flushed() -> Iterator[None]:
    """Treat denormal numbers as zero inside the block.

    The second moments of weights that no longer matter decay into denormals, which cost a CPU a hundred
    times a normal operation. Outside the block, where physics is computed, they are kept.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def keep_freed_memory() -> None:
    """Let glibc keep released memory for this process's next tensors instead of asking the system anew.

    It hands blocks back until one of their size was released once, 32 MB at most; the system gives every page
    of a new one zeroed, which costs more than what is computed on it. One empty block of that size, of which
    no page is touched, ends that. On other systems it does nothing.
    """
    # Released at once: glibc then raises its mmap threshold to this size (mallopt(3)).
    torch.empty(_LARGEST_KEPT, dtype=torch.uint8)
