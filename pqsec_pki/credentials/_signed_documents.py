"""Signed governance and permissions: verified and read once for all who have the same ones."""

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
    """A document whose signatures hold, by those who must sign it."""

    value: Value
    verified: Verified

    @property
    def signed_at(self) -> datetime | None:
        """When its signer says that it was signed; None where the signer does not say."""
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
    """Once for each document: all participants of a domain share one governance."""
    return verify(message, ca, alternative_ca=countersigner, require=require, pinned=pinned)


@lru_cache(maxsize=16)
def governance_in(document: bytes) -> Governance:
    """The governance that XML `document` is; errors as of `Governance.from_xml`."""
    return Governance.from_xml(document)


@lru_cache(maxsize=16)
def permissions_in(document: bytes) -> Permissions:
    """The permissions, likewise."""
    return Permissions.from_xml(document)
