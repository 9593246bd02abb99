"""The messages in a stack's log, without colours, times and threads."""

import re

_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_FRONT = re.compile(
    r"\A(?:"  # only at the start: the rest of a line may be anything, and a megabyte long
    r"\d{4}-\d\d-\d\d [\d:.]+ "  # Fast DDS: the time
    r"|\d{9,}\.\d+ \[\d*\]\s*\S+:\s+"  # Cyclone DDS: the time, the domain, the thread
    r")"
)
_OWN = re.compile(r"joined|matched|received |refused ")
_NOISE = re.compile(
    r"\[(UTILS|TRANSPORT\w*|RTPS_WRITER|RTPS_READER|RTPS_MSG_\w+) Warning\]"  # of Fast DDS
    r"|using network interface|selected interface"  # of Cyclone DDS
)
_FUNCTION = re.compile(r" ?-> Function \S+\Z")
MOST = 50
"""Lines that are returned."""


def words(log: str) -> tuple[str, ...]:
    """The messages in a participant's log, each once, in their order; at most MOST."""
    plain = (_COLOUR.sub("", line).strip() for line in log.splitlines())
    lines = (line for line in plain if line and not _OWN.match(line) and not _NOISE.search(line))
    bare = (_FUNCTION.sub("", _FRONT.sub("", line)).strip() for line in lines)
    return tuple(dict.fromkeys(filter(None, bare)))[:MOST]
