"""The trial: two participants with credentials, and one without."""

import os
import tempfile
from collections.abc import Iterable
from dataclasses import field
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import Keystore, regular_name
from pqsec_pki.trial.agent_runs import TrialPlugin
from pqsec_pki.trial.building import built, source
from pqsec_pki.trial.findings import LogFinding, findings
from pqsec_pki.trial.installation import Installation
from pqsec_pki.trial.peer import Act, PeerOutcome, TrialRole
from pqsec_pki.trial.running import TrialRun, TrialSetup, run_peers, unique_text
from pqsec_pki.trial.topics import TopicRoute
from pqsec_pki.vendors import Options, StackEnclave, export, write

UNAUTHENTICATED = "a participant without credentials"
_IN_MEMORY = Path("/dev/shm")  # noqa: S108 -- writable for all like /tmp, and used like it


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The options of a trial."""

    installation: Installation
    receiving: Installation | None = None
    """The receiver's, if it runs another stack than the others."""
    keystore: Keystore
    timeout: float
    """Seconds to wait for the sample."""
    password: str | None = field(default=None, repr=False)
    """The passphrase of the participants' keys, if they are encrypted."""
    anyway: bool = False
    """Whether to try credentials that the stack is known to refuse."""
    plugin: TrialPlugin | None = None
    """pqsec's plugin, if it is to run in the stack."""
    stock: tuple[str, ...] = ()
    """Participants that run the stack's own plugins nevertheless."""
    now: datetime

    def installation_of(self, act: Act) -> Installation:
        """The stack of the participant with this role."""
        return (act is Act.RECEIVE and self.receiving) or self.installation

    def plugin_of(self, name: str) -> TrialPlugin | None:
        """The plugin that this participant runs; None for the stack's own."""
        return None if regular_name(name) in map(regular_name, self.stock) else self.plugin


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialReport:
    """The result of a trial."""

    installations: tuple[Installation, ...]
    """The stack of the sender, and of the receiver if it is another."""
    topic_route: TopicRoute
    sender: PeerOutcome
    receiver: PeerOutcome
    unauthenticated: PeerOutcome
    trial_run: TrialRun
    plugged: tuple[str, ...] = ()
    """Participants that ran pqsec's plugin."""

    @property
    def accepted(self) -> bool:
        """Whether the sample arrived unchanged."""
        return self.receiver.received == self.sender.role.text

    @property
    def unauthenticated_heard(self) -> bool | None:
        """Whether the participant without credentials got the sample; None if that was not
        tested: nothing was sent, or it did not join."""
        if self.unauthenticated.received is not None:
            return True
        took_part = self.unauthenticated.joined and self.unauthenticated.signal is None
        return False if self.accepted and took_part else None

    @property
    def readable(self) -> bool | None:
        """Whether the sample was readable on the wire; None if the wire could not be captured."""
        wire = self.trial_run.wire
        if not (wire and wire.packets and self.accepted):
            return None
        return True if wire.readable else None if wire.lost else False

    @property
    def findings(self) -> tuple[LogFinding, ...]:
        """Why the trial failed; empty if it did not."""
        if self.accepted:
            return ()
        stacks = self.installations[0].build.stack, self.installations[-1].build.stack
        both = list(zip((self.sender, self.receiver), stacks, strict=True))
        return findings(both, topic=self.topic_route.topic, by_standard=bool(self.plugged))

    @property
    def installation(self) -> Installation:
        """The sender's."""
        return self.installations[0]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the check before the exports."""
        both = self.sender.role.warnings + self.receiver.role.warnings
        return tuple(dict.fromkeys(both))

    @property
    def ok(self) -> bool:
        """Whether the sample arrived, and the unauthenticated participant did not get it."""
        return self.accepted and self.unauthenticated_heard is False

    def to_json(self) -> dict[str, object]:
        """The report for --json; `receiving` is the receiver's stack, if it is another."""
        wire, others = self.trial_run.wire, self.installations[1:]
        return {
            **_stack(self.installation),
            "receiving": _stack(others[0]) if others else None,
            "plugin": self.plugged,
            "domain": self.topic_route.domain,
            "topic": self.topic_route.topic,
            "sender": self.sender.role.name,
            "receiver": self.receiver.role.name,
            "ok": self.ok,
            "accepted": self.accepted,
            "seconds": round(self.trial_run.seconds, 2),
            "unauthenticated_heard": self.unauthenticated_heard,
            "readable": self.readable,
            "packets": wire.packets if wire else None,
            "own_network": self.trial_run.alone,
            "findings": self.findings,
            "warnings": self.warnings,
        }


