"""Signed governance and permissions; each document is verified and parsed once."""

from collections.abc import Callable
from datetime import datetime
from functools import update_wrapper
from threading import Lock
from typing import Concatenate, Generic, ParamSpec, TypeVar

from pqsec_pki._dataclass import dataclass
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


class _Remembered(Generic[More, Found]):
    """A function that remembers results for its latest documents. Errors are not remembered.

    All arguments together are the key, so the result must not depend on anything else, such as
    the time.
    """

    def __init__(self, function: Callable[Concatenate[bytes, More], Found]) -> None:
        update_wrapper(self, function)
        self._function, self._lock = function, Lock()
        self.cache_clear()

    def __call__(self, document: bytes, /, *others: More.args, **named: More.kwargs) -> Found:
        key = document, others, tuple(named.items())
        with self._lock:
            if key in self._results:
                result = self._results[key] = self._results.pop(key)  # now the latest
                return result
        result = self._function(document, *others, **named)
        with self._lock:
            if key not in self._results:  # another thread may have been faster
                self._results[key], self._sizes[key] = result, len(document)
                self._size += len(document)
            while self._size > MAX_REMEMBERED:
                oldest = next(iter(self._results))
                self._size -= self._sizes.pop(oldest)
                del self._results[oldest]
        return result

    def cache_clear(self) -> None:
        """Forget all results."""
        self._results: dict[object, Found] = {}
        self._sizes: dict[object, int] = {}
        self._size = 0


@dataclass(frozen=True, slots=True)
class SignedDocument(Generic[Value]):
    """A document with valid signatures by the signers that it must have."""

    value: Value
    verified: Verified

    @property
    def signed_at(self) -> datetime | None:
        """The signing time that its signer states; None if there is none."""
        return self.verified.signatures[0].signed_at


@_Remembered
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


@_Remembered
def governance_in(document: bytes) -> Governance:
    """The governance in the XML `document`; errors as in `Governance.from_xml`."""
    return Governance.from_xml(document)


@_Remembered
def permissions_in(document: bytes) -> Permissions:
    """The permissions in the XML `document`; errors as in `Permissions.from_xml`."""
    return Permissions.from_xml(document)
