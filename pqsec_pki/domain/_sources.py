"""What was found in one source of a domain file."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.approvals import ApprovalPolicy
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.documents import Governance, Grant, parse_subject
from pqsec_pki.domain._shared_rules import FoundParticipant
from pqsec_pki.domain.desired import LONGEST

_HOUR = timedelta(hours=1)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A participant that was not imported, and why."""

    name: str
    why: str
    refused: bool
    """Whether its files are wrong, or a domain file cannot say what they say."""


@dataclass(slots=True)
class ImportSource:
    """What was found in one source."""

    path: Path
    participants: list[FoundParticipant] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    governance: Governance | None = None
    ca_name: str = ""
    """Without ` Identity CA`; empty if the CAs are named otherwise."""
    profiles: tuple[str, ...] = ()
    """Those of a keystore's sets of credentials; empty if it has other algorithms."""
    ca_validity: timedelta | None = None
    groups: Mapping[str, Sequence[str]] = field(default_factory=dict)
    stock: Sequence[str] = ()
    approvals: ApprovalPolicy | None = None

    def add(
        self,
        name: str,
        grants: Sequence[Grant],
        now: datetime,
        validity: timedelta,
        *,
        key_elsewhere: bool = False,
    ) -> None:
        """Add a participant with the first of its grants that is in force at `now`."""
        grant = next((each for each in grants if each.not_before <= now <= each.not_after), None)
        if not grants:
            self.leave_out(name, "no grant is for its subject", refused=True)
        elif grant is None:
            self.leave_out(name, "its permissions are not in force")
        elif not grant.rules:
            self.leave_out(name, "its grant has no rule, only a default", refused=True)
        else:
            if len(grants) > 1:
                self.notes.append(f"{name} has {len(grants)} grants: the first in force counts")
            found = (name, grant.rules, grant.default, validity, str(self.path), key_elsewhere)
            self.participants.append(FoundParticipant(*found))

    def leave_out(self, name: str, why: str, *, refused: bool = False) -> None:
        """Note a participant that is not imported."""
        self.left_out.append(LeftOut(name, why, refused))


def lifetime(not_before: datetime, not_after: datetime) -> timedelta:
    """The validity with which these times were made, in whole hours."""
    whole = not_after - not_before
    hours = round((whole - BACKDATE if whole > BACKDATE else whole) / _HOUR)
    return min(max(hours, 1) * _HOUR, LONGEST)


def common_name_in(subject: str) -> str:
    """The CN; empty if there is none. MalformedError for a text that is not a subject name."""
    parts = [pair for part in parse_subject(subject) for pair in part]
    return next((value for kind, value in parts if kind == "CN"), "")
