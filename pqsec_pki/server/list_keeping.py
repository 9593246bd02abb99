"""Keeps a revocation list in force: the first one, and the next before that ends."""

from datetime import datetime, timedelta

from pqsec_pki.keystore import Authorities, Keystore, State
from pqsec_pki.lifecycle import renew_list


def keep_list(
    keystore: Keystore, authorities: Authorities, validity: timedelta, *, now: datetime
) -> bool:
    """Issue a list if there is none, or less than a third of it is left; whether it was issued.

    Robots get it with their documents, and their stacks refuse everybody when it has ended. Errors
    as of `renew_list`.
    """
    found = keystore.revocation_list
    end = found.next_update if found else None
    if found and end and State.at(now, found.this_update, end, None) is State.VALID:
        return False
    renew_list(keystore, authorities, now=now, validity=validity)
    return True
