"""Describes a revocation list."""

import hashlib
from datetime import datetime

from pqsec_pki._times import exact
from pqsec_pki.certificates import RevocationList, RevokedCertificate, name_text
from pqsec_pki.inspection import _algorithms, _extensions, _times
from pqsec_pki.inspection.description import Description, Fact, Value

_REASONS = {
    "unspecified": "no reason given",
    "keyCompromise": "its key was compromised",
    "cACompromise": "the CA's key was compromised",
    "affiliationChanged": "its owner's affiliation changed",
    "superseded": "replaced by another",
    "cessationOfOperation": "no longer in use",
    "certificateHold": "on hold",
    "removeFromCRL": "no longer on hold",
    "privilegeWithdrawn": "its owner's privileges were withdrawn",
    "aACompromise": "the attribute authority was compromised",
}


def describe_list(der: bytes, now: datetime) -> Description:
    """The description of the revocation list in `der`; MalformedError if it is not one."""
    crl = RevocationList.from_der(der)
    issuer = name_text(crl.issuer)
    facts = (
        Fact.of("issuer", issuer),
        Fact.of("number", crl.number, "none" if crl.number is None else str(crl.number)),
        *_updates(crl, now),
        *_signatures(crl),
        _revoked(crl.revoked),
        _extensions.extensions_fact("extensions", crl.extensions),
        Fact.of("SHA-256", hashlib.sha256(crl.der).hexdigest(), key="sha256"),
    )
    return Description("revocation list", f"Revocation list of {issuer}", facts)


def _updates(crl: RevocationList, now: datetime) -> tuple[Fact, ...]:
    made = Fact.of("issued", crl.this_update.isoformat(), exact(crl.this_update))
    if crl.next_update is None:
        return (made, Fact.of("next list", None, "not announced"))
    late = now - crl.next_update
    where = f"{_times.span(late)} ago: this one is out of date" if now > crl.next_update else ""
    words = f"{exact(crl.next_update)} ({where or f'in {_times.span(-late)}'})"
    return (made, Fact.of("next list", crl.next_update.isoformat(), f"due {words}"))


def _signatures(crl: RevocationList) -> tuple[Fact, ...]:
    plain = _algorithms.algorithm_name(_algorithms.oid_of(crl.identifier))
    facts = (Fact.of("signature", plain, f"{plain} (not verified)"),)
    if crl.alternative is None or crl.alternative.identifier is None:
        return (*facts, Fact.of("alternative signature", None, "none"))
    second = _algorithms.algorithm_name(_algorithms.oid_of(crl.alternative.identifier))
    return (*facts, Fact.of("alternative signature", second, f"{second} (not verified)"))


def _revoked(entries: tuple[RevokedCertificate, ...]) -> Fact:
    lines = [_entry_words(each) for each in entries]
    values: tuple[Value, ...] = tuple(
        {
            "serial": f"{each.serial_number:x}",
            "revoked_at": each.revoked_at.isoformat(),
            "reason": each.reason,
        }
        for each in entries
    )
    return Fact.of("revoked", values, *(lines or ["no certificate"]))


def _entry_words(entry: RevokedCertificate) -> str:
    reason = f": {_REASONS.get(entry.reason, entry.reason)}" if entry.reason else ""
    return f"serial {entry.serial_number:x} on {exact(entry.revoked_at)}{reason}"