def _stack(installation: Installation) -> dict[str, object]:
    return {
        "stack": installation.build.stack,
        "stack_version": installation.version,
        "library": installation.library.path,
    }


def refuse_untrusted(keystore: Keystore, names: Iterable[str], now: datetime) -> None:
    """VerificationError if the credentials of one of them cannot be trusted at `now`.

    For a check before `topic_route` reads their documents; `run_trial` refuses them too.
    """
    problems = [each for name in names for each in StackEnclave.find(keystore, name).refusals(now)]
    if problems:
        raise VerificationError(*problems, hint="`pqsec check` shows more; --anyway tries them")


def run_trial(trial: Trial, topic_route: TopicRoute) -> TrialReport:
    """Run the two participants and an unauthenticated one on this machine, a process each.

    VerificationError if the credentials cannot be trusted or the stack is known to refuse them
    (unless `trial.anyway`); BuildError and FileError if the peer cannot be built.
    """
    installation = trial.installation
    with (
        disk_errors(Path(tempfile.gettempdir())),
        tempfile.TemporaryDirectory(prefix="pqsec-trial-", dir=in_memory()) as name,
    ):
        folder = Path(name)
        roles = [
            credentialed(trial, topic_route.sender, Act.SEND, folder, unique_text()),
            credentialed(trial, topic_route.receiver, Act.RECEIVE, folder),
            unauthenticated(installation, Act.RECEIVE, folder),
        ]
        setup = TrialSetup(
            program=installation.peer(built(installation)),
            domain=topic_route.domain,
            topic=topic_route.topic,
            timeout=trial.timeout,
        )
        trial_run = run_peers(setup, roles)
    sender, receiver, third = trial_run.outcomes
    return TrialReport(
        installations=(installation, trial.receiving) if trial.receiving else (installation,),
        topic_route=topic_route,
        sender=sender,
        receiver=receiver,
        unauthenticated=third,
        trial_run=trial_run,
        plugged=tuple(
            each.role.name for each in (sender, receiver) if trial.plugin_of(each.role.name)
        ),
    )


def in_memory() -> Path | None:
    """A folder in memory, if there is one: configurations may hold a passphrase, and a killed
    trial cannot remove them. Fast DDS 3.1.2 reads them only from a path."""
    return _IN_MEMORY if os.access(_IN_MEMORY, os.W_OK) else None


def credentialed(trial: Trial, name: str, act: Act, folder: Path, text: str = "") -> TrialRole:
    """The role of a participant of the keystore, configured by `pqsec export`.

    Its configuration is written into `folder`, one for each act.
    """
    installation, plugin = trial.installation_of(act), trial.plugin_of(name)
    options = Options(
        version=installation.version,
        loopback=True,
        password=trial.password,
        anyway=trial.anyway,
        plugins=installation.plugins,
        plugin=plugin.folder if plugin else None,
    )
    made = export(installation.build.stack, trial.keystore, name, options, now=trial.now)
    place = folder / act.value
    write(made, place)
    return TrialRole(
        name=made.participant,
        act=act,
        text=text,
        environment={**made.variables(place), **(plugin.environment if plugin else {})},
        warnings=made.warnings,
        program=tuple(installation.peer(built(installation))) if trial.receiving else (),
    )


def unauthenticated(
    installation: Installation, act: Act, folder: Path, text: str = ""
) -> TrialRole:
    """The role of a participant without credentials; its configuration goes into `folder`."""
    build = installation.build
    path = folder / build.open
    path.write_bytes(source(build.open))
    environment = {build.variable: str(path)}
    return TrialRole(
        name=UNAUTHENTICATED, act=act, text=text, environment=environment, unauthenticated=True
    )
