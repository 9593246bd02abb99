"""The limits of the agent's processes, and the return of their memory to the system."""

import os
import resource
from contextlib import suppress


def keep_limits(connections: int) -> int:
    """Disable core files, which would contain keys, and allow files for all connections: how many.

    The priority is reset: a host may have a real-time priority, which the agent must not inherit.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = 2 * connections
    if 0 <= soft < enough:
        soft = min(enough, hard) if hard >= 0 else enough
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return soft if soft >= 0 else enough


def give_back() -> None:
    """Return freed memory to the system. glibc would keep it, because it lies between used memory.

    bench/agent_memory.py measures it. Other C libraries have no such function.
    """
    import ctypes  # noqa: PLC0415 -- not for a host that waits for the agent to start

    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
