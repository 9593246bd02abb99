"""Two real participants under every circumstance, for each stack: what is tried.

A case alters a copy of a lab, and says what must come of it. All runs are processes of the
stacks themselves; where each is in a network of its own, several run at once.
"""

import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.certificates import Certificate, RevokedCertificate, revocation_list
from pqsec_pki.documents import Governance, Preset, ProtectionKind, preset_named
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, sign_governance
from pqsec_pki.trial import (
    Act,
    Installation,
    TopicRoute,
    Trial,
    TrialReport,
    TrialRun,
    TrialSetup,
    built,
    credentialed,
    run_peers,
    run_trial,
    unauthenticated,
    unique_text,
)
from tests.interop.conftest import DOMAINS, LAB_PROFILES, TOPIC, Lab

DAY = timedelta(days=1)
AGE = 50 * DAY
"""Of the labs: time enough for a certificate to expire."""
LONGEST_MEETING, LEAST_WAIT = 30.0, 4.0
PATIENCE = 240
"""Seconds, all three."""
PASSWORD = "Correct-Horse_1"
SENDER, RECEIVER = "/lab/bob", "/lab/alice"
"""Bob is the participant with a fault."""
OTHER = "rt/other"
"""A topic that is in nobody's permissions."""

Words = Mapping[str, str]
"""Stack, or stack and version -> what it must say."""


@dataclass(frozen=True)
class Case:
    """Circumstances, and what comes of them."""

    title: str
    profile: str = "classical"
    alter: Callable[[Lab, Path, datetime], None] = lambda lab, root, now: None
    """Does something to a copy of the lab's keystore, now."""
    topic: str = TOPIC
    password: str | None = None
    is_open: bool = False
    """Whether one without credentials gets the sample too, and it can be read on the wire."""
    closed_all_the_same: tuple[str, ...] = ()
    """Stacks with their versions that let no stranger in where they should."""
    refused: Words = field(default_factory=dict)
    """What the stacks say that do not let the two meet."""

    def lets_strangers_hear(self, installation: Installation) -> bool:
        """Whether one without credentials gets the sample."""
        name = f"{installation.build.stack} {installation.version}"
        return self.is_open and name not in self.closed_all_the_same

    def expected(self, installation: Installation) -> str | None:
        """What the stack must say; None if the two must meet."""
        stack, version = installation.build.stack, installation.version
        return self.refused.get(f"{stack} {version}", self.refused.get(stack))


def _folder(root: Path, name: str) -> Path:
    return root / f"enclaves{name}"


def encrypt_the_keys(lab: Lab, root: Path, now: datetime) -> None:
    for name in (SENDER, RECEIVER):
        path = _folder(root, name) / "key.pem"
        path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), PASSWORD.encode()))


def _crl(lab: Lab, root: Path, now: datetime, *revoked: str) -> None:
    """A revocation list of those, for the other; if of nobody, for the receiver."""
    entries = []
    for name in revoked:
        certificate = Certificate.from_pem((_folder(root, name) / "cert.pem").read_bytes())
        entries.append(RevokedCertificate(certificate.serial_number, now - DAY, "keyCompromise"))
    made = revocation_list(lab.authorities.identity, entries, number=1, now=now, validity=30 * DAY)
    pem = x509.load_der_x509_crl(made.der).public_bytes(Encoding.PEM)
    for name in {SENDER, RECEIVER} - {*revoked} if revoked else {RECEIVER}:
        (_folder(root, name) / "crl.pem").write_bytes(pem)


def revoke_nobody(lab: Lab, root: Path, now: datetime) -> None:
    _crl(lab, root, now)


def revoke_the_sender(lab: Lab, root: Path, now: datetime, who: str = SENDER) -> None:
    _crl(lab, root, now, who)


def let_the_sender_expire(lab: Lab, root: Path, now: datetime, who: str = SENDER) -> None:
    """Issued when the lab was made, and for too short a time."""
    keystore = Keystore.open(root)
    spec = ParticipantSpec(
        name=who, publish=(TOPIC,), subscribe=(TOPIC,), domains=DOMAINS, validity=30 * DAY
    )
    issue(keystore, lab.authorities, [spec], now=lab.now, force=True)


