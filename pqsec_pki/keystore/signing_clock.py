"""Whether the clock can be right when something is signed, by what the keystore has.

A clock that is behind lets what has ended be used again, and makes what ends too early. One that
is ahead cannot be told from a fleet in which nothing was signed for long.
"""

from collections.abc import Iterator
from datetime import datetime
from typing import TYPE_CHECKING

from pqsec_pki._times import said
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore._ledger import Ledger

if TYPE_CHECKING:
    from pqsec_pki.keystore.authorities import Authorities

CLOCK_SKEW = BACKDATE
"""What is signed begins so much earlier, for clocks that differ: up to that, what the clock that is
ahead signs is valid by the other, and nothing needs to be signed again."""
_SIGNED = (
    *("identity-ca", "permissions-ca", "participant", "permissions"),
    *("governance", "crl", "revocation"),
)
"""The kinds of lines about what a CA signed. Others do not show that somebody looked at the
clock."""


def refuse_wrong_clock(ledger: Ledger, authorities: "Authorities", now: datetime) -> None:
    """KeystoreError if something says that it is not `now`, if `authorities.compares_clock`.

    The ledger's newest line about what was signed, the newest revocation list or a CA begins more
    than CLOCK_SKEW later; or the list and the permissions CA, with the governance, have both ended.
    """
    if not authorities.compares_clock:
        return
    if why := next(_doubts(ledger, authorities, now), None):
        raise KeystoreError(
            f"the clock says {said(now)}, but {why}",
            hint="set the clock; if it is right, and an earlier one was wrong,"
            " --accept-clock signs with it",
        )


def was_ahead(ledger: Ledger, authorities: "Authorities", now: datetime) -> bool:
    """Whether lines of the future show that the clock was ahead once, rather than is behind now.

    Those of a time with a wrong clock lie together, and far from now; where the clock is behind,
    the first of them are near. False without such lines, if none was written for longer than that,
    and at a time before the CAs were made.
    """
    if not (_later(ledger, now, *_SIGNED) or _later(ledger, now, "crl")):
        return False
    cas, late = (authorities.identity, *authorities.signers), now + CLOCK_SKEW
    if any(each.certificate.not_before + BACKDATE > late for each in cas):
        return False
    future = [at for each in ledger.of_kind(*_SIGNED) if (at := each.made_at) > late]
    return min(future) - now > max(future) - min(future)


def signed_later(ledger: Ledger, now: datetime) -> Iterator[tuple[str, datetime]]:
    """What was signed later than `now`, by more than CLOCK_SKEW, and when."""
    found = {
        "the ledger's newest line": _SIGNED,
        "the revocation list": ("crl",),
        "the governance": ("governance",),
    }
    for what, kinds in found.items():
        if at := _later(ledger, now, *kinds):
            yield what, at


def _later(ledger: Ledger, now: datetime, *kinds: str) -> datetime | None:
    """When the newest line of these kinds was made, if that is later than `now`, by more than
    CLOCK_SKEW."""
    newest = ledger.last_of(*kinds)
    return newest.made_at if newest and newest.made_at > now + CLOCK_SKEW else None


def _doubts(ledger: Ledger, authorities: "Authorities", now: datetime) -> Iterator[str]:
    if at := _later(ledger, now, *_SIGNED):
        yield f"the ledger's newest line is of {said(at)}"
    if at := _later(ledger, now, "crl"):
        yield f"the newest revocation list was signed on {said(at)}"
    for ca in filter(None, (authorities.identity, *authorities.signers)):
        begin = ca.certificate.not_before
        if begin > now + CLOCK_SKEW:
            yield f"{ca.certificate.subject_name} begins on {said(begin)}"
    last_list, end = ledger.last_of("crl"), authorities.permissions.certificate.not_after
    if last_list and max(last_list.ends, end) < now:
        yield (
            f"the revocation list ended on {said(last_list.ends)}, and the permissions CA, which"
            f" signed the governance, on {said(end)}"
        )
