"""What an agent inherits from the host that started it, and which later hosts it cannot serve.

It opens the files that hosts name, so it must have the same mount name space and groups. Limits
that its first host had set for itself must not make other hosts fail or wait.
"""

import os
import resource
import socket
import struct
from contextlib import suppress

from pqsec_pki.plugin.greeting import MODULE, PIN_FILE, Greeting
from pqsec_pki.plugin.system import LIMITS, enough_files, restrictions_of

_SO_PEERGROUPS = 59
"""SO_PEERGROUPS of Linux, on all architectures except PA-RISC and SPARC; Python has no name for
it."""
_INFINITE = float("inf")
_GROUP = struct.Struct("I")
_MOST_GROUPS = 256
"""The most groups that Python can read of a socket option; of more, the agent knows none."""


class Inherited:
    """What this process has of the host that started it."""

    def __init__(self, connections: int) -> None:
        """`connections` is how many an agent serves if it may open files for them."""
        self._files = enough_files(connections)
        self._greeting = Greeting.own("")
        self._groups = {os.getegid(), *os.getgroups()}
        self._limits = self._usable(0)
        self._restrictions = restrictions_of("self")

    def mismatch(self, link: socket.socket, process: int, greeting: Greeting) -> str:
        """Why it cannot serve this host; empty if it can."""
        own = self._greeting
        if greeting.files != own.files:
            return "a host has another mount name space or root folder"
        if _groups_of(link) not in (None, self._groups):
            return "a host has other groups"
        if greeting.module not in {"", own.module} or greeting.pin_file not in {"", own.pin_file}:
            return f"a host has another {MODULE} or {PIN_FILE}"
        if process and self._is_below(process):
            return "a host has higher limits, a higher priority or more rights"
        return ""

    def _is_below(self, process: int) -> bool:
        """Whether the host has higher limits, a higher priority or more rights than this
        process."""
        with suppress(OSError):  # it has gone, or has several users
            if any(
                own < their for own, their in zip(self._limits, self._usable(process), strict=True)
            ):
                return True
        with suppress(OSError):
            if os.getpriority(os.PRIO_PROCESS, 0) > max(
                0, os.getpriority(os.PRIO_PROCESS, process)
            ):
                return True
            policies = [os.sched_getscheduler(each) for each in (0, process)]
            if policies[0] == os.SCHED_IDLE != policies[1]:
                return True
        own, their = self._restrictions, restrictions_of(str(process))
        more = their.capabilities & ~own.capabilities if os.geteuid() == 0 else 0
        return bool(more) or own.filters > their.filters

    def _usable(self, process: int) -> list[float]:
        """The hard limits, as far as an agent can use them."""
        files = resource.prlimit(process, resource.RLIMIT_NOFILE)[1]
        others = [resource.prlimit(process, kind)[1] for kind in LIMITS]
        most = [_INFINITE if hard < 0 else hard for hard in (*others, files)]
        return [*most[:-1], min(most[-1], self._files)]


def _groups_of(link: socket.socket) -> set[int] | None:
    """The groups of the process at the other end, when it connected; None if they are not known."""
    form = struct.Struct("iII")
    try:
        octets = link.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MOST_GROUPS * _GROUP.size)
        _, _, first = form.unpack(link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, form.size))
    except OSError:
        return None
    return {first, *(group for (group,) in _GROUP.iter_unpack(octets))}
