"""Memory: the need of a result is compared with the available memory before the work."""

import math
import os
from contextlib import suppress
from pathlib import Path

from hyperflex.errors import InvalidInput

SMALL = 2.0**26  # bytes that are not checked

_INFO, _CGROUPS, _SIZE = Path("/proc/meminfo"), Path("/sys/fs/cgroup"), Path("/proc/self/statm")
# limit, use and account of a control group, version 2 and 1
_GROUPS = (
    ("memory.max", "memory.current", "memory.stat"),
    ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "memory/memory.stat"),
)


def available() -> float:
    """Return the available memory, bytes: the least of the machine's, the container's and the process's."""
    return min(_of_machine(), *(_of_container(*names) for names in _GROUPS), _of_process())


def check(size: float, what: str, fix: str) -> None:
    """Refuse work, before it begins, that would need more memory than is available.

    Parameters
    ----------
    size : float
        Estimate of the peak memory, bytes.
    what : str
        The work, for the message.
    fix : str
        How to reduce it.

    Raises
    ------
    InvalidInput
        If the memory is too small.
    """
    if size > SMALL and size > (there := available()):
        raise InvalidInput(
            f"{what} would fill the memory", got=in_words(size), allowed=f"{in_words(there)} here", fix=fix
        )


def in_words(size: float) -> str:
    """Return a size, bytes, as a readable text."""
    return f"{size / 2**30:.3g} GiB" if size >= 2**30 else f"{size / 2**20:.3g} MiB"


def _entry(path: Path, name: str) -> float:
    """Return the number behind a name in a file of names and numbers."""
    rows = (line.split() for line in path.read_text().splitlines())
    return float(next(row[1] for row in rows if row[0] == name))


def _of_machine() -> float:
    with suppress(OSError, ValueError, StopIteration):
        return 1024.0 * _entry(_INFO, "MemAvailable:")
    with suppress(OSError, ValueError, AttributeError):  # not Linux: the total, used or not
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return math.inf


def _of_container(limit: str, used: str, account: str) -> float:
    with suppress(OSError, ValueError):  # no such group, or its limit is the word "max"
        free = float((_CGROUPS / limit).read_text()) - float((_CGROUPS / used).read_text())
        with suppress(OSError, ValueError, StopIteration):  # cached files count as used until memory is needed
            free += _entry(_CGROUPS / account, "inactive_file")
        return free
    return math.inf


def _of_process() -> float:
    with suppress(ImportError, OSError, ValueError):  # Windows has no such limit
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            return float(limit) - float(_SIZE.read_text().split()[0]) * resource.getpagesize()
    return math.inf
