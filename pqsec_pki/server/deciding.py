"""Decisions about requests that wait: lines of the ledger.

A request is answered when its robot asks again. Where new certificates need approvals of several
people, an approved request becomes the one that the domain file names: the next plan has it, and
the certificate is issued when that is applied.
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
from pqsec_pki.server.waiting import PendingRequests, WaitingRequest

APPROVAL, REFUSAL = "request-approval", "request-refusal"
"""Kinds of lines; they have the SHA-256 of the request."""


def decision_on(ledger: Ledger, request: CertificateRequest, name: str) -> str:
    """APPROVAL or REFUSAL of the request, by the ledger; empty if nobody decided."""
    for kind in (REFUSAL, APPROVAL):
        if any(each.sha256 == request.fingerprint for each in ledger.of_name(kind, name)):
            return kind
    return ""


def is_late(ledger: Ledger, request: CertificateRequest, name: str) -> bool:
    """Whether the approval of the request is older than the newest certificate of `name`."""
    approved, issued = ledger.numbers(APPROVAL), ledger.numbers("participant")
    lines = ledger.of_name("participant", name)[-1:]
    return any(issued[each.sha256] > approved.get(request.fingerprint, 0) for each in lines)


def demanded(policy: ApprovalPolicy | None) -> str:
    """Whose approvals a plan with a new certificate needs, in words; empty for nobody's."""
    return policy.demand({Covered.GROW}) if policy else ""


def decide(
    keystore: Keystore, settings: ServerSettings, ids: Iterable[str], kind: str, *, now: datetime
) -> list[WaitingRequest]:
    """Enter the decision on these requests, all or none, which then wait no more.

    If one is approved, others for its name wait no more either. UsageError for two of one name.
    Other errors as of `PendingRequests.named`, and of `deliver_request` where approvals are
    demanded.
    """
    pending = settings.pending
    chosen = {each.sha256: each for each in map(pending.named, ids)}.values()
    names = Counter(each.name for each in chosen)
    if kind == APPROVAL and (several := [name for name, count in names.items() if count > 1]):
        raise UsageError(f"approve one request for {', '.join(several)}: the last would replace it")
    with change(keystore.root) as transaction:
        if kind == APPROVAL and demanded(keystore.approvals):
            _deliver(chosen, pending, settings.domain)
        transaction.record(*(_entry(each, kind, now) for each in chosen))
    done = {each.sha256 for each in chosen}
    for each in pending.all():
        if each.sha256 in done or (kind == APPROVAL and each.name in names):
            pending.remove(each.sha256)
    return list(chosen)


def replacing(
    keystore: Keystore, found: Sequence[WaitingRequest], *, now: datetime
) -> frozenset[str]:
    """The SHA-256 of those that ask for another key than their participant has."""
    names = {each.name for each in found}
    with keystore.open_ledger() as ledger:
        states = participant_states(keystore, ledger, names, now=now)
        keys = {each.name: each.keys for each in states}
    return frozenset(
        each.sha256 for each in found if each.name in keys and each.keys != keys[each.name]
    )


def _deliver(chosen: Iterable[WaitingRequest], pending: PendingRequests, domain: Path) -> None:
    members = read_domain(domain).members
    if missing := [each.name for each in chosen if each.name not in members]:
        raise UsageError(f"{domain} does not name {', '.join(missing)} any more")
    for each in chosen:
        deliver_request(members[each.name], pending.request(each))


def _entry(waits: WaitingRequest, kind: str, now: datetime) -> Entry:
    return Entry(
        at=now.isoformat(timespec="seconds"),
        kind=kind,
        name=waits.name,
        serial=None,
        sha256=waits.sha256,
        not_after=None,
        details={"address": waits.address},
    )
