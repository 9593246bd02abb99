"""Who beside the caller could change a folder or file: what sshd's StrictModes asks.

Whoever may write in a folder can put a link where the next command expects a file. So what
is worked on must be the caller's own, and nobody else's to write: others (mode o+w), or a
group, unless that is the user's private group, as Debian and others give each user one.
"""

import grp
import os
import pwd
import stat
from functools import cache


def outsider(found: os.stat_result, *, roots: bool = False, sticky: bool = False) -> str:
    """Who else could change what `found` is of, in words; empty if nobody could.

    With `roots`, what is the superuser's is as good as the caller's own; with `sticky`,
    a folder in which nobody may replace what is another's is good too, such as /tmp.
    """
    if found.st_uid != os.geteuid() and not (roots and found.st_uid == 0):
        return f"it belongs to another user ({user(found.st_uid)})"
    if stat.S_ISLNK(found.st_mode) or (sticky and found.st_mode & stat.S_ISVTX):
        return ""  # the mode of a link says nothing
    if found.st_mode & stat.S_IWOTH:
        return "anybody may write there"
    if found.st_mode & stat.S_IWGRP and not _is_private(found.st_gid):
        return f"group {_group(found.st_gid)} may write there"
    return ""


def way_out(found: os.stat_result, path: str) -> str:
    """What to do about an `outsider`, for a hint."""
    if found.st_uid == os.geteuid():
        return f"chmod go-w {path}"
    owner = user(found.st_uid)
    if os.geteuid() == 0:
        return f"run the command as its owner, `sudo -u {owner} pqsec ...`; or chown it"
    return f"{owner} may change it; you may change a copy of your own"


@cache
def user(number: int) -> str:
    """What the system calls the user, or else `uid 1000`."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"uid {number}"


@cache
def _is_private(number: int) -> bool:
    """Whether it is the caller's own group, of the same name and without other members."""
    try:
        me, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(number)
    except KeyError:
        return False
    others = set(group.gr_mem) - {me.pw_name}
    return me.pw_gid == number and group.gr_name == me.pw_name and not others


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
