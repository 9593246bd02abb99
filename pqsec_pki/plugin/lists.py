"""The newest revocation list of each CA that an agent has seen.

Each participant's list is a file that others write, and an older list is signed like a newer
one. Therefore the agent remembers the newest list of each CA, by number, while it runs. That
list applies to all participants of the CA, whatever their own files contain.

A list is shared only between participants with the same demands on signatures: a participant
that accepts a classical signature alone must not decide for one that demands both signatures.

It is not written to disk: anyone who can replace a newer list by an older one acts as the user,
and could replace the agent's file too. Across restarts the program that installs the list
protects it: `pqsec install` refuses an older one.
"""

from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeAlias

from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.errors import VerificationError

MAX_CAS = 64
"""Whose lists are remembered; then that of the CA that was not asked for longest is forgotten."""

_Issuer: TypeAlias = tuple[bytes, bytes, bytes, bool]


@dataclass(slots=True)
class NewestLists:
    """Of one agent, for all of its connections."""

    _newest: dict[_Issuer, RevocationList] = field(default_factory=dict)
    """The CA that was asked for last is the last."""

    def newest(
        self, ca: Certificate, found: RevocationList, *, alternative: bool, now: datetime
    ) -> RevocationList:
        """`found`, which must be verified as `ca`'s, or the newer one that was found before.

        `alternative`: whether it had to have the CA's alternative signature. One without a
        number, or not in force yet, says nothing of others.
        """
        issuer = _issuer(ca, alternative=alternative)
        known = self._newest.pop(issuer, None)
        if known is None or is_older(known, found):
            known = found if found.number is not None and found.this_update <= now else known
        if known is not None:
            self._newest[issuer] = known
        if len(self._newest) > MAX_CAS:
            del self._newest[next(iter(self._newest))]
        return known if known is not None and is_older(found, known) else found


def is_older(one: RevocationList, other: RevocationList) -> bool:
    """By the numbers of their CA (RFC 5280 5.2.3). A list without a number is never older."""
    return one.number is not None and other.number is not None and one.number < other.number


def refusal(one: RevocationList, other: RevocationList) -> VerificationError:
    """Why `one` is not taken."""
    return VerificationError(
        f"revocation list {one.number} is older than list {other.number} of the same CA, which"
        " goes on counting",
        hint="put the newer list back; `pqsec agent stop` makes the agent forget it",
    )


def _issuer(ca: Certificate, *, alternative: bool) -> _Issuer:
    """The CA by its name and keys, which it keeps when its certificate is renewed."""
    second = ca.alternative_key
    return ca.subject_der, ca.spki, second.spki if second else b"", alternative
