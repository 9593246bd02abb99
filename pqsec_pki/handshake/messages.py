"""The messages of a handshake as values, converted to data holders and back.

Decoding reads properties by name, and refuses missing or repeated ones and wrong sizes.
Values keep the octets as received, because the hashes cover these.
"""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, ClassVar, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import VerificationError, shown
from pqsec_pki.handshake import compact
from pqsec_pki.handshake.compact import WireVersion
from pqsec_pki.handshake.wire import BinaryProperty, DataHolder, encode_properties
from pqsec_pki.problems import Code, Problem

AUTHENTICATION = "DDS:Auth:PKI-DH:1.0"
HASH_SIZE = 32
CHALLENGE_SIZE = 32
_OWN_PREFIX = "c."
_SIZES = {
    "hash_c1": HASH_SIZE,
    "hash_c2": HASH_SIZE,
    "challenge1": CHALLENGE_SIZE,
    "challenge2": CHALLENGE_SIZE,
    "future_challenge": CHALLENGE_SIZE,
}
_ALGORITHMS = {"c.dsign_algo": Code.C16, "c.kagree_algo": Code.C8}
"""Properties with algorithm names, with the number of the check for the name."""
_LIMITED = (*_SIZES, *_ALGORITHMS)
_LONGEST_NAME = 64
"""Bytes. Algorithm names are shorter, and error messages quote the name."""


