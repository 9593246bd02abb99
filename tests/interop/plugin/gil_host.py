"""A Python host that keeps the interpreter lock in all its calls, as rclpy does in many.

usage: gil_host.py DOMAIN COUNT

So many participants are made and deleted, each after a little longer, so that peers are in
every stage of a handshake with it.
"""

import ctypes
import ctypes.util
import sys
from pathlib import Path

LONGEST = 200_000
"""Microseconds: a handshake takes some 150,000, most of it waiting."""


def main() -> None:
    domain, count = map(int, sys.argv[1:])
    found = sorted(Path("/usr/lib").glob("*/libddsc.so.*"))
    dds, libc = ctypes.PyDLL(str(found[0])), ctypes.PyDLL(None)
    for number in range(count):
        participant = dds.dds_create_participant(domain, None, None)
        if participant < 0:
            sys.exit(f"participant {number}: {participant}")
        libc.usleep(LONGEST * number // count)
        if dds.dds_delete(participant) != 0:
            sys.exit(f"participant {number} cannot be deleted")
    print(count)


main()
