"""Tokens of discovery: what a participant says of itself before anything is proved."""

from dataclasses import dataclass, fields
from typing import ClassVar, Self

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError, shown
from pqsec_pki.handshake.wire import DataHolder


@dataclass(frozen=True, slots=True)
class _Token:
    """Fields are string properties, named in NAMES; any of them may be absent."""

    CLASS_ID: ClassVar[str]
    NAMES: ClassVar[tuple[str, ...]]

    def to_holder(self) -> DataHolder:
        pairs = zip(self.NAMES, (getattr(self, field.name) for field in fields(self)), strict=True)
        return DataHolder(self.CLASS_ID, tuple(pair for pair in pairs if pair[1] is not None))

    @classmethod
    def from_holder(cls, holder: DataHolder) -> Self:
        """VerificationError if `holder` is of another class or has a property twice."""
        # 7.2.3: minor versions are compatible.
        if not holder.class_id.startswith(cls.CLASS_ID.removesuffix("0")):
            raise VerificationError(f"a '{shown(holder.class_id)}' where a '{cls.CLASS_ID}' is due")
        found = dict(holder.properties)
        if len(found) != len(holder.properties):
            raise VerificationError(f"a property is twice in a {cls.CLASS_ID!r}")
        return cls(*(found.get(name) for name in cls.NAMES))


@dataclass(frozen=True, slots=True)
class IdentityToken(_Token):
    """Whose certificate it is and what kinds of keys there are (9.3.2.1, table 45).

    Unauthenticated: good for a first look, never for a decision.
    """

    CLASS_ID: ClassVar[str] = "DDS:Auth:PKI-DH:1.0"
    NAMES: ClassVar[tuple[str, ...]] = (
        "dds.cert.sn",
        "dds.cert.algo",
        "dds.ca.sn",
        "dds.ca.algo",
    )

    subject: str | None = None
    algorithm: str | None = None
    ca_subject: str | None = None
    ca_algorithm: str | None = None

    @classmethod
    def of(cls, certificate: Certificate, ca: Certificate) -> Self:
        """The token of the holder of `certificate`, which `ca` issued."""
        return cls(
            certificate.subject_text,
            certificate.public_key.algorithm.token_name,
            ca.subject_text,
            ca.public_key.algorithm.token_name,
        )


@dataclass(frozen=True, slots=True)
class PermissionsToken(_Token):
    """Who signed the permissions (9.4.2.2). Cyclone DDS sends it empty."""

    CLASS_ID: ClassVar[str] = "DDS:Access:Permissions:1.0"
    NAMES: ClassVar[tuple[str, ...]] = ("dds.perm_ca.sn", "dds.perm_ca.algo")

    ca_subject: str | None = None
    ca_algorithm: str | None = None