@dataclass(frozen=True, slots=True)
class Introduction:
    """The c. properties of a Request or Reply: identity and algorithms (9.3.2.5.1, table 49)."""

    NAMES: ClassVar[tuple[str, ...]] = (
        "c.id",
        "c.perm",
        "c.pdata",
        "c.dsign_algo",
        "c.kagree_algo",
    )

    certificate: bytes
    """PEM, with or without a NUL."""
    permissions: bytes
    """The signed permissions document, with or without a NUL."""
    participant_data: bytes
    """A big-endian parameter list that has the GUID."""
    signature_algorithm: bytes
    key_agreement: bytes
    version: WireVersion = WireVersion.FIRST
    """The version of the message that it is in."""

    @property
    def properties(self) -> tuple[BinaryProperty, ...]:
        return (
            ("c.id", self.certificate),
            ("c.perm", self.permissions),
            ("c.pdata", self.participant_data),
            ("c.dsign_algo", self.signature_algorithm),
            ("c.kagree_algo", self.key_agreement),
        )

    @classmethod
    def of(cls, found: Mapping[str, bytes], version: WireVersion) -> Self:
        """The introduction in the binary properties `found`, which have all of NAMES."""
        return cls(
            found["c.id"],
            found["c.perm"],
            found["c.pdata"],
            found["c.dsign_algo"],
            found["c.kagree_algo"],
            version,
        )

    @property
    def signature_algorithm_name(self) -> str:
        return _name(self.signature_algorithm)

    @property
    def key_agreement_name(self) -> str:
        return _name(self.key_agreement)

    @property
    def ends_names_in_nul(self) -> bool:
        return self.key_agreement.endswith(b"\0")

    def digest(self) -> bytes:
        """hash_c1 of a Request, hash_c2 of a Reply: 32 bytes."""
        covered = (*self.properties, *self.version.mark)
        return hashlib.sha256(encode_properties(covered)).digest()

    def in_second_version(self) -> Self:
        """This introduction, as a message of the second version has it.

        MalformedError if the permissions are not a signed document that it can carry.
        """
        return replace(
            self,
            permissions=compact.canonical(self.permissions),
            signature_algorithm=self.signature_algorithm.removesuffix(b"\0"),
            key_agreement=self.key_agreement.removesuffix(b"\0"),
            version=WireVersion.SECOND,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Transcript:
    """The six values that both signatures cover, each side's own first."""

    hash_c1: bytes
    hash_c2: bytes
    challenge1: bytes
    challenge2: bytes
    dh1: bytes
    dh2: bytes

    def values(self) -> dict[str, bytes]:
        """The six by name, as Reply and Final repeat them."""
        return {
            "hash_c1": self.hash_c1,
            "hash_c2": self.hash_c2,
            "challenge1": self.challenge1,
            "challenge2": self.challenge2,
            "dh1": self.dh1,
            "dh2": self.dh2,
        }

    def reply_octets(self) -> bytes:
        """What the Reply's signature covers (9.3.2.5.2, table 50)."""
        return encode_properties(
            (
                ("hash_c2", self.hash_c2),
                ("challenge2", self.challenge2),
                ("dh2", self.dh2),
                ("challenge1", self.challenge1),
                ("dh1", self.dh1),
                ("hash_c1", self.hash_c1),
            )
        )

    def final_octets(self) -> bytes:
        """What the Final's signature covers (9.3.2.5.3, table 51)."""
        return encode_properties(
            (
                ("hash_c1", self.hash_c1),
                ("challenge1", self.challenge1),
                ("dh1", self.dh1),
                ("challenge2", self.challenge2),
                ("dh2", self.dh2),
                ("hash_c2", self.hash_c2),
            )
        )

    def differences(self, message: "Reply | Final") -> list[Problem]:
        """One problem for each repeated value in `message` that differs from the original."""
        code = Code.C19 if isinstance(message, Reply) else Code.C23
        return [
            Problem(f"{name} is not as expected", code)
            for name, value in self.values().items()
            if getattr(message, name) not in (None, value)
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Message:
    """Fields are binary properties of the same name, in the order they are sent."""

    CLASS_ID: ClassVar[str]

    @property
    def version(self) -> WireVersion:
        """The version in which it is written."""
        return WireVersion.FIRST

    def without_optional(self) -> Self:
        """The message with only the required properties."""
        return replace(self, **{each.name: None for each in fields(self) if each.default is None})

    def to_holder(self) -> DataHolder:
        items: list[BinaryProperty] = []
        for name in _NAMES[type(self)]:
            value = getattr(self, name)
            if isinstance(value, Introduction):
                items += value.properties
            elif value is not None:
                items.append((name, value))
        if self.version is WireVersion.SECOND:
            return DataHolder(self.CLASS_ID, (), compact.compacted(self.CLASS_ID, dict(items)))
        return DataHolder(self.CLASS_ID, (), tuple(items))

    @classmethod
    def from_holder(
        cls, holder: DataHolder, versions: Collection[WireVersion] = tuple(WireVersion)
    ) -> Self:
        """The message in `holder`; VerificationError lists everything that is wrong.

        One of another version than `versions` is refused before anything in it is expanded.
        """
        found = dict(holder.binary_properties)
        version = WireVersion.FIRST if cls is AuthRequest else compact.version_of(found)
        compact.check_version(version, versions)
        first = version is WireVersion.FIRST
        due = _DUE[cls] if first else compact.names(cls.CLASS_ID)
        problems = [
            *_class_problems(holder, cls.CLASS_ID),
            *_missing_problems(found, due),
            *_double_problems(holder, found),
            *(_unknown_problems(found) if first else _other_problems(found, due)),
        ]
        if not first and not problems:
            found = compact.expanded(cls.CLASS_ID, found)
        problems += _size_problems(found)
        if problems:
            raise VerificationError(*problems)
        values: dict[str, Any] = {name: found.get(name) for name in _NAMES[cls]}
        if "introduction" in values:
            values["introduction"] = Introduction.of(found, version)
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Request(_Message):
    """HandshakeRequestMessageToken (9.3.2.5.1)."""

    CLASS_ID: ClassVar[str] = AUTHENTICATION + "+Req"

    introduction: Introduction
    hash_c1: bytes | None = None
    dh1: bytes
    challenge1: bytes

    @property
    def version(self) -> WireVersion:
        """The version of its introduction."""
        return self.introduction.version


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply(_Message):
    """HandshakeReplyMessageToken (9.3.2.5.2). Fast DDS requires the optional fields too."""

    CLASS_ID: ClassVar[str] = AUTHENTICATION + "+Reply"

    introduction: Introduction
    dh2: bytes
    challenge1: bytes | None
    """None in the second version, which repeats nothing."""
    challenge2: bytes
    dh1: bytes | None = None
    hash_c2: bytes | None = None
    hash_c1: bytes | None = None
    signature: bytes

    @property
    def version(self) -> WireVersion:
        """The version of its introduction."""
        return self.introduction.version


@dataclass(frozen=True, slots=True, kw_only=True)
class Final(_Message):
    """HandshakeFinalMessageToken (9.3.2.5.3)."""

    CLASS_ID: ClassVar[str] = AUTHENTICATION + "+Final"

    challenge1: bytes | None
    """None in the second version, as is all else but the signature."""
    challenge2: bytes | None
    dh1: bytes | None = None
    dh2: bytes | None = None
    hash_c2: bytes | None = None
    hash_c1: bytes | None = None
    signature: bytes

    @property
    def version(self) -> WireVersion:
        """The second if it repeats nothing."""
        return WireVersion.SECOND if self.challenge1 is None else WireVersion.FIRST


@dataclass(frozen=True, slots=True, kw_only=True)
class AuthRequest(_Message):
    """AuthRequestMessageToken (9.3.2.4): the challenge its sender will use later."""

    CLASS_ID: ClassVar[str] = AUTHENTICATION + "+AuthReq"

    future_challenge: bytes


def _due(kind: type[_Message]) -> tuple[str, ...]:
    due = tuple(field.name for field in fields(kind) if field.default is not None)
    return (*Introduction.NAMES, *due[1:]) if due[0] == "introduction" else due


_MESSAGES: tuple[type[_Message], ...] = (Request, Reply, Final, AuthRequest)
_NAMES: dict[type, tuple[str, ...]] = {
    kind: tuple(field.name for field in fields(kind)) for kind in _MESSAGES
}
_KNOWN_NAMES = {*Introduction.NAMES, *(name for names in _NAMES.values() for name in names)}
_DUE: dict[type, tuple[str, ...]] = {kind: _due(kind) for kind in _MESSAGES}
"""The properties that a message of this kind must have."""


def _name(octets: bytes) -> str:
    # Cyclone DDS and OpenDDS end algorithm names in NUL, Fast DDS does not.
    return octets.removesuffix(b"\0").decode("ascii", "backslashreplace")


def _class_problems(holder: DataHolder, class_id: str) -> list[Problem]:
    # Cyclone DDS compares a prefix only.
    if holder.class_id == class_id:
        return []
    words = f"expected a '{class_id}', got a '{shown(holder.class_id)}'"
    return [Problem(words, Code.C3)]


def _missing_problems(found: dict[str, bytes], due: Iterable[str]) -> list[Problem]:
    return [Problem(f"{name} is missing", Code.C4) for name in due if name not in found]


def _double_problems(holder: DataHolder, found: dict[str, bytes]) -> Iterator[Problem]:
    # Cyclone DDS uses the first of a repeated property, others may use the last.
    if len(found) < len(holder.binary_properties):
        for name, count in Counter(name for name, _ in holder.binary_properties).items():
            if count > 1:
                yield Problem(f"'{shown(name)}' is there {count} times", Code.C5)


def _size_problems(found: dict[str, bytes]) -> Iterator[Problem]:
    for name in _LIMITED:
        if name not in found:
            continue
        size = len(found[name])
        if size != _SIZES.get(name, size):
            yield Problem(f"{name} has {size} bytes, not {_SIZES[name]}", Code.C6)
        if name in _ALGORITHMS and size > _LONGEST_NAME:
            words = f"{name} has {size} bytes, which names no algorithm"
            yield Problem(words, _ALGORITHMS[name])


def _unknown_problems(found: dict[str, bytes]) -> Iterator[Problem]:
    # Fast DDS hashes every property of this prefix, the others hash five.
    if found.keys() <= _KNOWN_NAMES:
        return
    for name in found:
        if name.startswith(_OWN_PREFIX) and name not in Introduction.NAMES:
            yield Problem(f"'{shown(name)}' is not covered by every stack's hash", Code.C7)


def _other_problems(found: dict[str, bytes], due: Iterable[str]) -> list[Problem]:
    others = [name for name in found if name not in due]
    return [Problem(f"'{shown(name)}' is not in this version", Code.C7) for name in others]
