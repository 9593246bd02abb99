"""Makes the report of a keystore. What cannot be read becomes a gap, never an empty section."""

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TypeVar

from pqsec_pki import __version__
from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import SPEC
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.keystore import (
    CurrentFiles,
    Entry,
    Keystore,
    Line,
    ParticipantState,
    RobotState,
    SharedStatus,
    State,
    Status,
    audit,
    layout,
    list_delivery,
    robot_states,
    superseded_certificates,
)
from pqsec_pki.keystore import status as status_of
from pqsec_pki.lint import Finding, Inventory, LintReport, Severity, check, largest_messages
from pqsec_pki.migration import MigrationPlan
from pqsec_pki.policy import Fleet, fleet_in
from pqsec_pki.report.dates import KINDS, endings_of, of_set
from pqsec_pki.report.history import events_of
from pqsec_pki.report.quantum import algorithm_of, exposures_of
from pqsec_pki.report.rights import rights_of
from pqsec_pki.report.values import (
    AuthorityRow,
    Evidence,
    FindingGroup,
    FindingPlace,
    FindingsSection,
    Gap,
    HandshakeSize,
    ParticipantRow,
    Report,
)

Given = TypeVar("Given")
Value = TypeVar("Value")

RIGHTS = "Who may command what"
QUANTUM = "What a quantum computer breaks"
MIGRATION = "Migration"
FINDINGS = "What is wrong or risky"
EVENTS = "What was issued, renewed and revoked"
SIZES = "How large the handshakes are"
ROBOTS = "What each robot runs"
EVIDENCE = "Evidence"
_RANK = {severity: rank for rank, severity in enumerate(Severity)}


def report_of(
    keystore: Keystore,
    *,
    now: datetime,
    command: str = "",
    migration: Callable[[], MigrationPlan] | None = None,
) -> Report:
    """The report of the keystore at `now`. `command` is the command line that made it.

    `migration` makes the plan that the report is to show; without it, it shows none.
    It needs no private key. Nothing is raised for a part that cannot be read or is not valid:
    the report has a gap for it.
    """
    keystore = keystore.as_found  # its evidence says what is wrong
    made = _ReportMaker(keystore, now)
    status = made.part(EVENTS, lambda: status_of(keystore, now=now))
    superseded = made.part(EVENTS, lambda: superseded_certificates(keystore, now=now))
    lines = made.part(EVENTS, keystore.lines)
    checked, fleet = made.verified(compared=lines is not None)
    authorities = made.part(EVIDENCE, lambda: _certificates(keystore, status))
    if checked:
        made.note_unread(checked)
    return Report(
        keystore=str(keystore.root),
        profile=keystore.profile.name,
        further_profiles=tuple(each.name for each in keystore.profiles[1:]),
        at=now,
        version=__version__,
        command=command,
        participants=_of(status, lambda found: tuple(_participants(found, superseded or {}))),
        authorities=_authorities(keystore, status, authorities),
        rights=made.of(fleet, RIGHTS, lambda found: rights_of(found, keystore.root, now)),
        endings=_of(status, lambda found: endings_of(found, fleet)),
        exposures=made.part(
            QUANTUM, lambda: exposures_of(keystore, authorities, checked, status, fleet)
        ),
        migration=made.of(migration, MIGRATION, lambda plan: plan()),
        findings=_of(checked, made.findings),
        events=_of(lines, events_of),
        sizes=_of(checked, lambda found: _sizes(found.inventory)),
        robots=made.of(status, ROBOTS, lambda found: _robots(keystore, found)),
        delivery=made.of(
            status,
            ROBOTS,
            lambda found: list_delivery(keystore, now=now, participants=found.participants),
        ),
        evidence=made.of(lines, EVIDENCE, lambda found: _evidence(keystore, found)),
        gaps=tuple(dict.fromkeys(made.gaps)),
    )


def _of(value: Given | None, make: Callable[[Given], Value | None]) -> Value | None:
    """What `make` returns for the value; None without one."""
    return None if value is None else make(value)


@dataclass(slots=True)
class _ReportMaker:
    """Collects the parts, and the gaps."""

    keystore: Keystore
    now: datetime
    gaps: list[Gap] = field(default_factory=list)

    def part(self, section: str, make: Callable[[], Value]) -> Value | None:
        """What `make` returns; None, and a gap, if it cannot be read or is not valid."""
        try:
            return make()
        except PqsecError as error:
            self.gaps += (Gap(section, line) for line in error.lines)
            return None

    def of(self, given: Given | None, section: str, make: Callable[[Given], Value]) -> Value | None:
        """The part that `make` returns for what is given; None without it."""
        return _of(given, lambda found: self.part(section, lambda: make(found)))

    def verified(self, *, compared: bool) -> tuple[LintReport | None, Fleet | None]:
        """The findings, and the participants' rights: what one verified, the other does not.

        Rights are those of the current documents; without a readable ledger they are not compared.
        """
        keystore, now = self.keystore, self.now
        anchors = self.part(RIGHTS, lambda: replace(keystore.anchors, remembers_all=True))
        checked = self.part(FINDINGS, lambda: check([keystore.root], now=now, anchors=anchors))
        rights = partial(fleet_in, keystore, now, SPEC, compared=compared)
        fleet = self.of(anchors, RIGHTS, lambda read: rights(anchors=read))
        return checked, fleet

    def note_unread(self, checked: LintReport) -> None:
        """A gap for each file that could not be checked."""
        for each in checked.unread:
            self.gaps.append(Gap(FINDINGS, f"{self.below(each.path)}: {each.message}"))

    def findings(self, checked: LintReport) -> FindingsSection:
        """The findings by rule, the most severe rules first."""
        by_rule: dict[str, list[Finding]] = defaultdict(list)
        for each in checked.findings:
            by_rule[each.rule.id].append(each)
        groups = [self._group(alike) for alike in by_rule.values()]
        return FindingsSection(
            groups=tuple(sorted(groups, key=lambda each: (_RANK[each.severity], each.rule))),
            files=sum(not file.unreadable for file in checked.inventory.files),
            ignored=tuple(
                (each.rule.id, self.below(each.path), reason) for each, reason in checked.ignored
            ),
        )

    def _group(self, alike: list[Finding]) -> FindingGroup:
        rule = alike[0].rule
        return FindingGroup(
            rule=rule.id,
            severity=min((each.severity for each in alike), key=_RANK.__getitem__),
            title=rule.title,
            why=rule.why,
            fix=rule.fix,
            places=tuple(
                FindingPlace(path=self.below(each.path), line=each.line, message=each.message)
                for each in alike
            ),
        )

    def below(self, path: Path) -> str:
        """The path, relative to the keystore if it is in it."""
        root = self.keystore.root
        return str(path.relative_to(root)) if path.is_relative_to(root) else str(path)


