"""People with keys, a keystore that demands their approvals, and a change that they may approve."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, pem, private_key_pem
from pqsec_pki.approvals import Approval, PlanProposal, approve, proposal_file, proposal_in
from pqsec_pki.domain import PlanReview, apply_plan, approved_plan, plan, propose, read_domain
from pqsec_pki.errors import VerificationError
from tests.unit.domains import NOW, Scene

WEEK = timedelta(days=7)
PEOPLE = "alice", "bob", "carol"
DOMAIN = """
name: Lab
profile: classical
validity: 90d
roles:
  robot: {publish: [rt$name/pose], subscribe: [rt/cmd]}
participants:
  - {name: "/r{1..3}", role: robot}
approvals: {required: 2, of: {alice: alice.pub.pem, bob: bob.pub.pem, carol: carol.pub.pem}}
"""
GROWS = "subscribe: [rt/cmd]", "subscribe: [rt/cmd, rt/order]"


def make_key(folder, name, algorithm="ecdsa-p256", passphrase=None):
    """A new key in NAME.pem, and its public key in NAME.pub.pem."""
    key = SIGNATURES.named(algorithm).generate()
    (folder / f"{name}.pem").write_bytes(private_key_pem(key, passphrase))
    (folder / f"{name}.pub.pem").write_bytes(pem("PUBLIC KEY", key.public_key.spki))
    return key


class Council(Scene):
    """A domain file with approvals, its keystore, and the keys of the people."""

    def __init__(self, folder, text=DOMAIN):
        folder.mkdir(exist_ok=True)
        super().__init__(folder, text)
        self.folder = folder
        if text:
            self.keys = {name: make_key(folder, name) for name in (*PEOPLE, "mallory")}
            self.apply()

    def copied(self, folder):
        """The same again in another folder, with the keys of the same people."""
        made = self.copy(self, folder)
        made.keys = self.keys
        return made

    @property
    def desired(self):
        return read_domain(self.file)

    def proposed(self, proposer="alice", now=NOW, *, prune=False) -> tuple[PlanProposal, Approval]:
        """The plan as somebody writes it into a file, and as it is read from there."""
        found = plan(self.desired, self.keystore, now=now, prune=prune)
        review = PlanReview(self.desired, self.keystore, found, now)
        made = propose(
            review,
            proposer=proposer,
            prune=prune,
            new_keys=False,
            validity=WEEK,
            beside=self.folder,
        )
        return proposal_in(proposal_file(made, self.approval(made, proposer, now)))

    def written(self, path):
        """Some proposal, in a file there."""
        self.change(*GROWS)
        path.write_bytes(proposal_file(*self.proposed(now=datetime.now(UTC))))

    def approval(self, proposal, name, now=NOW, key=None):
        return approve(proposal.digest, name, self.keys[key or name], now=now)

    def approved(self, proposal, *approvals, now=NOW):
        return approved_plan(proposal, approvals, self.desired, self.keystore, now=now)

    def decide(self, proposal, *approvals, now=NOW):
        """Apply the plan; the steps that were made."""
        begun = self.approved(proposal, *approvals, now=now).begin(now)
        cas = begun.keystore.unlock(None)
        batches = apply_plan(self.desired, begun.keystore, cas, begun.plan, now=now)
        return [(step.action, step.name) for batch in batches for step in batch]

    def kinds(self):
        return [entry.kind for entry in self.keystore.ledger()]


def refused(council, proposal, *approvals, words, now=NOW):
    """The plan is refused for that reason, and nothing is done."""
    before = council.kinds()
    with pytest.raises(VerificationError, match=words):
        council.decide(proposal, *approvals, now=now)
    assert council.kinds() == before
