"""Our `dataclass` does what that of the standard library does."""

import copy
import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest

import pqsec_pki
from pqsec_pki._dataclass import dataclass

OURS: Any = dataclass
BOTH = pytest.mark.parametrize("decorator", [OURS, dataclasses.dataclass], ids=["ours", "theirs"])
FROZEN = {"frozen": True, "slots": True}


def made(decorator, **options):
    @decorator(**options)
    class Point:
        x: int
        y: int = 2
        tags: list[str] = dataclasses.field(default_factory=list)
        secret: bytes = dataclasses.field(default=b"", repr=False, kw_only=True)
        seen: int = dataclasses.field(default=0, compare=False, kw_only=True)
        kind: ClassVar[str] = "point"

    return Point


@dataclass(frozen=True, slots=True)
class Sent:
    """To another process."""

    name: str
    data: bytes = dataclasses.field(repr=False)


@BOTH
@pytest.mark.parametrize("options", [FROZEN, {"frozen": True}, {"slots": True}, {}], ids=str)
def test_values_are_made_shown_and_compared(decorator, options):
    point = made(decorator, **options)
    first, second = point(1, secret=b"s"), point(1, 2, [], secret=b"s", seen=5)
    assert (first.x, first.y, first.tags, first.secret, first.kind) == (1, 2, [], b"s", "point")
    assert first == second != point(2, secret=b"s")
    assert first.__eq__((1, 2)) is NotImplemented
    assert first.tags is not second.tags
    assert str(first) == "made.<locals>.Point(x=1, y=2, tags=[], seen=0)"
    assert [each.name for each in dataclasses.fields(point)] == ["x", "y", "tags", "secret", "seen"]
    assert dataclasses.replace(first, y=3).y == 3
    assert dataclasses.astuple(first) == (1, 2, [], b"s", 0)
    assert point.__match_args__ == ("x", "y", "tags")
    assert hasattr(first, "__dict__") is ("slots" not in options)


@BOTH
@pytest.mark.parametrize("values", [(), (1, 2, [], b""), (1, 2, [], 4, 5, 6)])
def test_wrong_values_are_refused_by_the_first_and_by_later_calls(decorator, values):
    point = made(decorator, **FROZEN)
    for _ in range(2):
        with pytest.raises(TypeError, match="argument"):
            point(*values)
        with pytest.raises(TypeError, match="unexpected keyword argument 'z'"):
            point(1, z=2)


@BOTH
@pytest.mark.parametrize("slots", [True, False])
def test_a_frozen_value_cannot_be_changed(decorator, slots):
    value = made(decorator, frozen=True, slots=slots)(1)
    for name in ("x", "kind", "other"):
        with pytest.raises((dataclasses.FrozenInstanceError, TypeError)):
            setattr(value, name, 3)
    with pytest.raises(dataclasses.FrozenInstanceError, match="'x'"):
        value.x = 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        del value.x
    assert value.x == 1


@BOTH
def test_a_field_without_hash_is_compared_and_not_hashed(decorator):
    @decorator(**FROZEN)
    class Found:
        name: str
        stacks: dict[str, str] = dataclasses.field(hash=False)

    one, other = Found("x", {"a": "1"}), Found("x", {})
    assert one != other
    assert hash(one) == hash(other)


@BOTH
def test_a_value_is_hashed_if_it_is_frozen_and_compared(decorator):
    assert hash(row(decorator, **FROZEN)(1)) == hash(row(decorator, **FROZEN)(1))
    with pytest.raises(TypeError, match="unhashable"):
        hash(row(decorator, slots=True)(1))
    same = row(decorator, **FROZEN, eq=False)
    assert same(1) != same(1)
    assert len({same(1), same(1)}) == 2


def row(decorator, **options):
    @decorator(**options)
    class Row:
        number: int
        note: str = dataclasses.field(default="", compare=False)

    return Row


@BOTH
def test_a_class_has_the_fields_of_its_base_and_its_own_check(decorator):
    base = row(decorator, **FROZEN)

    @decorator(**FROZEN, kw_only=True)
    class Checked(base):
        half: float = dataclasses.field(init=False, default=0.5)
        made: list[int] = dataclasses.field(init=False, default_factory=list)
        unset: int = dataclasses.field(init=False)
        more: int

        def __post_init__(self):
            if self.number < 0:
                raise ValueError(self.number)

    value = Checked(4, "note", more=1)
    assert (value.number, value.note, value.more, value.half, value.made) == (4, "note", 1, 0.5, [])
    assert not hasattr(value, "unset")
    assert base(4, "note") != value
    with pytest.raises(ValueError, match="-1"):
        Checked(-1, more=1)
    assert base(-1).number == -1


def test_a_frozen_value_goes_to_another_process_and_is_copied():
    value = Sent("key", b"secret")
    sent = pickle.loads(pickle.dumps(value))  # noqa: S301 -- our own
    assert sent == copy.deepcopy(value) == copy.copy(value) == value


def test_a_value_without_fields_and_one_that_contains_itself():
    @dataclass(frozen=True, slots=True)
    class Nothing:
        """No fields."""

    @dataclass(slots=True)
    class Ring:
        next: object = None

    ring = Ring()
    ring.next = ring
    assert Nothing() == Nothing()
    assert hash(Nothing()) == hash(Nothing())
    assert str(ring).endswith("Ring(next=...)")


def test_a_class_costs_nothing_before_it_is_used_and_is_compiled_for_many_values():
    """Each command makes hundreds of classes, of most of them no value, of others a few."""
    point = made(OURS, **FROZEN)
    own = vars(point)
    assert not isinstance(own["__dataclass_fields__"], dict)
    for each in range(60):
        compiled = not own["__init__"].__code__.co_filename.endswith("_dataclass.py")
        assert compiled is (each > 50)
        assert (point(each).x, point.__match_args__) == (each, ("x", "y", "tags"))
    assert isinstance(own["__dataclass_fields__"], dict)


def test_no_class_of_the_package_has_compiled_methods_before_its_first_value():
    code = (
        "import pqsec_pki.documents.permissions as p; print(p.Grant.__init__.__code__.co_filename)"
    )
    root = str(Path(pqsec_pki.__file__).parents[1])
    ran = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=root
    )
    assert ran.stdout.strip().endswith("_dataclass.py")


@pytest.mark.parametrize("first", [OURS, dataclasses.dataclass], ids=["ours", "theirs"])
@pytest.mark.parametrize("second", [OURS, dataclasses.dataclass], ids=["ours", "theirs"])
def test_each_may_inherit_from_the_other(first, second):
    """A package with an algorithm of its own inherits from our rows, with the library's."""

    @first(**FROZEN, kw_only=True)
    class Row:
        name: str
        level: int = 0

    @second(**FROZEN, kw_only=True)
    class Own(Row):
        secret: bytes = dataclasses.field(default=b"", repr=False)

    own = Own(name="x", secret=b"s")
    assert (own, own.level, own.secret) == (Own(name="x", secret=b"s"), 0, b"s")
    assert dataclasses.replace(own, level=3).level == 3
    assert repr(own).endswith("Own(name='x', level=0)")
    with pytest.raises(dataclasses.FrozenInstanceError):
        own.level = 1
    with pytest.raises(TypeError, match="frozen"):

        @dataclasses.dataclass
        class Changeable(Row):
            more: int = 0
