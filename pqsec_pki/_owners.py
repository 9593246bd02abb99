"""Find out which other users could change a folder or file, like sshd's StrictModes.

A user who can write in a folder can put a link where the next command expects a file. So
folders and files must belong to the caller, and must not be writable for others (mode o+w) or
for a group, also by a POSIX access control list. The caller's private group is allowed: Debian
and others give each user one. `_places.py` looks at a whole path.
"""

import errno
import grp
import os
import pwd
import stat
from contextlib import suppress
from functools import cache
from pathlib import Path
from shlex import quote
from struct import Struct

from pqsec_pki.errors import UsageError

OPERATOR = "PQSEC_OPERATOR"
MAX_OPERATOR = 64
"""Characters."""

_OVERFLOW = 65534
"""What Linux shows for users that a namespace does not have, unless it is told otherwise."""

# An access control list as the kernel gives it: posix_acl_xattr.h of Linux, acl(5).
_ACCESS_LIST = "system.posix_acl_access"
_HEADER, _ENTRY = Struct("<I"), Struct("<HHI")
_ACL_VERSION = 2
_USER, _GROUP_OWNER, _GROUP = 0x02, 0x04, 0x08
_WRITE = 0o2


def outsider(
    found: os.stat_result,
    place: str | int,
    *,
    roots: bool = False,
    sticky: bool = False,
    owner: int | None = None,
) -> str:
    """Which other user could change what has the status `found`, in words; empty if none.

    `place` is its path, or the descriptor of an open file: its access control list is read there.
    With `roots`, a file of the superuser is accepted like the caller's own; with `sticky`, a
    sticky folder such as /tmp is accepted, since users cannot replace files of others there. A file
    of the user `owner` is accepted too.
    """
    others = found.st_uid not in {os.geteuid(), owner}
    if others and not (roots and found.st_uid in {0, _unknown_user()}):
        return f"it belongs to another user ({user(found.st_uid)})"
    if stat.S_ISLNK(found.st_mode) or (sticky and found.st_mode & stat.S_ISVTX):
        return ""  # the mode of a link has no meaning
    if found.st_mode & stat.S_IWOTH:
        return "anybody may write there"
    if found.st_mode & stat.S_IWGRP and (who := _of_groups(found, place)):
        return f"{who} may write there"
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


def _of_groups(found: os.stat_result, place: str | int) -> str:
    """Who may write by the group's bits.

    If there is an access control list, they are its mask: an entry allows what the mask allows too.
    """
    try:
        entries = _access_list(place)
    except OSError:
        return "who its access control list names"
    own = (_GROUP_OWNER, _WRITE, found.st_gid)
    for kind, rights, number in entries or [own]:
        if not rights & _WRITE:
            continue
        if kind == _USER and number not in {os.geteuid(), 0}:
            return f"{user(number)}, by its access control list,"
        group = found.st_gid if kind == _GROUP_OWNER else number
        if kind in {_GROUP_OWNER, _GROUP} and not _is_private(group):
            return f"group {_group(group)}"
    return ""


def _access_list(place: str | int) -> list[tuple[int, int, int]]:
    """The entries of a POSIX access control list: kind, rights, user or group.

    Empty if there is none, as on file systems without them. OSError if it cannot be read.
    """
    try:
        follow = {} if isinstance(place, int) else {"follow_symlinks": False}
        data = os.getxattr(place, _ACCESS_LIST, **follow)
    except OSError as error:
        if error.errno in {errno.ENODATA, errno.ENOTSUP}:
            return []
        raise
    if len(data) % _ENTRY.size != _HEADER.size or _HEADER.unpack_from(data) != (_ACL_VERSION,):
        raise OSError(errno.EINVAL, "not an access control list")
    return list(_ENTRY.iter_unpack(data[_HEADER.size :]))


@cache
def _is_private(number: int) -> bool:
    """Whether it is the caller's private group: of the same name, without other members.

    Members are users that the group names, and those whose primary group it is. A directory may
    not list its users (as sssd with `enumerate = false`); if the caller is not listed, others may
    be missing too, and the group is not taken for private.
    """
    try:
        me, group = pwd.getpwuid(os.geteuid()), grp.getgrgid(number)
    except KeyError:
        return False
    users = pwd.getpwall()
    mine = {0, me.pw_uid}
    first = {each.pw_uid for each in users if each.pw_gid == number}
    named = {name for each in grp.getgrall() if each.gr_gid == number for name in each.gr_mem}
    named -= {each.pw_name for each in users if each.pw_uid in mine}
    private = me.pw_gid == number and group.gr_name == me.pw_name
    return private and me.pw_uid in first and first <= mine and not named


@cache
def _unknown_user() -> int:
    """What stands for users that this user namespace does not have, as the host's root; else 0.

    The root of a container without real privileges sees the host's folders so. Nobody inside it can
    be that user. 0 if the namespace has a user of that number, who may be meant.
    """
    number = _OVERFLOW
    with suppress(OSError):  # a service of systemd may not see it
        number = int(Path("/proc/sys/kernel/overflowuid").read_text("ascii"))
    try:
        lines = Path("/proc/self/uid_map").read_text("ascii").splitlines()
    except OSError:
        return 0
    ranges = [(int(first), int(count)) for first, _, count in map(str.split, lines)]
    return 0 if any(first <= number < first + count for first, count in ranges) else number


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)
