"""What Linux tells of a running process (proc(5)): its time, its memory, and its network."""

import os
from pathlib import Path

_SNMP = {"OutDatagrams": "Udp", "InDatagrams": "Udp", "RcvbufErrors": "Udp", "ReasmFails": "Ip"}
"""Counters and their protocols in `net/snmp`: datagrams sent, received, and dropped because their
receiver was too slow; and not reassembled."""
_QUEUE_DROPS, _DROPPED = "QueueDrops", 11
"""Frames that were lost because the switch was too slow, and their field in `net/dev`."""


def processor_seconds(process: int) -> float:
    """Seconds of the processor that it has taken; 0 if it has ended."""
    fields = _text(process, "stat").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def proportional_memory(process: int) -> int:
    """Kilobytes, of what processes share its part (proc_pid_smaps(5)); 0 if it has ended."""
    lines = _text(process, "smaps_rollup").splitlines()
    return next((int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


def network_counters(process: int) -> dict[str, int]:
    """Those of _SNMP in its network namespace, and _QUEUE_DROPS; nothing if it has ended."""
    lines = _text(process, "net/snmp").splitlines()
    found: dict[tuple[str, str], int] = {}
    for names, values in zip(lines[::2], lines[1::2], strict=False):
        protocol, *counters = names.split()
        numbers = map(int, values.split()[1:])
        found |= {
            (protocol.rstrip(":"), each): n for each, n in zip(counters, numbers, strict=False)
        }
    if not found:
        return {}
    counted = {name: found.get((protocol, name), 0) for name, protocol in _SNMP.items()}
    return counted | {_QUEUE_DROPS: _queue_drops(process)}


def _queue_drops(process: int) -> int:
    lines = _text(process, "net/dev").splitlines()
    fields = (line.partition(":")[2].split() for line in lines if line.strip().startswith("eth0:"))
    return sum(int(each[_DROPPED]) for each in fields)


def _text(process: int, name: str) -> str:
    """A file of the process; empty if it has ended."""
    try:
        return Path(f"/proc/{process}/{name}").read_text()
    except OSError:
        return ""
