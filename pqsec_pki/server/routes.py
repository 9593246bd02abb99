"""What is asked by a method and a path. A path is compared octet by octet, and never decoded."""

import re
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.est import (
    BUNDLE,
    EST,
    HEAD,
    PEM_FILE,
    PKCS10,
    RECEIPT_TYPE,
    RECEIPTS,
    REQUESTS,
    REVOCATION_LIST,
)
from pqsec_pki.server.call import CallKind

_EST = {
    "cacerts": CallKind.CA_CERTIFICATES,
    "csrattrs": CallKind.REQUEST_ATTRIBUTES,
    "simpleenroll": CallKind.ENROL,
    "simplereenroll": CallKind.REENROL,
}
_OWN = {
    REQUESTS: CallKind.REQUEST,
    BUNDLE: CallKind.BUNDLE,
    REVOCATION_LIST: CallKind.REVOCATION_LIST,
    HEAD: CallKind.HEAD,
    RECEIPTS: CallKind.RECEIPT,
}
_TYPES = {
    CallKind.ENROL: {PKCS10},
    CallKind.REENROL: {PKCS10},
    CallKind.REQUEST: {PKCS10, PEM_FILE},
    CallKind.RECEIPT: {RECEIPT_TYPE},
}
"""The media types of what is sent; what is not here is fetched with GET."""
_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_LONGEST = 256


@dataclass(frozen=True, slots=True)
class Route:
    """What is asked."""

    kind: CallKind
    label: str = ""

    @classmethod
    def of(cls, path: bytes) -> Self | None:
        """The route of a path; None if there is nothing."""
        if len(path) > _LONGEST or not path.isascii():
            return None
        text = path.decode()
        if text in _OWN:
            return cls(_OWN[text])
        if not text.startswith(f"{EST}/"):
            return None
        match text.removeprefix(f"{EST}/").split("/"):
            case [last] if last in _EST:
                return cls(_EST[last])
            # RFC 7030 3.2.2: a label is not the name of an operation
            case [label, last] if last in _EST and label not in _EST and _LABEL.fullmatch(label):
                return cls(_EST[last], label)
        return None

    @property
    def is_est(self) -> bool:
        """Whether it is one of EST, whose bodies are in base64."""
        return self.kind in _EST.values()

    @property
    def types(self) -> set[str]:
        """The media types of what is sent; none if it is fetched."""
        return _TYPES.get(self.kind, set())

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods of HTTP."""
        return ("POST",) if self.types else ("GET", "HEAD")
