"""One person's approval of a proposal: a signature over its digest, a name and a time.

What is signed begins with a line that nothing else begins with which such a key may sign: no
certificate, document, request or handshake.
"""

from base64 import b64decode, b64encode
from collections.abc import Sequence
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.approvals._canonical import (
    canonical,
    digest_of,
    exactly,
    parsed,
    readable,
    reading,
    sha256,
    text,
    time,
)
from pqsec_pki.approvals.approval_policy import ApprovalPolicy
from pqsec_pki.errors import VerificationError
from pqsec_pki.problems import Code

LABEL = b"pqsec approval 1\n"
_FIELDS = "approver", "at", "proposal", "signature"


@dataclass(frozen=True, slots=True)
class Approval:
    """What one approver signed."""

    approver: str
    at: datetime
    """The time of the approval, by the approver's clock."""
    proposal: str
    """The digest of the proposal."""
    signature: bytes

    @classmethod
    def from_json(cls, value: object) -> Self:
        """The approval in a value of JSON; MalformedError if it is none."""
        with reading("an approval"):
            found = exactly(value, *_FIELDS)
            return cls(
                approver=text(found["approver"]),
                at=time(found["at"]),
                proposal=sha256(found["proposal"]),
                signature=b64decode(text(found["signature"]), validate=True),
            )

    def to_json(self) -> dict[str, str]:
        """The approval as a value of JSON."""
        signature = b64encode(self.signature).decode()
        return {**_statement(self.approver, self.at, self.proposal), "signature": signature}

    def to_file(self) -> bytes:
        """The content of its file."""
        return readable({"approval": self.to_json()})

    @property
    def sha256(self) -> str:
        """SHA-256, in hex, of the approval with its signature."""
        return digest_of(self.to_json())

    def verify(self, policy: ApprovalPolicy) -> None:
        """VerificationError unless an approver of `policy` signed it."""
        key = policy.approvers.get(self.approver)
        if key is None:
            raise VerificationError(
                f"{self.approver} is not one of the approvers: {', '.join(policy.approvers)}",
                code=Code.WRONG_SUBJECT,
            )
        key.verify(self.signature, signed_text(self.approver, self.at, self.proposal))


def approval_in(data: bytes) -> Approval:
    """The approval in the file `data`; MalformedError if it is none."""
    with reading("an approval"):
        value = exactly(parsed(data), "approval")["approval"]
    return Approval.from_json(value)


def signed_text(approver: str, at: datetime, proposal: str) -> bytes:
    """The octets that the signature covers."""
    return LABEL + canonical(_statement(approver, at, proposal))


def _statement(approver: str, at: datetime, proposal: str) -> dict[str, str]:
    return {"approver": approver, "at": at.isoformat(), "proposal": proposal}


def approve(proposal: str, name: str, key: PrivateKey, *, now: datetime) -> Approval:
    """The approval of the proposal with that digest, by the holder of `key`."""
    at = now.replace(microsecond=0)
    return Approval(name, at, proposal, key.sign(signed_text(name, at, proposal)))


def refuse_without(
    digest: str, policy: ApprovalPolicy, approvals: Sequence[Approval], *, required: int
) -> None:
    """VerificationError unless `required` people approved exactly the proposal with that digest.

    An approval that is not valid is an error even if there are enough others.
    """
    for each in approvals:
        if each.proposal != digest:
            raise VerificationError(
                f"the approval by {each.approver} is of another plan",
                code=Code.CONTENT_CHANGED,
                hint="an approval is of one plan and one state: run `pqsec approve` for this plan",
            )
        each.verify(policy)
    names = [each.approver for each in approvals]
    if twice := {name for name in names if names.count(name) > 1}:
        raise VerificationError(f"two approvals by {min(twice)}, which count as one")
    if len(names) < required:
        others = [name for name in policy.approvers if name not in names]
        raise VerificationError(
            f"{len(names)} of {required} approvals: {', '.join(names)}",
            hint=f"`pqsec approve` writes one, for example of {', '.join(others)}",
        )
