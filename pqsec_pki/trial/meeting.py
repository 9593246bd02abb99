"""The trial: two participants with their credentials, and a stranger without."""

import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import disk_errors
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import Keystore, regular_name
from pqsec_pki.trial.building import built, source
from pqsec_pki.trial.findings import Finding, findings
from pqsec_pki.trial.installation import Installation
from pqsec_pki.trial.peer import Account, Act, Role
from pqsec_pki.trial.plugin import Plugin
from pqsec_pki.trial.scene import Performance, Scene, mark, perform
from pqsec_pki.trial.topics import Passage
from pqsec_pki.vendors import Enclave, Options, export, stack_named, write

STRANGER = "a participant without credentials"
_IN_MEMORY = Path("/dev/shm")  # noqa: S108 -- open to all as /tmp is, and used like it


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What is tried."""

    installation: Installation
    keystore: Keystore
    timeout: float
    """Seconds to wait for the sample."""
    password: str | None = field(default=None, repr=False)
    """Of the participants' keys, where they are encrypted."""
    anyway: bool = False
    """Whether to try what the stack is known to refuse."""
    plugin: Plugin | None = None
    """pqsec's own, if that is to run in the stack."""
    stock: tuple[str, ...] = ()
    """Who runs the stack's own plugins all the same."""
    now: datetime

    def plugin_of(self, name: str) -> Plugin | None:
        """What this participant runs in place of the stack's own."""
        return None if regular_name(name) in map(regular_name, self.stock) else self.plugin


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """How it went."""

    installation: Installation
    passage: Passage
    sender: Account
    receiver: Account
    stranger: Account
    performance: Performance
    plugged: tuple[str, ...] = ()
    """Who ran pqsec's own plugin."""

    @property
    def accepted(self) -> bool:
        """Whether the sample arrived, as it was sent."""
        return self.receiver.received == self.sender.role.text

    @property
    def stranger_heard(self) -> bool | None:
        """Whether the one without credentials got the sample; None if it was not put to the
        test: nothing was sent, or it did not take part."""
        if self.stranger.received is not None:
            return True
        took_part = self.stranger.joined and self.stranger.signal is None
        return False if self.accepted and took_part else None

    @property
    def readable(self) -> bool | None:
        """Whether the sample could be read on the wire; None if that was not to be seen."""
        wire = self.performance.wire
        if not (wire and wire.packets and self.accepted):
            return None
        return True if wire.readable else None if wire.lost else False

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Why it came to nothing, where it did."""
        if self.accepted:
            return ()
        stack, topic = self.installation.kit.stack, self.passage.topic
        both = (self.sender, self.receiver)
        return findings(both, stack=stack, topic=topic, by_standard=bool(self.plugged))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the check that came before the exports."""
        both = self.sender.role.warnings + self.receiver.role.warnings
        return tuple(dict.fromkeys(both))

    @property
    def ok(self) -> bool:
        """Whether the two met and the stranger got nothing."""
        return self.accepted and self.stranger_heard is False


def refuse_untrusted(keystore: Keystore, names: Iterable[str], now: datetime) -> None:
    """VerificationError if the credentials of one of them cannot be trusted at `now`.

    For who asks before a topic is looked for in their documents; `meet` refuses them too.
    """
    problems = [each for name in names for each in Enclave.find(keystore, name).refusals(now)]
    if problems:
        raise VerificationError(*problems, hint="`pqsec check` tells more; --anyway tries them")


def meet(trial: Trial, passage: Passage) -> Report:
    """Let the two meet on this machine: a process each, and one for the stranger.

    VerificationError if the credentials cannot be trusted or the stack is known to refuse them
    (unless `trial.anyway`), BuildError and FileError where the peer cannot be made.
    """
    installation = trial.installation
    with (
        disk_errors(Path(tempfile.gettempdir())),
        tempfile.TemporaryDirectory(prefix="pqsec-trial-", dir=_memory()) as name,
    ):
        folder = Path(name)
        roles = [
            credentialed(trial, passage.sender, Act.SEND, folder, mark()),
            credentialed(trial, passage.receiver, Act.RECEIVE, folder),
            stranger(installation, Act.RECEIVE, folder),
        ]
        scene = Scene(
            program=installation.peer(built(installation)),
            domain=passage.domain,
            topic=passage.topic,
            timeout=trial.timeout,
        )
        performance = perform(scene, roles)
    sender, receiver, third = performance.accounts
    return Report(
        installation=installation,
        passage=passage,
        sender=sender,
        receiver=receiver,
        stranger=third,
        performance=performance,
        plugged=tuple(
            each.role.name for each in (sender, receiver) if trial.plugin_of(each.role.name)
        ),
    )


def _memory() -> Path | None:
    """A folder on no disk, if there is one: configurations may hold a passphrase, and a trial
    that is killed cannot remove them. Fast DDS 3.1.2 reads them at a path only."""
    return _IN_MEMORY if os.access(_IN_MEMORY, os.W_OK) else None


def credentialed(trial: Trial, name: str, act: Act, folder: Path, text: str = "") -> Role:
    """A participant of the keystore, run as `pqsec export` says.

    Its configuration goes into `folder`, one for each act.
    """
    installation, plugin = trial.installation, trial.plugin_of(name)
    options = Options(
        version=installation.version,
        loopback=True,
        password=trial.password,
        anyway=trial.anyway,
        plugins=installation.plugins,
        plugin=plugin.folder if plugin else None,
    )
    stack = stack_named(installation.kit.stack)
    made = export(stack, trial.keystore, name, options, now=trial.now)
    place = folder / act.value
    write(made, place)
    return Role(
        name=made.participant,
        act=act,
        text=text,
        environment={**made.variables(place), **(plugin.environment if plugin else {})},
        warnings=made.warnings,
    )


def stranger(installation: Installation, act: Act, folder: Path, text: str = "") -> Role:
    """A participant without credentials; its configuration goes into `folder`."""
    kit = installation.kit
    path = folder / kit.open
    path.write_bytes(source(kit.open))
    environment = {kit.variable: str(path)}
    return Role(name=STRANGER, act=act, text=text, environment=environment, stranger=True)
