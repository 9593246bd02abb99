"""`dataclass` of the standard library, without compiling its methods when a class is made.

`dataclasses` compiles six functions for each frozen class: a millisecond, which each command paid
for a hundred classes. Here `__init__` is compiled when the first value is made, and the others are
closures.
"""

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass  # noqa: PLC0414, TID251 -- for type checkers

_Kind = type[Any]
_Methods = dict[str, Callable[..., Any] | None]
_MISSING = dataclasses.MISSING


def _dataclass(
    *, frozen: bool = False, eq: bool = True, **others: bool
) -> Callable[[_Kind], _Kind]:
    """As `dataclasses.dataclass` with these options, for a class without methods of these names."""

    def decorated(plain: _Kind) -> _Kind:
        plain.__doc__ = plain.__doc__ or plain.__name__  # without one, inspect makes a signature
        inherits = frozen and any(map(_is_frozen, plain.__bases__))
        kind = dataclasses.dataclass(  # noqa: TID251 -- its fields and slots
            init=False, repr=False, eq=False, frozen=inherits, **others
        )(plain)
        kind.__dataclass_params__.frozen = frozen  # a class of the library may inherit from it
        methods: _Methods = {"__init__": _first_init(kind, frozen=frozen), "__repr__": _repr}
        methods |= _comparing(kind, frozen=frozen) if eq else {}
        methods |= _FROZEN if frozen else {}
        for name, method in methods.items():
            setattr(kind, name, method)
        return kind

    return decorated


if not TYPE_CHECKING:
    dataclass = _dataclass


def _is_frozen(kind: _Kind) -> bool:
    return dataclasses.is_dataclass(kind) and bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]


def _first_init(kind: _Kind, *, frozen: bool) -> Callable[..., None]:
    """An `__init__` that replaces itself."""

    def first(self: Any, *args: Any, **values: Any) -> None:
        kind.__init__ = _init(kind, frozen=frozen)
        kind.__init__(self, *args, **values)

    return first


def _init(kind: _Kind, *, frozen: bool) -> Callable[..., None]:
    """The `__init__` that dataclasses would compile; names with two underscores are its own."""
    found = dataclasses.fields(kind)
    names: dict[str, Any] = {"__put": object.__setattr__, "__missing": _MISSING}
    names |= {f"__{each.name}": each.default_factory for each in found}
    names |= {f"__{each.name}": each.default for each in found if each.default is not _MISSING}
    ordered = [_parameter(each) for each in found if each.init and not each.kw_only]
    by_name = [_parameter(each) for each in found if each.init and each.kw_only]
    put = "__put(self, {!r}, {})" if frozen else "self.{} = {}"
    lines = [
        put.format(each.name, _value(each))
        for each in found
        if each.init or names[f"__{each.name}"] is not _MISSING
    ]
    if hasattr(kind, "__post_init__"):
        lines.append("self.__post_init__()")
    head = ", ".join(["self", *ordered, *(["*", *by_name] if by_name else [])])
    text = "\n ".join([f"def __init__({head}):", *lines, "pass"])
    exec(compile(text, f"<{kind.__qualname__}>", "exec"), names)  # noqa: S102 -- as dataclasses does
    made: Callable[..., None] = names["__init__"]
    return made


def _parameter(field: "dataclasses.Field[Any]") -> str:
    name = field.name
    if field.default is not _MISSING:
        return f"{name}=__{name}"
    return f"{name}=__missing" if field.default_factory is not _MISSING else name


def _value(field: "dataclasses.Field[Any]") -> str:
    name = field.name
    if field.default_factory is _MISSING:
        return name if field.init else f"__{name}"
    return f"__{name}() if {name} is __missing else {name}" if field.init else f"__{name}()"


def _comparing(kind: _Kind, *, frozen: bool) -> _Methods:
    """`__eq__` and `__hash__`, by the fields that are compared."""
    compared = [each.name for each in dataclasses.fields(kind) if each.compare]
    values = attrgetter(*compared) if compared else lambda _: ()

    def equal(self: Any, other: object) -> Any:
        return (
            values(self) == values(other) if other.__class__ is self.__class__ else NotImplemented
        )

    def hashed(self: Any) -> int:
        return hash(values(self))

    return {"__eq__": equal, "__hash__": hashed if frozen else None}


@recursive_repr()
def _repr(self: Any) -> str:
    shown = [each.name for each in dataclasses.fields(self) if each.repr]
    values = ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)
    return f"{self.__class__.__qualname__}({values})"


def _refuse(_: object, name: str, *__: object) -> None:
    message = f"cannot assign to field {name!r}"
    raise dataclasses.FrozenInstanceError(message)


def _state(self: Any) -> list[object]:
    """What pickle and copy pass to `_restore`, because attributes cannot be set."""
    return [getattr(self, each.name) for each in dataclasses.fields(self)]


def _restore(self: Any, state: list[object]) -> None:
    for each, value in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, each.name, value)


_FROZEN: _Methods = {
    "__setattr__": _refuse,
    "__delattr__": _refuse,
    "__getstate__": _state,
    "__setstate__": _restore,
}