def alter_the_permissions(lab: Lab, root: Path, now: datetime, who: str = SENDER) -> None:
    path = _folder(root, who) / "permissions.p7s"
    text = path.read_bytes()
    assert TOPIC.encode() in text
    path.write_bytes(text.replace(TOPIC.encode(), b"rt/chatteR"))


def _governance(lab: Lab, now: datetime, preset: Preset, **topics: object) -> bytes:
    """Signed: the preset's, with other words for its topics."""
    return lab.authorities.sign(_rules(preset, **topics).to_xml(), now=now)


def _rules(preset: Preset, **topics: object) -> Governance:
    every = replace(preset.topic_rule, **topics)
    return Governance(domain_rules=(replace(preset.rule, domains=DOMAINS, topic_rules=(every,)),))


UNCONTROLLED = dict.fromkeys(["enable_read_access_control", "enable_write_access_control"], False)
UNPROTECTED = dict.fromkeys(
    ["metadata_protection_kind", "data_protection_kind"], ProtectionKind.NONE
)


def let_strangers_in(lab: Lab, root: Path, now: datetime) -> None:
    """All may take part, and nothing is protected."""
    open_to_all = _rules(preset_named("migration"), **UNCONTROLLED, **UNPROTECTED)
    sign_governance(Keystore.open(root), lab.authorities, open_to_all, now=now)


def keep_a_laxer_governance(lab: Lab, root: Path, now: datetime) -> None:
    """The sender's own stack lets it use any topic; the receiver may use that one."""
    keystore, topics = Keystore.open(root), (TOPIC, OTHER)
    spec = ParticipantSpec(
        name=RECEIVER, publish=topics, subscribe=topics, domains=DOMAINS, validity=365 * DAY
    )
    issue(keystore, lab.authorities, [spec], now=lab.now, force=True)
    path = _folder(root, SENDER) / "governance.p7s"
    path.unlink()  # a link to the one of all
    path.write_bytes(_governance(lab, now, preset_named("strict"), **UNCONTROLLED))


CASES = {
    "ecdsa": Case("ECDSA P-256 (`classical`)"),
    "rsa": Case("RSA-2048", profile="classical rsa"),
    "transition": Case(
        "ECDSA P-256, ML-DSA-65 beside it (`transition`)",
        profile="transition",
        refused={"fastdds 3.1.2": "Cannot serialize ParticipantGenericMessage"},
    ),
    "encrypted-key": Case("encrypted private keys", alter=encrypt_the_keys, password=PASSWORD),
    "crl": Case("revocation list, nobody revoked", alter=revoke_nobody),
    "open": Case(
        "governance that allows unauthenticated participants, topic not protected",
        alter=let_strangers_in,
        is_open=True,
        closed_all_the_same=("fastdds 2.9.1",),  # no match in 20 s, three times of three
    ),
    "revoked": Case(
        "revocation list, the sender revoked",
        alter=revoke_the_sender,
        refused={"cyclonedds": "certificate revoked", "fastdds": "certificate revoked"},
    ),
    "denied": Case(
        "topic that the permissions do not allow",
        topic=OTHER,
        refused={
            "cyclonedds": "Not Allowed By Security",
            "fastdds": "topic not found in allow rule",
        },
    ),
    "laxer": Case(
        "sender with a laxer governance of the same CA, on a topic not its own",
        alter=keep_a_laxer_governance,
        topic=OTHER,
        refused={
            "cyclonedds": "security_attributes mismatch",
            "fastdds": "Security manager returns an error for",
        },
    ),
    "expired": Case(
        "certificate of the sender expired",
        alter=let_the_sender_expire,
        refused={"cyclonedds": "certificate has expired", "fastdds": "certificate has expired"},
    ),
    "altered": Case(
        "permissions of the sender altered after signing",
        alter=alter_the_permissions,
        refused={
            "cyclonedds": "digest failure",
            "fastdds 2.9.1": "Cannot create participant due to initialization error",
            "fastdds 3.1.2": "Participant is not allowed with its own permissions file",
        },
    ),
}
CONTROL = "ecdsa"
"""It shows how long it takes to meet."""


