"""Keeps a revocation list in force: the first one, and the next before that ends."""

from dataclasses import replace
from datetime import datetime, timedelta

from pqsec_pki.keystore import Authorities, Keystore, State, was_ahead
from pqsec_pki.lifecycle import renew_list


def keep_list(
    keystore: Keystore, authorities: Authorities, validity: timedelta, *, now: datetime
) -> bool:
    """Issue a list if one is needed; whether it was issued.

    It is needed if there is none, if less than a third of it is left, and when the clock is right
    again after it was ahead: then it is the ledger's newest line, so that others are signed too.
    Robots get it with their documents, and their stacks refuse everybody when it has ended. Errors
    as of `renew_list`.
    """
    with keystore.open_ledger() as ledger:
        recovers = was_ahead(ledger, authorities, now)
    if not recovers and all(_has_valid_list(each, now) for each in keystore.sets):
        return False
    # Robots order lists by their numbers: a list does no harm if it is this clock that is wrong.
    authorities = replace(authorities, compares_clock=authorities.compares_clock and not recovers)
    renew_list(keystore, authorities, now=now, validity=validity)
    return True


def _has_valid_list(keystore: Keystore, now: datetime) -> bool:
    found = keystore.revocation_list
    if found is None or found.next_update is None:
        return False
    return State.at(now, found.this_update, found.next_update, None) is State.VALID
