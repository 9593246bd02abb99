"""Problems as values: a code for programs, a subject, and a message for people.

Codes are stable and documented. Messages may be reworded at any time, so code must not
parse them.
"""

from dataclasses import replace
from enum import StrEnum
from typing import Self

from pqsec_pki._dataclass import dataclass


class Code(StrEnum):
    """The kind of a problem, for programs."""

    OTHER = "other"
    """Only the message says what is wrong."""

    APPROVAL_WAITING = "approval-waiting"
    """A server has the request, and somebody must approve it."""

    # A file of an enclave, or a set of them
    FILE_MISSING = "file-missing"
    FILE_MALFORMED = "file-malformed"
    """Not what its name says, or it contains several values instead of one."""
    DOCUMENT_INVALID = "document-invalid"
    """Signed, but its XML violates the schema."""
    ELEMENT_MISPLACED = "element-misplaced"
    """An element of a document in a place where its schema has another one, or none."""
    READERS_DISAGREE = "readers-disagree"
    """Stacks could read a different document from this file than the verified one."""

    # A certificate, a key, an authority (RFC 5280 6.1)
    NOT_CA = "not-ca"
    NOT_SELF_SIGNED = "not-self-signed"
    NOT_PARTICIPANT = "not-participant"
    """A CA's certificate instead of a participant's."""
    KEY_USAGE = "key-usage"
    CRITICAL_EXTENSION = "critical-extension"
    NAME_CONSTRAINTS = "name-constraints"
    """A name that the CA may not issue for."""
    EXPIRED = "expired"
    NOT_YET_VALID = "not-yet-valid"
    WRONG_ISSUER = "wrong-issuer"
    """Issued by a CA with another name than the trusted one."""
    BAD_SIGNATURE = "bad-signature"
    """Issued by a CA of that name, but not signed with its key, or altered."""
    ALTERNATIVE_MISSING = "alternative-missing"
    """An alternative key or signature (X.509 9.8) is required but missing."""
    ALTERNATIVE_BAD = "alternative-bad"
    KEY_MISMATCH = "key-mismatch"
    """A private key that does not match the certificate."""
    WRONG_SUBJECT = "wrong-subject"
    """A certificate or document of another participant."""
    PROFILE_MISMATCH = "profile-mismatch"
    """A key of another algorithm than the keystore's profile has."""

    # Revocation (RFC 5280 6.3)
    REVOKED = "revoked"
    NOT_ISSUED = "not-issued"
    """A certificate that the ledger does not have for that participant."""
    LIST_MISSING = "list-missing"
    LIST_EXPIRED = "list-expired"
    LIST_NOT_YET_VALID = "list-not-yet-valid"
    LIST_WRONG_ISSUER = "list-wrong-issuer"
    LIST_BAD_SIGNATURE = "list-bad-signature"
    LIST_SCOPE = "list-scope"
    """A list for other certificates, for some reasons, or of changes only."""

    # Trust, and its roles
    ONE_KEY_TWO_ROLES = "one-key-two-roles"
    """The identity CA and the permissions CA have the same key (CVE-2023-24010)."""
    CA_DOUBLED = "ca-doubled"
    """A file has the same CA twice instead of two CAs."""
    CA_UNKNOWN = "ca-unknown"
    """A CA that is not trusted, or not in that role."""
    CA_MISSING = "ca-missing"
    """A trusted CA is missing."""
    COUNTERSIGNER_MISSING = "countersigner-missing"

    # A signed document (RFC 5652)
    NOT_SIGNED = "not-signed"
    WRONG_SIGNER = "wrong-signer"
    CONTENT_CHANGED = "content-changed"
    SIGNATURE_BAD = "signature-bad"
    SIGNATURE_MISSING = "signature-missing"
    """Valid, but a required classical or post-quantum signature is missing."""
    COUNTERSIGNATURE_BAD = "countersignature-bad"

    # A proof that the ledger has what was issued (c2sp.org/tlog-checkpoint)
    PROOF_MISSING = "proof-missing"
    PROOF_BAD = "proof-bad"
    """The signature of the head, or the path to it, is not valid, or it is of other files."""

    # What a document grants (DDS-Security 1.1, 9.4.3)
    NO_GRANT = "no-grant"
    GRANT_EXPIRED = "grant-expired"
    GRANT_NOT_YET_VALID = "grant-not-yet-valid"
    NO_DOMAIN_RULE = "no-domain-rule"
    DOMAIN_DENIED = "domain-denied"

    # A handshake message, by the number of the check (wire.md, 9). C10 has the codes of
    # certificates, C25 also those of documents
    C1 = "C1"
    C2 = "C2"
    C3 = "C3"
    C4 = "C4"
    C5 = "C5"
    C6 = "C6"
    C7 = "C7"
    C8 = "C8"
    C9 = "C9"
    C11 = "C11"
    C12 = "C12"
    C13 = "C13"
    C14 = "C14"
    C15 = "C15"
    C16 = "C16"
    C17 = "C17"
    C18 = "C18"
    C19 = "C19"
    C20 = "C20"
    C21 = "C21"
    C22 = "C22"
    C23 = "C23"
    C24 = "C24"
    C25 = "C25"
    C26 = "C26"
    C27 = "C27"
    C28 = "C28"
    C29 = "C29"
    C30 = "C30"

    # Compared with what was installed before
    OLDER = "older"


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong."""

    message: str
    code: Code = Code.OTHER
    subject: str = ""
    """The file or participant at fault, if known."""
    line: int | None = None
    """The line of the document, from 1."""
    element: str | None = None
    """The XML element or YAML key in the document."""

    def __str__(self) -> str:
        subject = f"{self.subject}: " if self.subject else ""
        place = f"line {self.line}: " if self.line is not None else ""
        element = f"<{self.element}>: " if self.element else ""
        return f"{subject}{place}{element}{self.message}"

    def of(self, subject: str) -> Self:
        """This problem, with `subject` before its own subject."""
        return replace(self, subject=": ".join(filter(None, (subject, self.subject))))

    def as_code(self, code: Code) -> Self:
        """This problem with another code."""
        return replace(self, code=code)
