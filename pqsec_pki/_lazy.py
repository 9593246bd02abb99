"""Rooms that load a module when one of its names is asked for (PEP 562).

A command needs few names of each room. Loading all modules of each room took a third of its time.
"""

import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path

_IMPORT = re.compile(r"^    from (\S+) import (?:\(([^)]*)\)|(.*))$", re.MULTILINE)


def lazy_exports(room: str, init: str) -> Callable[[str], object]:
    """The `__getattr__` of the package `room`, whose `__init__.py` is the file `init`.

    Its names are those that the file imports, below `if TYPE_CHECKING:`, so there is one list for
    type checkers, editors and this function. It is searched as text, since parsing it as Python
    costs as much as is won. No name may be that of a module in the package: the import of that
    module would replace it.
    """

    @cache
    def origins() -> dict[str, tuple[str, str]]:
        """Name -> its module, and its name there."""
        found = {}
        for module, lines, line in _IMPORT.findall(Path(init).read_text("utf-8")):
            for each in (lines or line).replace(",", "\n").splitlines():
                there, _, name = each.strip().partition(" as ")
                found[name or there] = (module, there)
        return found

    def exported(name: str) -> object:
        if name not in origins():
            message = f"module {room!r} has no attribute {name!r}"
            raise AttributeError(message)
        module, there = origins()[name]
        if module == room:
            return import_module(f"{room}.{there}")
        return getattr(import_module(module), there)

    return exported
