"""Keystores of each profile on the way, one after the other, in a folder that is thrown away."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Rollover,
    RolloverPlan,
    apply_rollover,
    issue,
    plan_rollover,
)
from pqsec_pki.migration._remover import make_writable

SAMPLES = ("/a", "/b")
"""The participants of a sample keystore. `a` and `b` make either side initiate in turn."""
_VALIDITY = timedelta(days=30)
_TOPIC = "rt/chatter"


@dataclass(frozen=True, slots=True)
class Generation:
    """The keystore after one rollover."""

    keystore: Keystore
    rollover: RolloverPlan | None
    """How it was made; None for the first one."""

    @property
    def profile(self) -> Profile:
        """Its profile."""
        return self.keystore.profile


def sample(root: Path, profile: Profile, now: datetime) -> Keystore:
    """A new keystore at `root`, with two participants that share a topic."""
    keystore = Keystore.create(
        root,
        profile,
        name="Sample",
        domains=DomainSet.parse("0"),
        validity=2 * _VALIDITY,
        passphrase=None,
        now=now,
    )
    specs = [
        ParticipantSpec(
            name=name,
            domains=keystore.domains,
            publish=(_TOPIC,),
            subscribe=(_TOPIC,),
            validity=_VALIDITY,
        )
        for name in SAMPLES
    ]
    issue(keystore, keystore.unlock(None), specs, now=now)
    return keystore


def generations(
    first: Keystore, profiles: tuple[Profile, ...], folder: Path, now: datetime
) -> Iterator[Generation]:
    """The generation of `first`, then one for each of `profiles`, each in its own part of `folder`.

    Each is a copy of the one before, with a rollover as `pqsec ca rotate --profile --apply` does
    it. `first` is not changed. The new CA keys have no passphrase: they are thrown away.
    """
    current = Generation(first, None)
    yield current
    for number, profile in enumerate(profiles, 1):
        root = folder / f"generation{number}"
        copied(current.keystore.root, root)
        # a copy is not trusted, so it needs no approvals
        keystore = replace(Keystore.open(root, to_change=True), approved=True)
        plan = plan_rollover(keystore, Rollover(profile=profile), now=now)
        current = Generation(apply_rollover(keystore, plan, now=now).keystore, plan)
        yield current


def copied(root: Path, to: Path) -> None:
    """Copy the keystore at `root`; the copy can be changed, even if `root` cannot.

    FileError if anything in `root` cannot be copied, such as a named pipe.
    """
    try:
        shutil.copytree(root, to, symlinks=True)
    except shutil.Error as error:
        where, _, why = error.args[0][0]
        raise FileError(f"cannot be copied for a rehearsal ({why})", where=where) from None
    make_writable(to)