@dataclass(frozen=True)
class Laboratory:
    """Where cases are run."""

    labs: Callable[[str], Lab]
    folder: Path
    now: datetime

    @classmethod
    def create(cls, folder: Path, now: datetime) -> Self:
        """With a lab of each profile that a case asks for, also of cases that run at once."""
        made = cache(lambda name: Lab.create(folder / name, LAB_PROFILES[name], now - AGE))
        lock = Lock()

        def labs(name: str) -> Lab:
            with lock:
                return made(name)

        return cls(labs, folder, now)

    def trial(self, installation: Installation, case: Case, **how: object) -> Trial:
        """The case with that stack, on a copy of the lab that is altered as it says."""
        lab = self.labs(case.profile)
        root = Path(mkdtemp(dir=self.folder)) / "keystore"
        shutil.copytree(lab.keystore.root, root, symlinks=True)
        case.alter(lab, root, self.now)
        return Trial(
            installation=installation,
            keystore=Keystore.open(root),
            password=case.password,
            now=self.now,
            **how,
        )


class Runs:
    """All cases with all stacks, several at once, begun when they are made."""

    def __init__(
        self, laboratory: Laboratory, installations: Mapping[str, Installation], pool: Executor
    ) -> None:
        self._laboratory, self._installations = laboratory, installations
        # The controls come first: the others wait for theirs.
        keys = [(stack, name) for name in CASES for stack in installations]
        self._begun = {key: pool.submit(self._run, *key) for key in keys}
        self._strangers = {each: pool.submit(self._stranger, each) for each in installations}

    def report(self, stack: str, name: str) -> TrialReport:
        return self._begun[stack, name].result(PATIENCE)

    def unauthenticated(self, stack: str) -> TrialRun:
        """Who has no credentials sends, and a participant listens."""
        return self._strangers[stack].result(PATIENCE)

    def wait(self, stack: str) -> float:
        """Seconds after which two who have not met will not; many times what it takes them."""
        return max(LEAST_WAIT, 6 * self.report(stack, CONTROL).trial_run.seconds)

    def _run(self, stack: str, name: str) -> TrialReport:
        case, installation = CASES[name], self._installations[stack]
        good = case.expected(installation) is None
        # `anyway`, for what an export would refuse too.
        trial = self._laboratory.trial(
            installation,
            case,
            timeout=LONGEST_MEETING if good else self.wait(stack),
            anyway=not good,
        )
        way = TopicRoute(sender=SENDER, receiver=RECEIVER, domain=0, topic=case.topic)
        return run_trial(trial, way)

    def _stranger(self, stack: str) -> TrialRun:
        installation, case = self._installations[stack], CASES[CONTROL]
        trial = self._laboratory.trial(installation, case, timeout=self.wait(stack))
        folder = Path(mkdtemp(dir=self._laboratory.folder))
        roles = [
            unauthenticated(installation, Act.SEND, folder, unique_text()),
            credentialed(trial, RECEIVER, Act.RECEIVE, folder),
        ]
        program = installation.peer(built(installation))
        setup = TrialSetup(program=program, domain=0, topic=TOPIC, timeout=trial.timeout)
        return run_peers(setup, roles)


def table(runs: Runs, installations: Mapping[str, Installation]) -> str:
    """What came of all."""
    titles = [each.title for each in installations.values()]
    lines = [["", *titles], ["---"] * (len(titles) + 1)]
    for name, case in CASES.items():
        reports = [runs.report(stack, name) for stack in installations]
        lines.append([case.title, *(cell(report, case) for report in reports)])
    heard = [runs.unauthenticated(stack).outcomes[1].received for stack in installations]
    lines.append(["sender without credentials", *("nothing" if h is None else h for h in heard)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cell(report: TrialReport, case: Case) -> str:
    """What came of a case, for the table."""
    if report.accepted:
        return (
            "meet, and an unauthenticated participant hears it"
            if report.unauthenticated_heard
            else "meet"
        )
    return f"refused: `{case.expected(report.installation)}`"
