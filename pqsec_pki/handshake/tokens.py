"""Discovery tokens: what a participant announces about itself, not authenticated."""

from collections.abc import Iterable
from dataclasses import fields, replace
from typing import ClassVar, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import SIGNATURES, Family, KeyAgreement
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError, shown
from pqsec_pki.handshake.compact import FIRST_ONLY, WireVersion
from pqsec_pki.handshake.wire import DataHolder

_ALONE = f"{WireVersion.FIRST}"
"""The versions of a sender that announces none."""


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
            raise VerificationError(
                f"expected a '{cls.CLASS_ID}', got a '{shown(holder.class_id)}'"
            )
        found = dict(holder.properties)
        if len(found) != len(holder.properties):
            raise VerificationError(f"a property is twice in a {cls.CLASS_ID!r}")
        return cls(*(found.get(name) for name in cls.NAMES))


@dataclass(frozen=True, slots=True)
class IdentityToken(_Token):
    """Subject names and key algorithms of a participant and its CA (9.3.2.1, table 45).

    Not authenticated: use it for hints, never for a decision.
    """

    CLASS_ID: ClassVar[str] = "DDS:Auth:PKI-DH:1.0"
    NAMES: ClassVar[tuple[str, ...]] = (
        "dds.cert.sn",
        "dds.cert.algo",
        "dds.ca.sn",
        "dds.ca.algo",
        "pqsec.kagree_algo",
        "pqsec.versions",
        "pqsec.sets",
    )

    subject: str | None = None
    algorithm: str | None = None
    ca_subject: str | None = None
    ca_algorithm: str | None = None
    agreements: str | None = None
    """Names for c.kagree_algo that a Request may have, separated by commas."""
    versions: str | None = None
    """Versions that a Request may have, separated by commas; None: the first."""
    sets: str | None = None
    """Profiles of its sets of credentials, separated by commas; None: it has one, or does not
    say."""

    @classmethod
    def of(cls, certificate: Certificate, ca: Certificate) -> Self:
        """The token of the holder of `certificate`, which `ca` issued."""
        return cls(
            certificate.subject_text,
            certificate.public_key.algorithm.token_name,
            ca.subject_text,
            ca.public_key.algorithm.token_name,
        )

    @classmethod
    def announced(
        cls,
        certificate: Certificate,
        ca: Certificate,
        agreements: Iterable[KeyAgreement],
        versions: Iterable[WireVersion] = FIRST_ONLY,
        sets: Iterable[str] = (),
    ) -> Self:
        """The token that we send if we accept Requests for `agreements`, in those `versions`.

        `sets` are the profiles of our sets of credentials, if we have several.

        Without dds.ca.sn: OpenDDS 3.33 and 3.34 compare it with their own spelling, and no
        other stack uses it.
        """
        names = ",".join(each.wire_name for each in agreements)
        numbers = ",".join(f"{each}" for each in versions)
        return replace(
            cls.of(certificate, ca),
            ca_subject=None,
            agreements=names,
            versions=None if numbers == _ALONE else numbers,
            sets=",".join(sets) or None,
        )

    def reads(self, version: WireVersion) -> bool:
        """Whether the sender announces that it accepts Requests of `version`.

        As `knows`: a forger can have us use another version that we allow, or none.
        """
        return f"{version}" in (self.versions or _ALONE).split(",")

    def has_set(self, profile: str, certificate: Certificate) -> bool:
        """Whether the sender announces that it has credentials of that profile, or, as one with a
        single set, a key as that of our `certificate`.

        As `knows`: a forger can have us use another set that we allow for it, or none.
        """
        alike = self.algorithm == certificate.public_key.algorithm.token_name
        return alike or profile in (self.sets or "").split(",")

    def knows(self, agreement: KeyAgreement) -> bool:
        """Whether the sender announces that it accepts a Request for `agreement`.

        Use it to avoid a Request, since OpenDDS crashes on an unknown name; do not use it to
        choose another agreement.
        """
        if agreement.family is Family.CLASSICAL or self.algorithm in _NEW_KEYS:
            return True
        return agreement.wire_name in (self.agreements or "").split(",")


_NEW_KEYS = {row.token_name for row in SIGNATURES if row.family is not Family.CLASSICAL}
"""Key algorithms that no stock stack has."""


@dataclass(frozen=True, slots=True)
class PermissionsToken(_Token):
    """Who signed the permissions (9.4.2.2). Cyclone DDS sends it empty."""

    CLASS_ID: ClassVar[str] = "DDS:Access:Permissions:1.0"
    NAMES: ClassVar[tuple[str, ...]] = ("dds.perm_ca.sn", "dds.perm_ca.algo")

    ca_subject: str | None = None
    ca_algorithm: str | None = None
