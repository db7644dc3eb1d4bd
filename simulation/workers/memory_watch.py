"""Whether the system has killed a process for want of memory."""

from contextlib import suppress
from pathlib import Path

_COUNTERS = (Path("/sys/fs/cgroup/memory.events"), Path("/proc/vmstat"))


class OutOfMemoryWatch:
    """Notices that the system's count of processes killed for want of memory has grown.

    Args:
        counters: files with lines of a name and a number, one of them named `oom_kill`.
    """

    def __init__(self, counters: tuple[Path, ...] = _COUNTERS) -> None:
        self._counters = counters
        self._before = self._count()

    def has_struck(self) -> bool:
        """Return whether a process was killed for want of memory since the last question."""
        before, self._before = self._before, self._count()
        return self._before > before

    def _count(self) -> int:
        total = 0
        for file in self._counters:
            with suppress(OSError, ValueError):  # another system, or a container that may not look
                for line in file.read_text(encoding="ascii").splitlines():
                    name, _, number = line.partition(" ")
                    if name == "oom_kill":
                        total += int(number)
        return total