def _participants(
    status: Status, superseded: Mapping[str, tuple[Entry, ...]]
) -> Iterator[ParticipantRow]:
    for each in sorted(status.participants, key=lambda each: each.name):
        row = partial(_participant, earlier=superseded.get(each.name, ()))
        yield replace(row(each), further=tuple(map(row, each.further)))


def _participant(each: ParticipantState, earlier: Iterable[Entry]) -> ParticipantRow:
    """Its row of one set, with those certificates of `earlier` that are of that."""
    return ParticipantRow(
        name=each.name,
        state=each.state,
        not_after=each.not_after,
        profile=each.profile or "",
        domains=each.domains or "",
        serial=each.serial,
        superseded=tuple(old.ends for old in earlier if old.set_name == each.set_name),
    )


_Certificates = dict[tuple[str, str], Certificate]
"""The CAs' certificates by their sets and kinds, as in `Status.shared`."""


def _certificates(keystore: Keystore, status: Status | None) -> _Certificates:
    """Those of all sets."""
    found: _Certificates = {}
    for each in keystore.sets:
        with CurrentFiles.of(each) as current:
            anchors = current.anchors
        own = {"identity-ca": anchors.identity_ca, "permissions-ca": anchors.permissions_ca}
        if countersigner := anchors.countersigner:
            own["countersigner"] = countersigner
        kinds = [
            term.kind
            for term in (status.shared if status else ())
            if term.set_name == each.set_name
        ]
        if "trusted-too" in kinds:
            others = (ca for ca in anchors.identity_cas)
            own["trusted-too"] = next(ca for ca in others if ca != own["identity-ca"])
        found |= {(each.set_name, kind): ca for kind, ca in own.items()}
    return found


def _authorities(
    keystore: Keystore, status: Status | None, known: _Certificates | None
) -> tuple[AuthorityRow, ...] | None:
    if status is None or known is None:
        return None
    lists = {each.set_name: each.revocation_list_path for each in keystore.sets}
    return tuple(
        _authority(each, known.get((each.set_name, each.kind)), lists[each.set_name])
        for each in status.shared
    )


def _authority(each: SharedStatus, ca: Certificate | None, path: Path) -> AuthorityRow:
    """The row of a CA, or without one that of the list in `path`, which may be gone."""
    if ca:
        fingerprint = ca.fingerprint
    else:
        there = each.state is not State.GONE
        fingerprint = hashlib.sha256(path.read_bytes()).hexdigest() if there else ""
    kind = of_set(KINDS[each.kind], each.set_name)
    return AuthorityRow(
        kind=kind,
        name=each.name or kind,
        state=each.state,
        not_after=each.not_after,
        algorithm=algorithm_of(ca) if ca else "",
        fingerprint=fingerprint,
        set_name=each.set_name,
    )


def _sizes(inventory: Inventory) -> tuple[HandshakeSize, ...]:
    """The largest message of each participant in each set, the largest first."""
    alike: dict[tuple[int, int, int, str], list[str]] = defaultdict(list)
    for each in largest_messages(inventory):
        size = each.message, each.certificate, each.permissions, each.profile
        alike[size].append(each.enclave.name)
    return tuple(
        HandshakeSize(
            message=message,
            certificate=certificate,
            permissions=permissions,
            profile=profile,
            names=tuple(sorted(names)),
        )
        for (message, certificate, permissions, profile), names in sorted(
            alike.items(), reverse=True
        )
    )


def _robots(keystore: Keystore, status: Status) -> tuple[RobotState, ...]:
    participants = sorted(status.participants, key=lambda each: each.name)
    return tuple(robot_states(keystore, participants).values())


def _evidence(keystore: Keystore, lines: list[Line]) -> Evidence:
    try:
        audit(keystore)
        problems: tuple[str, ...] = ()
    except VerificationError as error:
        problems = error.lines
    governance = {
        each.set_name: hashlib.sha256(each.governance).hexdigest() for each in keystore.sets
    }
    return Evidence(
        head=lines[-1].chain if lines else keystore.head,
        lines=len(lines),
        audit=problems,
        governance=governance[layout.FIRST],
        further_governance={name: each for name, each in governance.items() if name},
        approvals=str(keystore.approvals or ""),
    )
