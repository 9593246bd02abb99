"""The requester, what may be answered, and the refusal of the rest."""

from collections.abc import Iterable
from datetime import datetime, timedelta

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Entry
from pqsec_pki.lifecycle import ParticipantSpec
from pqsec_pki.server.token_lines import TokenState

MOST_OF_DAY = 24
"""Certificates that one participant can get without a token, and receipts that it can send: each is
a line of the ledger."""
_DAY, _HOUR = timedelta(days=1), 3600


class NotAdmittedError(PqsecError):
    """The request is refused, with this status of HTTP."""

    def __init__(self, status: int, words: str, *, retry_after: int = 0, problem: str = "") -> None:
        super().__init__(words)
        self.status, self.retry_after, self.problem = status, retry_after, problem


@dataclass(frozen=True, slots=True)
class Admitted:
    """A request that may be answered."""

    name: str
    by: str
    """The name of its admission in the ledger."""
    spec: ParticipantSpec | None = None
    """The request to answer with a certificate; None if that was done before."""
    line: Entry | None = None
    """The line that the ledger gets with it."""
    replaces: bool = False
    """Whether the participant exists."""
    after_revocation: bool = False
    """Whether it was revoked, and the token was made to admit it since."""


@dataclass(frozen=True, slots=True)
class Requester:
    """The requester: the holder of a token or of a participant's certificate, or unknown."""

    name: str
    """The participant's name; empty for a token."""
    by: str
    token: TokenState | None = None
    certificate: Certificate | None = None
    """The participant's certificate."""
    set_name: str = ""
    """The set of credentials that it is of."""
    device: Certificate | None = None
    """The device certificate that its factory issued."""
    again: bool = False
    """Whether that device may enrol again."""

    def refuse_other_name(self, name: str) -> None:
        """NotAdmittedError if it may not ask for `name`."""
        if self.token is not None and not self.token.admits(name):
            raise NotAdmittedError(403, f"the enrolment token is not for {name}")
        if self.certificate is not None and self.name != name:
            raise NotAdmittedError(403, f"the client certificate is not for {name}")

    def refuse_used(self, now: datetime) -> None:
        """NotAdmittedError if its token was revoked, expired or is used up."""
        if self.token is not None and (why := self.token.end(now)):
            raise NotAdmittedError(401, f"the enrolment token is {why}")


def refuse_many(what: str, lines: Iterable[Entry], now: datetime) -> None:
    """NotAdmittedError if MOST_OF_DAY of these lines of the ledger are of the last day.

    Lines of the future, when a clock was ahead, do not count.
    """
    if sum(timedelta() <= now - each.made_at < _DAY for each in lines) >= MOST_OF_DAY:
        words = f"there were {MOST_OF_DAY} {what} within a day: ask again later"
        raise NotAdmittedError(429, words, retry_after=_HOUR)
