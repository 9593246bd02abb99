"""What a registration authority may order: a grant, which the identity CA signs.

A registration authority (RA) checks who a robot is; the CA signs. Its key signs orders only. The
grant has all of its limits, with the rules of its roles in full: what a domain file says later
changes nothing.
"""

from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from functools import cached_property
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import days, said
from pqsec_pki.algorithms import PrivateKey, PublicKey, load_public_key
from pqsec_pki.approvals._canonical import (
    canonical,
    digest_of,
    exactly,
    items,
    parsed,
    readable,
    reading,
    text,
    time,
    whole,
)
from pqsec_pki.approvals.approval_policy import NAME
from pqsec_pki.errors import TooLargeError, UsageError, VerificationError, shown
from pqsec_pki.problems import Code

FORMAT = 1
LABEL = b"pqsec grant 1\n"
"""Nothing else begins with it that a CA's key signs."""
MAX_GRANT = 4 << 20
"""Bytes of the file; a role has some hundreds."""
MOST_ORDERED = 100_000


@dataclass(frozen=True, kw_only=True)
class RegistrationGrant:
    """The limits of one registration authority."""

    authority: str
    """The name of the registration authority."""
    key: PublicKey
    names: tuple[str, ...]
    """Patterns of participants' names."""
    roles: Mapping[str, Any]
    """The roles by name, as values of JSON."""
    begins: datetime
    ends: datetime
    longest: timedelta
    """How long a certificate may be valid."""
    most: int
    """How many participants may be enrolled by it."""
    ledger: str
    """The origin of the ledger, by which heads name it: a grant is for one keystore."""

    def __post_init__(self) -> None:
        """UsageError for a grant of nothing, or without an end."""
        if not NAME.fullmatch(self.authority):
            raise UsageError(
                f"'{shown(self.authority)}' cannot be the name of a registration authority",
                hint="write line1 or factory@example",
            )
        if not self.names or not self.roles:
            raise UsageError("a grant needs patterns of names, and roles")
        if unrooted := [each for each in self.names if not each.startswith("/")]:
            raise UsageError(f"'{shown(unrooted[0])}' matches no name: names begin with a slash")
        if not 1 <= self.most <= MOST_ORDERED:
            raise UsageError(f"a grant is for 1 to {MOST_ORDERED} participants")
        if self.begins >= self.ends or self.longest < timedelta(hours=1):
            raise UsageError("the grant would allow nothing: it ends before it begins")

    @classmethod
    def from_json(cls, value: object) -> Self:
        """The grant in a value of JSON; errors as within `reading`."""
        found = exactly(value, *_FIELDS)
        if whole(found["format"]) != FORMAT:
            raise ValueError("made by another version of pqsec")
        return cls(
            authority=text(found["authority"]),
            key=load_public_key(b64decode(text(found["key"]), validate=True)),
            names=items(found["names"], text),
            roles={text(key): each for key, each in dict(found["roles"]).items()},
            begins=time(found["begins"]),
            ends=time(found["ends"]),
            longest=timedelta(hours=whole(found["longest_hours"])),
            most=whole(found["most"]),
            ledger=text(found["ledger"]),
        )

    def to_json(self) -> dict[str, object]:
        """The grant as a value of JSON."""
        return {
            "format": FORMAT,
            "authority": self.authority,
            "key": b64encode(self.key.spki).decode(),
            "names": list(self.names),
            "roles": dict(self.roles),
            "begins": self.begins.isoformat(),
            "ends": self.ends.isoformat(),
            "longest_hours": self.longest // timedelta(hours=1),
            "most": self.most,
            "ledger": self.ledger,
        }

    @cached_property
    def digest(self) -> str:
        """SHA-256, in hex, of its canonical form: by it, orders and the ledger name the grant."""
        return digest_of(self.to_json())

    def signed_by(self, keys: Sequence[PrivateKey]) -> "SignedGrant":
        """The grant with a signature of each of the identity CA's keys."""
        statement = LABEL + canonical(self.to_json())
        return SignedGrant(self, tuple(key.sign(statement) for key in keys))

    def __str__(self) -> str:
        return (
            f"{self.most} of {', '.join(self.names)} as {', '.join(self.roles)}, for"
            f" {days(self.longest)} at most, until {said(self.ends)}"
        )


_FIELDS = (
    *("format", "authority", "key", "names", "roles", "begins", "ends", "longest_hours"),
    *("most", "ledger"),
)


@dataclass(frozen=True, slots=True)
class SignedGrant:
    """A grant with the signatures of the identity CA."""

    grant: RegistrationGrant
    signatures: tuple[bytes, ...]

    @classmethod
    def from_file(cls, data: bytes) -> Self:
        """The grant in the file `data`; MalformedError if there is none. It is not verified."""
        with reading("a grant"):
            found = exactly(parsed(data), "grant", "signatures")
            signatures = items(found["signatures"], lambda each: b64decode(text(each)))
            return cls(RegistrationGrant.from_json(found["grant"]), signatures)

    def to_file(self) -> bytes:
        """The content of its file; TooLargeError if it could not be read again."""
        signatures = [b64encode(each).decode() for each in self.signatures]
        data = readable({"grant": self.grant.to_json(), "signatures": signatures})
        TooLargeError.check("the grant", len(data), MAX_GRANT, hint="give fewer names or roles")
        return data

    def verify(self, keys: Sequence[PublicKey]) -> None:
        """VerificationError unless each of `keys`, the identity CA's, signed it."""
        statement, name = LABEL + canonical(self.grant.to_json()), self.grant.authority
        try:
            for key, signature in zip(keys, self.signatures, strict=True):
                key.verify(signature, statement)
        except (ValueError, VerificationError):
            raise VerificationError(
                f"the grant of {name} is not signed by the identity CA, with all its keys",
                code=Code.CONTENT_CHANGED,
                hint="a new identity CA ends all grants: `pqsec ra add` makes another",
            ) from None
