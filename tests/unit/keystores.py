"""Keystores for tests of the self-check, made by the library as the command line does."""

import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore, change
from pqsec_pki.lifecycle import (
    OverlapStep,
    ParticipantSpec,
    Rollover,
    Scope,
    apply_rollover,
    issue,
    plan_rollover,
)

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
DAY = timedelta(days=1)
TWO = ("/listener", "/talker")


def made(root, profile, domains="0", names=TWO, subscribe=()):
    """A keystore with these participants; `names` may say on which domains each is.

    `profile` may be several, with commas: a set of credentials for each.

    Those of one name in their folders have the same keys: each is made once in a process, and then
    copied.
    """
    placed = names if isinstance(names, dict) else dict.fromkeys(names, domains)
    kept = _kept(root.name, profile, domains, tuple(placed.items()), tuple(subscribe))
    shutil.copytree(Path(kept.name) / "k", root, symlinks=True)
    return Keystore.open(root, to_change=True)


@cache
def _kept(_name, profile, domains, placed, subscribe):
    folder = TemporaryDirectory()
    keystore = Keystore.create(
        Path(folder.name) / "k",
        *map(profile_named, profile.split(",")),
        name="Test",
        domains=DomainSet.parse(domains),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    add(keystore, subscribe=subscribe, **dict(placed))
    return folder


def add(keystore, *, now=NOW, subscribe=(), **names):
    """Issue participants for 90 days: name=domains."""
    specs = [
        ParticipantSpec(
            name=name,
            domains=DomainSet.parse(on),
            publish=("x",),
            subscribe=subscribe,
            validity=90 * DAY,
        )
        for name, on in names.items()
    ]
    issue(keystore, keystore.unlock(None), specs, now=now)


def enter(keystore, entries):
    """Lines into the ledger as they are: by who may write it."""
    with change(keystore.root) as draft:
        draft.entries += entries


def take(keystore, file, source, goal):
    """The file of one participant takes the place of another's."""
    enclaves = keystore.root / "enclaves"
    shutil.copyfile(enclaves / source.strip("/") / file, enclaves / goal.strip("/") / file)


def adopt(keystore, other, name):
    """A participant of another keystore, with all it trusts, takes the place of ours."""
    goal = keystore.root / f"enclaves{name}"
    shutil.rmtree(goal)
    shutil.copytree(other.root / f"enclaves{name}", goal, symlinks=False)


def rotate(keystore, terms, *, now, **keys):
    """Replace the CAs as the plan says."""
    with keystore.hold():
        return apply_rollover(keystore, plan_rollover(keystore, terms, now=now), now=now, **keys)


def begin_overlap(keystore, terms, **how):
    return rotate(keystore, replace(terms, overlap=OverlapStep.BEGIN), **how)


def switch_overlap(keystore, terms, **how):
    return rotate(keystore, replace(terms, overlap=OverlapStep.SWITCH), **how)


def finish_overlap(keystore, *, now):
    return _end(keystore, OverlapStep.FINISH, now)


def cancel_overlap(keystore, *, now):
    return _end(keystore, OverlapStep.CANCEL, now)


def _end(keystore, step, now):
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY, overlap=step)
    return rotate(keystore, terms, now=now).overlap
