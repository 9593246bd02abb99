"""Signed governance and permissions; each document is verified and parsed once."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import update_wrapper
from typing import Concatenate, Generic, ParamSpec, TypeVar

from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.smime import Require, Verified, verify

Value = TypeVar("Value", Governance, Permissions)
Found = TypeVar("Found")
More = ParamSpec("More")

MAX_REMEMBERED = 4 << 20
"""Octets of documents whose result one function remembers: 300 of 14 kB, as ML-DSA-65 signs.

A limit of their number would keep too few of these, or too much of large ones.
"""


def _remembered(
    function: Callable[Concatenate[bytes, More], Found],
) -> Callable[Concatenate[bytes, More], Found]:
    """`function`, which remembers results for its latest documents. Errors are not remembered.

    All arguments together are the key, so the result must not depend on anything else, such as
    the time.
    """
    results: dict[object, Found] = {}
    sizes: dict[object, int] = {}
    held = 0

    def found(document: bytes, /, *others: More.args, **named: More.kwargs) -> Found:
        nonlocal held
        key = document, others, tuple(named.items())
        if key in results:
            result = results[key] = results.pop(key)  # now the latest
            return result
        result = function(document, *others, **named)
        results[key], sizes[key] = result, len(document)
        held += len(document)
        while held > MAX_REMEMBERED:
            oldest = next(iter(results))
            del results[oldest]
            held -= sizes.pop(oldest)
        return result

    update_wrapper(found, function)
    return found


@dataclass(frozen=True, slots=True)
class SignedDocument(Generic[Value]):
    """A document with valid signatures by the signers that it must have."""

    value: Value
    verified: Verified

    @property
    def signed_at(self) -> datetime | None:
        """The signing time that its signer states; None if there is none."""
        return self.verified.signatures[0].signed_at


@_remembered
def verified_by(
    message: bytes,
    ca: Certificate,
    countersigner: Certificate | None,
    require: Require,
    *,
    pinned: bool,
) -> Verified:
    """Verify the signatures; all participants share a governance, and meet the same peers."""
    return verify(message, ca, alternative_ca=countersigner, require=require, pinned=pinned)


@_remembered
def governance_in(document: bytes) -> Governance:
    """The governance in the XML `document`; errors as in `Governance.from_xml`."""
    return Governance.from_xml(document)


@_remembered
def permissions_in(document: bytes) -> Permissions:
    """The permissions in the XML `document`; errors as in `Permissions.from_xml`."""
    return Permissions.from_xml(document)
