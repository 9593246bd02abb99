"""Find out which other users could change a folder or file, like sshd's StrictModes.

A user who can write in a folder can put a link where the next command expects a file. So
folders and files must belong to the caller, and must not be writable for others (mode o+w) or
for a group. The caller's private group is allowed: Debian and others give each user one.
"""

import grp
import os
import pwd
import stat
from functools import cache
from shlex import quote

from pqsec_pki.errors import UsageError

OPERATOR = "PQSEC_OPERATOR"
MAX_OPERATOR = 64
"""Characters."""


def outsider(found: os.stat_result, *, roots: bool = False, sticky: bool = False) -> str:
    """Which other user could change the file with the status `found`, in words; empty if none.

    With `roots`, a file of the superuser is accepted like the caller's own; with `sticky`, a
    sticky folder such as /tmp is accepted, since users cannot replace files of others there.
    """
    if found.st_uid != os.geteuid() and not (roots and found.st_uid == 0):
        return f"it belongs to another user ({user(found.st_uid)})"
    if stat.S_ISLNK(found.st_mode) or (sticky and found.st_mode & stat.S_ISVTX):
        return ""  # the mode of a link has no meaning
    if found.st_mode & stat.S_IWOTH:
        return "anybody may write there"
    if found.st_mode & stat.S_IWGRP and not _is_private(found.st_gid):
        return f"group {_group(found.st_gid)} may write there"
    return ""


def way_out(found: os.stat_result, path: str) -> str:
    """How to fix what `outsider` reports, for a hint."""
    if found.st_uid == os.geteuid():
        return f"chmod go-w {quote(path)}"
    owner = user(found.st_uid)
    if os.geteuid() == 0:
        return f"run the command as its owner, `sudo -u {owner} pqsec ...`; or chown it"
    return f"only {owner} may change it; work on a copy of your own"


@cache
def user(number: int) -> str:
    """The user's name, or text such as `uid 1000` if there is none."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return f"uid {number}"


def operator() -> str:
    """The operator of this process, for permanent records: PQSEC_OPERATOR, else the user's name.

    UsageError for a value that is too long or not printable.
    """
    chosen = os.environ.get(OPERATOR, "")
    if len(chosen) > MAX_OPERATOR or not chosen.isprintable():
        raise UsageError(f"{OPERATOR} is not a name of up to {MAX_OPERATOR} printable characters")
    return chosen or user(os.getuid())


@cache
def _is_private(number: int) -> bool:
    """Whether it is the caller's private group: of the same name, without other members."""
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
