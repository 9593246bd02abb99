"""What a registration authority orders: enrol these participants, with these keys, in these roles.

The order names the grant by its digest, and each request by its own; its key signs all of it.
"""

import hashlib
from base64 import b64decode, b64encode
from datetime import datetime, timedelta
from functools import cached_property
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.approvals._canonical import (
    canonical,
    exactly,
    items,
    parsed,
    readable,
    reading,
    sha256,
    text,
    time,
    whole,
)
from pqsec_pki.approvals.registration import RegistrationGrant
from pqsec_pki.errors import VerificationError
from pqsec_pki.problems import Code

FORMAT = 1
LABEL = b"pqsec order 1\n"
"""Nothing else begins with it that such a key signs: no approval, certificate or request."""


@dataclass(frozen=True, slots=True)
class OrderedName:
    """One participant of an order."""

    name: str
    role: str
    validity: timedelta
    request: str
    """SHA-256, in hex, of the certificate request."""

    @classmethod
    def from_json(cls, value: object) -> Self:
        """Errors as within `reading`."""
        found = exactly(value, "name", "role", "hours", "request")
        return cls(
            name=text(found["name"]),
            role=text(found["role"]),
            validity=timedelta(hours=whole(found["hours"])),
            request=sha256(found["request"]),
        )

    def to_json(self) -> dict[str, object]:
        """The participant as a value of JSON."""
        return {
            "name": self.name,
            "role": self.role,
            "hours": self.hours,
            "request": self.request,
        }

    @property
    def hours(self) -> int:
        """The validity in hours."""
        return self.validity // timedelta(hours=1)


@dataclass(frozen=True)
class EnrolmentOrder:
    """What the holder of a registration authority's key signed."""

    grant: str
    """The digest of the grant."""
    at: datetime
    """The time of the order, by the clock of the registration authority."""
    expires: datetime
    items: tuple[OrderedName, ...]
    signature: bytes

    @classmethod
    def signed(
        cls,
        grant: str,
        items: tuple[OrderedName, ...],
        key: PrivateKey,
        *,
        now: datetime,
        validity: timedelta,
    ) -> Self:
        """The order, signed with the key of the registration authority."""
        at = now.replace(microsecond=0)
        unsigned = cls(grant, at, at + validity, items, b"")
        return cls(grant, at, at + validity, items, key.sign(unsigned._statement))

    @classmethod
    def from_file(cls, data: bytes) -> Self:
        """The order in the file `data`; MalformedError if there is none. It is not verified."""
        with reading("an order"):
            found = exactly(parsed(data), *_FIELDS, "signature")
            if whole(found["format"]) != FORMAT:
                raise ValueError("made by another version of pqsec")
            return cls(
                grant=sha256(found["grant"]),
                at=time(found["at"]),
                expires=time(found["expires"]),
                items=items(found["enrol"], OrderedName.from_json),
                signature=b64decode(text(found["signature"]), validate=True),
            )

    def to_file(self) -> bytes:
        """The content of its file."""
        return readable({**self._content, "signature": b64encode(self.signature).decode()})

    def verify(self, grant: RegistrationGrant) -> None:
        """VerificationError unless the registration authority with that grant signed it."""
        try:
            grant.key.verify(self.signature, self._statement)
        except VerificationError:
            raise VerificationError(
                f"the order is not signed by {grant.authority}, or was changed after signing",
                code=Code.CONTENT_CHANGED,
            ) from None

    @cached_property
    def digest(self) -> str:
        """SHA-256, in hex, of what is signed: the same order, however it is signed again."""
        return hashlib.sha256(canonical(self._content)).hexdigest()

    @property
    def _statement(self) -> bytes:
        return LABEL + canonical(self._content)

    @property
    def _content(self) -> dict[str, object]:
        return {
            "format": FORMAT,
            "grant": self.grant,
            "at": self.at.isoformat(),
            "expires": self.expires.isoformat(),
            "enrol": [each.to_json() for each in self.items],
        }


_FIELDS = "format", "grant", "at", "expires", "enrol"
