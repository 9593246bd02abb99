"""Signed governance and permissions; each document is verified and parsed once."""

from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from typing import Generic, TypeVar

from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.smime import Require, Verified, verify

Value = TypeVar("Value", Governance, Permissions)


@dataclass(frozen=True, slots=True)
class SignedDocument(Generic[Value]):
    """A document with valid signatures by the signers that it must have."""

    value: Value
    verified: Verified

    @property
    def signed_at(self) -> datetime | None:
        """The signing time that its signer states; None if there is none."""
        return self.verified.signatures[0].signed_at


@lru_cache(maxsize=16)
def verified_by(
    message: bytes,
    ca: Certificate,
    countersigner: Certificate | None,
    require: Require,
    *,
    pinned: bool,
) -> Verified:
    """Verify the signatures; cached, since all participants of a domain share a governance."""
    return verify(message, ca, alternative_ca=countersigner, require=require, pinned=pinned)


@lru_cache(maxsize=16)
def governance_in(document: bytes) -> Governance:
    """The governance in the XML `document`; errors as in `Governance.from_xml`."""
    return Governance.from_xml(document)


@lru_cache(maxsize=16)
def permissions_in(document: bytes) -> Permissions:
    """The permissions in the XML `document`; errors as in `Permissions.from_xml`."""
    return Permissions.from_xml(document)
