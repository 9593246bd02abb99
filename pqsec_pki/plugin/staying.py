"""When an agent without hosts keeps running, so that the next participant waits only for a fork.

It has no workers and no keys. It ends when its socket is removed, as after a logout, or when
another version of its program may be installed, since it would load modules of both. It then
accepts no further hosts: it may have flaws that the other version does not have.
"""

import gc
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cryptography

import pqsec_pki
from pqsec_pki._files import file_version

_MAPS = Path("/proc/self/maps")
_GONE = b" (deleted)"
"""The end of a line there, if the file was removed or replaced (proc_pid_maps(5))."""


def staying(socket: Path) -> Callable[[], bool]:
    """Whether the agent that listens at `socket` still does, with the program that is installed."""
    watched, is_old = [socket, *_program()], replaced()
    before = [file_version(path) for path in watched]
    return lambda: before == [file_version(path) for path in watched] and not is_old()


def replaced() -> Callable[[], bool]:
    """Whether another pqsec was installed since this call, or a library that is in memory."""
    package = Path(pqsec_pki.__file__)
    before, gone = file_version(package), _gone_libraries()

    def is_old() -> bool:
        return file_version(package) not in {before, ()} or not _gone_libraries() <= gone

    return is_old


def _gone_libraries() -> set[bytes]:
    """The programs and libraries in memory whose files were replaced or removed."""
    with suppress(OSError):
        maps = _MAPS.read_bytes()
        if _GONE in maps:  # seldom, and each host waits for this
            return {line[line.find(b"/") :] for line in maps.splitlines() if _is_gone(line)}
    return set()


def _is_gone(line: bytes) -> bool:
    return line.endswith(_GONE) and b" r-xp " in line and b"/memfd:" not in line


def _program() -> set[Path]:
    """Files and folders that an installation of pqsec or cryptography replaces or changes."""
    files = {Path(module.__file__ or "") for module in (pqsec_pki, cryptography)}
    return files | {file.parents[1] for file in files}


def load_the_rest(note: Callable[[str], None]) -> None:
    """Load what the first participant's worker loaded for itself, for all later workers."""
    from pqsec_pki.documents import load_schemas  # noqa: PLC0415 -- it is not for the start

    try:
        load_schemas()
        gc.freeze()
    except Exception as error:  # noqa: BLE001 -- it may be replaced now; workers that need it report it
        note(f"later workers load it themselves: {error}")
