"""`dataclass` of the standard library, without what it costs to make a class.

`dataclasses` compiles six functions for each frozen class: a millisecond, which each command paid
for a hundred classes. Here the fields are read when they are asked for, `__init__` is compiled
when many values are made, and the other methods are closures.
"""

import dataclasses
import sys
from collections.abc import Callable
from functools import cache, partial
from operator import attrgetter
from reprlib import recursive_repr
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass  # noqa: PLC0414, TID251 -- for type checkers

_Kind = type[Any]
_Methods = dict[str, Callable[..., Any] | None]
_MISSING, _FIELD = dataclasses.MISSING, dataclasses._FIELD  # type: ignore[attr-defined] # noqa: SLF001
_READ = ("__dataclass_fields__", "__dataclass_params__", "__match_args__")
_OF_PLAIN = {"__dict__", "__weakref__"}
"""Attributes that a class with slots does not have."""
_FEW = 50
"""Up to this number of values, compiling `__init__` takes longer than it saves."""


def _dataclass(
    *,
    frozen: bool = False,
    eq: bool = True,
    slots: bool = False,
    weakref_slot: bool = False,
    kw_only: bool = False,
) -> Callable[[_Kind], _Kind]:
    """Like `dataclasses.dataclass`, for a class that defines none of the generated methods."""

    def decorated(plain: _Kind) -> _Kind:
        types = _annotations(plain)
        names = [name for name, type_ in types.items() if not _is_of_class(type_)]
        defaults = {name: plain.__dict__[name] for name in types if name in plain.__dict__}
        kind = _with_slots(plain, names, weakref=weakref_slot) if slots else plain
        if not slots:
            _set_defaults(kind, defaults)
        own = {name: types[name] for name in names}
        make = partial(_read_fields, kind, own, defaults, frozen=frozen, kw_only=kw_only)
        for name in _READ:
            setattr(kind, name, _Later(name, make))
        methods: _Methods = {"__init__": _first_init(kind, frozen=frozen), "__repr__": _repr}
        methods |= _comparing(kind, frozen=frozen) if eq else {}
        methods |= _FROZEN if frozen else {}
        for name, method in methods.items():
            setattr(kind, name, method)
        return kind

    return decorated


if not TYPE_CHECKING:
    dataclass = _dataclass


def _annotations(plain: _Kind) -> dict[str, Any]:
    """The annotations of the class itself. Python 3.14 and later evaluate them when they are
    read."""
    if sys.version_info >= (3, 14):
        import annotationlib  # noqa: PLC0415 -- not in older Pythons

        return annotationlib.get_annotations(plain, format=annotationlib.Format.FORWARDREF)
    return plain.__annotations__


def _is_of_class(type_: object) -> bool:
    """Whether it is a ClassVar, so not a field."""
    if isinstance(type_, str):
        return type_.startswith("ClassVar")
    return getattr(type_, "__origin__", type_) is ClassVar


def _with_slots(plain: _Kind, names: list[str], *, weakref: bool) -> _Kind:
    """The class made again, with slots for the fields that its bases have none for."""
    inherited = {each for base in plain.__mro__[1:-1] for each in _slots(base)}
    own = [*names, "__weakref__"] if weakref else names
    content = {name: value for name, value in plain.__dict__.items() if name not in _OF_PLAIN}
    for name in names:
        content.pop(name, None)
    content["__slots__"] = tuple(name for name in own if name not in inherited)
    meta: Callable[..., _Kind] = type(plain)
    kind = meta(plain.__name__, plain.__bases__, content)
    kind.__qualname__ = plain.__qualname__
    return kind


def _slots(base: _Kind) -> tuple[str, ...]:
    found = base.__dict__.get("__slots__", ())
    return (found,) if isinstance(found, str) else tuple(found)


def _set_defaults(kind: _Kind, defaults: dict[str, Any]) -> None:
    """Replace each `field(...)` of the class by its default, or remove it."""
    for name, value in defaults.items():
        if isinstance(value, dataclasses.Field):
            if value.default is _MISSING:
                delattr(kind, name)
            else:
                setattr(kind, name, value.default)


class _Later:
    """An attribute of a class that `make` replaces when it is first read."""

    def __init__(self, name: str, make: Callable[[], None]) -> None:
        self._name, self._make = name, make

    def __get__(self, _: object, kind: _Kind) -> Any:
        self._make()
        return getattr(kind, self._name)


def _read_fields(
    kind: _Kind, types: dict[str, Any], defaults: dict[str, Any], *, frozen: bool, kw_only: bool
) -> None:
    """Set what the library's functions, and its decorator of a subclass, read of a class."""
    found: dict[str, Any] = {}
    for base in kind.__mro__[:0:-1]:
        found |= getattr(base, "__dataclass_fields__", {})
    for name, type_ in types.items():
        found[name] = _field(name, type_, defaults.get(name, _MISSING), kw_only=kw_only)
    kind.__dataclass_fields__ = found
    kind.__dataclass_params__ = SimpleNamespace(frozen=frozen)
    fields = dataclasses.fields(kind)
    places = tuple(each.name for each in fields if each.init and not each.kw_only)
    kind.__match_args__ = places  # type: ignore[misc] # mypy knows it as a constant


def _field(name: str, type_: Any, value: Any, *, kw_only: bool) -> Any:
    """The field as `dataclasses` makes it; `value` is its default, or the result of `field`."""
    made: Any = value if isinstance(value, dataclasses.Field) else dataclasses.field(default=value)
    made.name, made.type = name, type_
    made._field_type = _FIELD  # noqa: SLF001 -- what `fields` looks for
    if made.kw_only is _MISSING:
        made.kw_only = kw_only
    return made


def _first_init(kind: _Kind, *, frozen: bool) -> Callable[..., None]:
    """An `__init__` for the first values; a compiled one replaces it later."""
    made = 0

    def first(self: Any, *args: Any, **values: Any) -> None:
        nonlocal made
        made += 1
        if made > _FEW or not _fill(self, kind, args, values):
            kind.__init__ = _init(kind, frozen=frozen)
            kind.__init__(self, *args, **values)

    return first


def _fill(value: Any, kind: _Kind, args: tuple[Any, ...], given: dict[str, Any]) -> bool:
    """Set the fields of a new value; False for arguments that its `__init__` refuses."""
    places = kind.__match_args__
    if len(args) > len(places) or not given.keys().isdisjoint(places[: len(args)]):
        return False
    left = dict(zip(places, args, strict=False)) | given
    for each in dataclasses.fields(kind):
        if each.init and each.name in left:
            content = left.pop(each.name)
        elif each.default is not _MISSING:
            content = each.default
        elif each.default_factory is not _MISSING:
            content = each.default_factory()
        elif each.init:
            return False
        else:
            continue
        object.__setattr__(value, each.name, content)
    if not left and hasattr(kind, "__post_init__"):
        value.__post_init__()
    return not left


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
    """`__eq__` and `__hash__`, by the fields that are compared; `hash=False` leaves out one."""

    @cache
    def values(*, hashing: bool = False) -> Callable[[Any], Any]:
        fields = [each for each in dataclasses.fields(kind) if each.compare]
        names = [each.name for each in fields if not hashing or each.hash is not False]
        return attrgetter(*names) if names else lambda _: ()

    def equal(self: Any, other: object) -> Any:
        if other.__class__ is not self.__class__:
            return NotImplemented
        return values()(self) == values()(other)

    def hashed(self: Any) -> int:
        return hash(values(hashing=True)(self))

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
    """The state that pickle and copy pass to `_restore`, because attributes cannot be set."""
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
