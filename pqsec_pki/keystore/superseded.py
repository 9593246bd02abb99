"""Certificates that were replaced and are still valid: others accept whoever has their keys.

A certificate is replaced by a renewal, by `issue --force` and `apply`, and by an enrolment for new
keys; only a revocation or its end ends it.
"""

from datetime import datetime

from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.states import participant_states


def superseded_certificates(keystore: Keystore, *, now: datetime) -> dict[str, tuple[Entry, ...]]:
    """The ledger lines of each participant's certificates before its current one, oldest first,
    that are valid at `now`: not expired, not revoked, of the CA that issues now. Of all sets of
    credentials, those of the first one first.

    KeystoreError for a damaged ledger.
    """
    found: dict[str, tuple[Entry, ...]] = {}
    with keystore.open_ledger() as ledger:
        for each in keystore.sets:
            own = superseded_in(each, ledger.of(each.set_name), now=now)
            for name, entries in own.items():
                found[name] = (*found.get(name, ()), *entries)
    return found


def superseded_in(
    keystore: Keystore, ledger: Ledger, *, now: datetime
) -> dict[str, tuple[Entry, ...]]:
    """Like `superseded_certificates`, of one set, about which `ledger` answers."""
    issuer = keystore.identity_ca.fingerprint
    found = [
        (number, each)
        for number, each in ledger.replaced(now.isoformat())
        if each.issuer in {None, issuer}
    ]
    names = {each.name for _, each in found}
    states = participant_states(keystore, ledger, names, now=now) if names else ()
    line_of = ledger.numbers("participant") if names else {}
    current = {each.name: line_of[each.sha256] for each in states}
    kept: dict[str, tuple[Entry, ...]] = {}
    for number, each in found:
        if number < current[each.name]:
            kept[each.name] = (*kept.get(each.name, ()), each)
    return kept
