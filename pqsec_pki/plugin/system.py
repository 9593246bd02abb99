"""The limits and rights of the agent's processes, and the return of their memory to the system."""

import os
import resource
from contextlib import suppress
from pathlib import Path

from pqsec_pki._dataclass import dataclass

LIMITS = tuple(
    getattr(resource, f"RLIMIT_{name}") for name in ("AS", "CPU", "DATA", "FSIZE", "NPROC")
)
"""If one is low, an agent ends, or cannot load a library, pass on a list or fork a worker."""
_CAPSET_VERSION = 0x20080522
"""_LINUX_CAPABILITY_VERSION_3 of capset(2)."""
_UNKNOWN = 1 << 32


@dataclass(frozen=True, slots=True)
class Restrictions:
    """What the system says of a process (proc_pid_status(5))."""

    capabilities: int = 0
    """The permitted ones."""
    filters: int = _UNKNOWN
    """How many filters of system calls it has (seccomp)."""


def restrictions_of(process: str) -> Restrictions:
    """Default values if the process has ended, or there is no /proc."""
    try:
        text = Path("/proc", process, "status").read_text(errors="replace")
    except OSError:
        return Restrictions()
    found = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    filters = found.get("Seccomp_filters") or found.get("Seccomp") or _UNKNOWN
    return Restrictions(int(found.get("CapPrm", "0"), 16), int(filters))


def undo_hosts_settings() -> None:
    """Undo what a host may have set for itself before it started the agent.

    Soft limits are raised, the priority is reset, and capabilities are given up unless the user is
    root: later hosts would use them through the agent.
    """
    for each in LIMITS:
        _, hard = resource.getrlimit(each)
        resource.setrlimit(each, (hard, hard))
    with suppress(OSError):  # only root may take a higher one
        os.setpriority(os.PRIO_PROCESS, 0, 0)
    own = restrictions_of("self")
    if os.geteuid() != 0 and (own.capabilities or own == Restrictions()):  # then nobody knows
        import ctypes  # noqa: PLC0415 -- seldom

        head, none = (ctypes.c_uint32 * 2)(_CAPSET_VERSION, 0), (ctypes.c_uint32 * 6)()
        if ctypes.CDLL(None, use_errno=True).capset(head, none):
            raise OSError(ctypes.get_errno(), "the host's capabilities cannot be given up")


def keep_limits(connections: int) -> int:
    """Disable core files, which would contain keys, and allow files for all connections: how many.

    The priority is reset: a host may have a real-time priority, which the agent must not inherit.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = enough_files(connections)
    if 0 <= soft < enough:
        soft = min(enough, hard) if hard >= 0 else enough
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return soft if soft >= 0 else enough


def enough_files(connections: int) -> int:
    """How many open files an agent with so many connections needs at most."""
    return 2 * connections


def give_back() -> None:
    """Return freed memory to the system. glibc would keep it, because it lies between used memory.

    bench/agent_memory.py measures it. Other C libraries have no such function.
    """
    import ctypes  # noqa: PLC0415 -- not for a host that waits for the agent to start

    with suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
