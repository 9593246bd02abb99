"""Refuse places that another user could change: files that pqsec obeys, signs or runs, and folders.

A user who can write in a folder above could rename what is below, and put something else in its
place. So each folder and link on the way is looked at, once: like the place itself it must be the
caller's, or root's, and others may not write there, except in a sticky folder such as /tmp.
"""

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import FileVersion, noted
from pqsec_pki._owners import outsider, way_out
from pqsec_pki.errors import FileError, PqsecError

MOST_LINKS = 40
"""On one path, as Linux."""
_KINDS = {stat.S_IFREG, stat.S_IFDIR, stat.S_IFIFO, stat.S_IFSOCK}
"""What can be replaced or filled by others; a terminal or /dev/null is the caller's choice."""


@dataclass(frozen=True, slots=True)
class OpenPlace:
    """A place that another user could change."""

    path: str
    who: str
    """Which user, as part of a sentence."""
    remedy: str
    """How to fix it."""


def open_place(
    path: Path, *, roots: bool = False, owner: int | None = None, known: set[Path] | None = None
) -> OpenPlace | None:
    """The first place on the way to `path` that another user could change; None if there is none.

    `path` itself may be root's only with `roots`; folders and links above may always be. All may be
    of the user `owner`. The way to folders in `known` is not looked at again; this one is added.
    What does not exist is nobody's: it will be made in a folder that was looked at.
    """
    known = set() if known is None else known
    try:
        path = path.absolute()
    except OSError:  # the working folder was removed: nothing is there
        return None
    for place, found, is_last in _way_to(path, is_known=path.parent in known):
        above = not is_last
        if is_last and stat.S_IFMT(found.st_mode) not in _KINDS:
            continue
        if who := outsider(found, str(place), roots=roots or above, sticky=above, owner=owner):
            return OpenPlace(str(place), who, way_out(found, str(place)))
    known.add(path.parent)
    return None


def refuse_outsiders(
    paths: Iterable[Path],
    words: str,
    *,
    roots: bool = False,
    instead: str = "",
    error: type[PqsecError] = FileError,
) -> None:
    """`error`, with `words`, if another user could change one of the places; see `open_place`.

    `instead` says what else the user can do.
    """
    known = set[Path]()
    for path in paths:
        if found := open_place(path, roots=roots, known=known):
            hint = f"{found.remedy}; {instead}" if instead else found.remedy
            raise error(f"{found.path}: {found.who}; {words}", hint=hint)


def make_folders(folder: Path, mode: int) -> None:
    """Create `folder` and missing folders above it with that mode, whatever the umask is.

    An existing folder stays as it is. OSError if that fails.
    """
    for each in (*reversed(folder.parents), folder):
        if not each.is_dir():
            try:
                each.mkdir(mode=mode)
                each.chmod(mode)
            except FileExistsError:
                if each.is_dir():  # another process made it
                    continue
                if each == folder:
                    raise
                code = errno.ENOTDIR
                raise NotADirectoryError(code, os.strerror(code), str(folder)) from None


@contextmanager
def trusted_files(what: str) -> Iterator[None]:
    """FileError if another user could change a file that is read within: it decides `what`."""
    seen: dict[Path, FileVersion] = {}
    with noted(seen):
        yield
    refuse_obeyed(seen, what)


def refuse_obeyed(paths: Iterable[Path], what: str) -> None:
    """FileError if another user than root could change one of these files, which decide `what`."""
    refuse_outsiders(paths, f"anyone who may write there decides {what}", roots=True)


def _way_to(path: Path, *, is_known: bool) -> Iterator[tuple[Path, os.stat_result, bool]]:
    """The folders and links that lead to `path`, from the root on, and what is there at last.

    Each with its status, and whether it is the last. Links are followed, wherever they are. What
    does not exist, or cannot be reached, ends it: whoever reads or makes it gets the reason. If the
    folder of `path` is known, and `path` is not a link, only the last.
    """
    here, links = Path("/"), 0
    rest = _parts(os.fspath(path))
    if is_known and rest and rest[0] != ".." and not os.path.islink(path):  # noqa: PTH114 -- never raises
        here, rest = path.parent, rest[:1]
    else:
        yield here, here.lstat(), not rest
    while rest:
        name = rest.pop()
        if name == "..":
            here = here.parent
            continue
        place = here / name
        try:
            found = place.lstat()
            target = str(place.readlink()) if stat.S_ISLNK(found.st_mode) else None
        except (OSError, ValueError):
            return
        yield place, found, target is None and not rest
        if target is None:
            here = place
        elif (links := links + 1) <= MOST_LINKS:
            here = Path("/") if target.startswith("/") else here
            rest += _parts(target)
        else:
            return


def _parts(path: str) -> list[str]:
    """The parts of the path, the last one first."""
    return [part for part in reversed(path.split("/")) if part not in {"", "."}]
