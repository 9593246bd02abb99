"""A plan that is proposed: which steps, with what in them, for which domain file and keystore."""

from datetime import datetime
from functools import cached_property
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.approvals._canonical import (
    boolean,
    digest_of,
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
from pqsec_pki.approvals.approval import Approval
from pqsec_pki.approvals.approval_policy import ApprovalPolicy, Covered
from pqsec_pki.errors import MalformedError, TooLargeError, VerificationError
from pqsec_pki.problems import Code

FORMAT = 1
MAX_PROPOSAL = 32 << 20
"""Bytes of the file: a step takes 200, and a domain file names 100,000 participants at most."""


@dataclass(frozen=True, slots=True)
class ProposedStep:
    """One step, as in a plan."""

    action: str
    name: str
    why: str
    content: str
    """SHA-256, in hex, of what the step makes or ends: rights, keys, a certificate."""

    @classmethod
    def from_json(cls, value: object) -> Self:
        """Errors as within `reading`."""
        found = exactly(value, "action", "name", "why", "content")
        return cls(
            action=text(found["action"]),
            name=text(found["name"]),
            why=text(found["why"]),
            content=sha256(found["content"]),
        )

    def to_json(self) -> dict[str, str]:
        """The step as a value of JSON."""
        return {
            "action": self.action,
            "name": self.name,
            "why": self.why,
            "content": self.content,
        }


@dataclass(frozen=True, slots=True)
class ChangedRights:
    """A change of rights, and the participants that it concerns; none if it concerns all."""

    names: tuple[str, ...]
    changes: tuple[str, ...]

    @classmethod
    def from_json(cls, value: object) -> Self:
        """Errors as within `reading`."""
        found = exactly(value, "names", "changes")
        return cls(items(found["names"], text), items(found["changes"], text))

    def to_json(self) -> dict[str, object]:
        """The change as a value of JSON."""
        return {"names": list(self.names), "changes": list(self.changes)}


@dataclass(frozen=True, kw_only=True)
class PlanProposal:
    """All that an approval is of."""

    proposer: str
    made_at: datetime
    expires: datetime
    domain_file: str
    """Relative to the folder of the plan's file."""
    domain_sha256: str
    head: str
    """The chain value of the ledger's last line: the state of the keystore."""
    policy: ApprovalPolicy
    needs: tuple[Covered, ...]
    """The kinds of its changes that need approvals."""
    prune: bool
    new_keys: bool
    only: str
    """identity or permissions, if it has the steps of one CA only; empty for all."""
    steps: tuple[ProposedStep, ...]
    rights: tuple[ChangedRights, ...]

    @classmethod
    def from_json(cls, value: object) -> Self:
        """The proposal in a value of JSON; MalformedError if it is none."""
        with reading("a plan"):
            found = exactly(value, "format", *_FIELDS)
            if whole(found["format"]) != FORMAT:
                raise MalformedError("made by another version of pqsec")
            return cls(
                proposer=text(found["proposer"]),
                made_at=time(found["made_at"]),
                expires=time(found["expires"]),
                domain_file=text(found["domain_file"]),
                domain_sha256=sha256(found["domain_sha256"]),
                head=sha256(found["head"]),
                policy=ApprovalPolicy.from_json(found["policy"]),
                needs=items(found["needs"], lambda each: Covered(text(each))),
                prune=boolean(found["prune"]),
                new_keys=boolean(found["new_keys"]),
                only=text(found["only"]),
                steps=items(found["steps"], ProposedStep.from_json),
                rights=items(found["rights"], ChangedRights.from_json),
            )

    def to_json(self) -> dict[str, object]:
        """The proposal as a value of JSON."""
        return {
            "format": FORMAT,
            "proposer": self.proposer,
            "made_at": self.made_at.isoformat(),
            "expires": self.expires.isoformat(),
            "domain_file": self.domain_file,
            "domain_sha256": self.domain_sha256,
            "head": self.head,
            "policy": self.policy.to_json(),
            "needs": list(self.needs),
            "prune": self.prune,
            "new_keys": self.new_keys,
            "only": self.only,
            "steps": [each.to_json() for each in self.steps],
            "rights": [each.to_json() for each in self.rights],
        }

    @cached_property
    def digest(self) -> str:
        """SHA-256, in hex, of its canonical form."""
        return digest_of(self.to_json())

    def refuse_expired(self, now: datetime) -> None:
        """VerificationError if it is too late for it."""
        if now >= self.expires:
            raise VerificationError(
                f"the plan expired on {said(self.expires)}",
                code=Code.EXPIRED,
                hint="make a new one: `pqsec plan` with -o",
            )


_FIELDS = (
    *("proposer", "made_at", "expires", "domain_file", "domain_sha256", "head", "policy"),
    *("needs", "prune", "new_keys", "only", "steps", "rights"),
)


def proposal_file(proposal: PlanProposal, first: Approval) -> bytes:
    """The content of the file with the proposal and its proposer's approval. TooLargeError."""
    data = readable({"approval": first.to_json(), "proposal": proposal.to_json()})
    hint = "plan in steps: fewer participants at once"
    TooLargeError.check("the plan", len(data), MAX_PROPOSAL, hint=hint)
    return data


def proposal_in(data: bytes) -> tuple[PlanProposal, Approval]:
    """The proposal in the file `data`, and its proposer's approval.

    MalformedError if there is none; VerificationError unless the approval is by the proposer, an
    approver of the policy in the file. Whether that is the keystore's policy is not known here.
    """
    with reading("a plan"):
        found = exactly(parsed(data), "approval", "proposal")
    proposal, first = (
        PlanProposal.from_json(found["proposal"]),
        Approval.from_json(found["approval"]),
    )
    if first.approver != proposal.proposer:
        raise VerificationError(
            f"{first.approver} signed the plan of {proposal.proposer}", code=Code.WRONG_SUBJECT
        )
    if first.proposal != proposal.digest:
        raise VerificationError("the plan was changed after signing", code=Code.CONTENT_CHANGED)
    first.verify(proposal.policy)
    return proposal, first
