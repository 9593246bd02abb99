"""May a participant join a domain?"""

from datetime import datetime

from pqsec_pki.access.deciding import decide
from pqsec_pki.access.decision import Decision
from pqsec_pki.access.question import Action, Question
from pqsec_pki.documents import Governance, Permissions


def may_join(
    governance: Governance, permissions: Permissions, subject: str, domain: int, now: datetime
) -> Decision:
    """Whether a participant with this certificate subject joins `domain`, by the standard.

    MalformedError if `subject` is not a name, UsageError if `now` has no time zone.
    """
    return decide(
        governance,
        permissions,
        Question(subject=subject, domain=domain, action=Action.JOIN, now=now),
    )
