"""Keystores of several machines with one ledger, and what must hold for them."""

import shutil
from pathlib import Path

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore, LedgerAddress, audit, checked_head
from pqsec_pki.lifecycle import ParticipantSpec, issue
from tests.unit.killing import NOW, YEAR


def create(root: Path, ledger: LedgerAddress | None = None) -> Keystore:
    return Keystore.create(
        root,
        profile_named("classical"),
        name="Lab",
        domains=DomainSet.of(0),
        validity=10 * YEAR,
        passphrase=None,
        ledger=ledger,
        now=NOW,
    )


def issue_to(root: Path, *names: str, force: bool = False) -> Keystore:
    keystore = Keystore.open(root, to_change=True)
    specs = [ParticipantSpec(name=name, domains=DomainSet.of(0), validity=YEAR) for name in names]
    issue(keystore, keystore.unlock(None), specs, now=NOW, force=force)
    return keystore


def copied(keystore: Keystore, root: Path) -> Keystore:
    shutil.copytree(keystore.root, root, symlinks=True)
    return Keystore.open(root, to_change=True)


def check_whole(*machines: Keystore) -> None:
    """One chain, one head; no serial twice; each file here has its line."""
    for each in machines:
        lines, _ = audit(each)
        serials = [line.serial for line in each.ledger() if line.kind == "participant"]
        assert len(set(serials)) == len(serials)
        assert checked_head(each).head.size <= lines
    assert len({each.head for each in machines}) == 1


def settled(keystore: Keystore, name: str) -> bool:
    """Whether the participant was issued, after recovery; files and lines must agree."""
    Keystore.recover(keystore.root)
    assert not [*keystore.root.glob(".journal"), *keystore.root.glob(".prepared")]
    check_whole(keystore)
    in_ledger = any(each.name == name for each in keystore.ledger())
    assert keystore.has(name) == in_ledger
    return in_ledger
