"""One command that people approve, in place of the plan of a domain file.

The proposal has the words of the command, the SHA-256 of each file that they name, and what it
would change. The same words are run when it is applied, once, in the state it was proposed for.
"""

import hashlib
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.approvals import Approval, ChangedRights, Covered, PlanProposal, ProposedStep
from pqsec_pki.domain.approved import changed_since, refuse_insufficient, refuse_other_state
from pqsec_pki.domain.proposing import demanded_policy
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import APPROVAL, Keystore, approval_entries, change, lines_since

COMMAND, FILE = "command", "file"
"""The actions of its steps."""
MAX_FILE = 256 << 20
_NO_APPROVALS = "run the command: nobody must approve it"
_NOTHING = hashlib.sha256(b"").hexdigest()


@dataclass(frozen=True, slots=True)
class CommandReview:
    """What is proposed: the words, what they need, and what they would change."""

    words: tuple[str, ...]
    files: tuple[Path, ...]
    """Files that the words name and that exist."""
    kind: Covered
    rights: tuple[ChangedRights, ...]

    @property
    def steps(self) -> tuple[ProposedStep, ...]:
        """The command, and each file."""
        text = shlex.join(self.words)
        if not text.isprintable():
            raise UsageError("the command has characters that a terminal cannot show")
        return (ProposedStep(COMMAND, "", text, _sha256(text.encode())), *map(_file, self.files))

    def needs(self, keystore: Keystore) -> tuple[Covered, ...]:
        """Why approvals are needed; KeystoreError if the keystore demands none."""
        return demanded_policy(keystore, _NO_APPROVALS).needs([self.kind])


def command_in(proposal: PlanProposal) -> list[str] | None:
    """The words of the command that is proposed; None for the plan of a domain file."""
    if proposal.domain_file or not proposal.steps or proposal.steps[0].action != COMMAND:
        return None
    try:
        return shlex.split(proposal.steps[0].why)
    except ValueError as error:
        raise VerificationError(f"its command cannot be read: {error}") from error


def propose_command(
    review: CommandReview,
    keystore: Keystore,
    *,
    proposer: str,
    now: datetime,
    validity: timedelta,
) -> PlanProposal:
    """The command as a proposal; KeystoreError if the keystore demands no approvals."""
    at = now.replace(microsecond=0)
    return PlanProposal(
        proposer=proposer,
        made_at=at,
        expires=at + validity,
        domain_file="",
        domain_sha256=_NOTHING,
        head=keystore.head,
        policy=demanded_policy(keystore, _NO_APPROVALS),
        needs=review.needs(keystore),
        prune=False,
        new_keys=False,
        only="",
        steps=review.steps,
        rights=review.rights,
    )


@contextmanager
def approved_command(
    proposal: PlanProposal,
    approvals: Sequence[Approval],
    review: CommandReview,
    keystore: Keystore,
    *,
    now: datetime,
) -> Iterator[None]:
    """Enter plan and approvals in the ledger; within it, the keystore is locked for the command.

    `review` is what its words mean now. VerificationError if that is not what was approved, by
    enough people, in this state, or if it was run already.
    """
    with keystore.hold():
        since = lines_since(keystore.lines(), proposal)
        if since is not None and any(line.entry.kind != APPROVAL for line in since):
            raise VerificationError(
                "the plan was applied already, or another change was made since it began",
                hint="`pqsec log` shows it",
            )
        proposal.refuse_expired(now)
        refuse_insufficient(proposal, approvals, keystore)
        if since is None:
            refuse_other_state(proposal, keystore.head)
        if proposal.steps != review.steps:
            raise changed_since("a file that the command names is another one than was approved")
        if (proposal.rights, proposal.needs) != (review.rights, review.needs(keystore)):
            raise changed_since("what the command changes is not what was approved")
        if since is None:
            with change(keystore.root) as transaction:
                transaction.record(*approval_entries(proposal, approvals, now))
        yield


def _file(path: Path) -> ProposedStep:
    sha256 = _sha256(read(path, limit=MAX_FILE))
    return ProposedStep(FILE, str(path), f"SHA-256 {sha256}", sha256)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


KINDS: Mapping[str, Covered] = {
    "revoke": Covered.REVOKE,
    "ca add-set": Covered.ROTATE,
    "ca remove-set": Covered.ROTATE,
    "ca rotate": Covered.ROTATE,
    "ca crl": Covered.OTHER,
    "issue": Covered.GROW,
    "permit": Covered.GROW,
    "renew": Covered.GROW,
    "ra add": Covered.GROW,
    "ra revoke": Covered.OTHER,
    "sign-request sign": Covered.GROW,
    "sign-governance": Covered.GROW,
    "sign-permissions": Covered.GROW,
}
"""The commands that can be proposed, and the kind of change that each may be."""
