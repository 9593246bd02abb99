"""Decisions about requests that wait: lines of the ledger.

A request is answered when its robot asks again. Where new certificates need approvals of several
people, an approved request becomes the one that the domain file names: the next plan has it, and
the certificate is issued when that is applied. An approval ends if the robot does not fetch its
certificate.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from pqsec_pki.approvals import ApprovalPolicy, Covered
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.domain import deliver_request, read_domain
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Entry, Keystore, Ledger, change, participant_states
from pqsec_pki.server.configuration import ServerSettings
from pqsec_pki.server.waiting import LIFETIME, WaitingRequest, WaitingRequests

APPROVAL, REFUSAL = "request-approval", "request-refusal"
"""Kinds of lines; they have the SHA-256 of the request."""


def decision_on(ledger: Ledger, request: CertificateRequest, name: str) -> Entry | None:
    """The line that decides about the request: a refusal, if there is one."""
    lines = [each for kind in (REFUSAL, APPROVAL) for each in ledger.of_name(kind, name)]
    return next((each for each in lines if each.sha256 == request.fingerprint), None)


def end_of(approval: Entry) -> datetime:
    """Until when the approved request is answered."""
    return approval.made_at + LIFETIME


def is_late(ledger: Ledger, approval: Entry) -> bool:
    """Whether the approval is older than the newest certificate of the participant."""
    approved = ledger.line_of((APPROVAL,), approval.sha256)
    newest = ledger.of_name("participant", approval.name)[-1:]
    return any(ledger.line_of(("participant",), each.sha256) > approved for each in newest)


def open_approvals(ledger: Ledger, now: datetime) -> list[Entry]:
    """The approvals that allow a certificate which is not issued yet, oldest first."""
    found = ledger.of_kind(APPROVAL)
    return [each for each in found if now <= end_of(each) and not is_late(ledger, each)]


def demanded(policy: ApprovalPolicy | None) -> str:
    """The approvals that a plan with a new certificate needs, in words; empty for none."""
    return policy.demand({Covered.GROW}) if policy else ""


def decide(
    keystore: Keystore, settings: ServerSettings, ids: Iterable[str], kind: str, *, now: datetime
) -> list[WaitingRequest]:
    """Enter the decision on these requests, all or none, which then no longer wait.

    If one is approved, others for its name are dropped. UsageError for two of one name.
    Other errors as of `WaitingRequests.named`, and of `deliver_request` where approvals are
    demanded.
    """
    waiting = settings.waiting(keystore)
    with keystore.hold():  # a server that answers could replace a request by another
        chosen = {each.sha256: each for each in map(waiting.named, ids)}.values()
        names = Counter(each.name for each in chosen)
        if kind == APPROVAL and (twice := [name for name, count in names.items() if count > 1]):
            words = f"approve one request for {', '.join(twice)}: the last would replace it"
            raise UsageError(words)
        with change(keystore.root) as transaction:
            if kind == APPROVAL and demanded(keystore.approvals):
                _deliver(chosen, waiting, settings.domain)
            for each in chosen:
                details = {"address": each.address}
                transaction.record(Entry.of(kind, each.name, each.sha256, now, details=details))
        others = [each.sha256 for each in waiting.all() if each.name in names]
        waiting.remove(*(others if kind == APPROVAL else [each.sha256 for each in chosen]))
    return list(chosen)


def replacing(
    keystore: Keystore, found: Sequence[WaitingRequest], *, now: datetime
) -> frozenset[str]:
    """The SHA-256 of those that ask for another key than their participant has."""
    names = {each.name for each in found}
    with keystore.open_ledger() as ledger:
        certified = [
            (state.name, state.keys)
            for each in keystore.sets
            for state in participant_states(each, ledger.of(each.set_name), names, now=now)
        ]
    return frozenset(
        each.sha256
        for each in found
        for name, keys in certified
        if name == each.name and not {*keys.split()} <= {*each.keys.split()}
    )


def _deliver(chosen: Iterable[WaitingRequest], waiting: WaitingRequests, domain: Path) -> None:
    members = read_domain(domain).members
    if missing := [each.name for each in chosen if each.name not in members]:
        raise UsageError(f"{domain} no longer names {', '.join(missing)}")
    for each in chosen:
        deliver_request(members[each.name], waiting.request(each))
