"""Rooms that load a module when one of its names is asked for (PEP 562).

A command needs few names of each room. Loading all modules of each room took a third of its time.
"""

from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

_PYC_HEADER = 16
"""Bytes before the code (PEP 552)."""


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
        path = Path(init)
        for module, there, name in _in_source(path) if path.suffix == ".py" else _in_bytecode(path):
            found[name] = (module, there)
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


def _in_source(path: Path) -> Iterator[tuple[str, str, str]]:
    """Module, name there and name here of each import in a room's `__init__.py`."""
    for statement in path.read_text("utf-8").split("\n    from ")[1:]:
        module, _, names = statement.partition(" import ")
        end = ")" if names.startswith("(") else "\n"
        for each in names.partition(end)[0].lstrip("(").split(","):
            there, _, name = each.strip().partition(" as ")
            if there:
                yield module, there, name or there


def _in_bytecode(path: Path) -> Iterator[tuple[str, str, str]]:
    """Like `_in_source`, read from the `.pyc`, in installations without sources."""
    import dis  # noqa: PLC0415 -- few installations need it
    import marshal  # noqa: PLC0415 -- likewise

    module = there = ""
    for each in dis.get_instructions(marshal.loads(path.read_bytes()[_PYC_HEADER:])):  # noqa: S302 -- our own module
        if each.opname == "IMPORT_NAME":
            module, there = each.argval, ""
        elif each.opname == "IMPORT_FROM":
            there = each.argval
        elif each.opname == "STORE_NAME" and there:
            yield module, there, each.argval
            there = ""
