"""Every step of an overlap is done or not, whenever the kill comes; and a rerun completes it."""

import shutil
from functools import partial
from pathlib import Path

import pytest

from pqsec_pki.algorithms import load_private_key
from pqsec_pki.keystore import Keystore, Overlap, audit
from pqsec_pki.lifecycle import Rollover, Scope
from tests.unit.keystores import begin_overlap, cancel_overlap, finish_overlap, switch_overlap
from tests.unit.killing import NOW, check_commitment, copies, drafts, empty_list, issue_to
from tests.unit.linting import check_nothing_broken

pytestmark = pytest.mark.usefixtures("links_count_too")

ROBOT = "/fleet/robot1"
RARELY = 5
"""What takes long is looked at after each so many calls."""


def step(name: str, root: Path) -> None:
    keystore = Keystore.open(root, to_change=True)
    if name in {"begin", "switch"}:
        take = {"begin": begin_overlap, "switch": switch_overlap}[name]
        terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
        take(keystore, terms, kept=keystore.unlock(None), passphrase=None, now=NOW)
    else:
        {"finish": finish_overlap, "cancel": cancel_overlap}[name](keystore, now=NOW)


def phase_of(root: Path) -> str:
    """How far it is, after everything was found to fit together."""
    keystore = Keystore.open(root, to_change=True)
    audit(keystore)
    authorities, overlap = keystore.unlock(None), Overlap.of(keystore)
    begun = overlap is not None and overlap.phase == "begun"
    keys = sorted(root.glob("private/next*"))
    assert bool(keys) == begun
    if begun:
        found = {load_private_key(path.read_bytes()).public_key.spki for path in keys}
        assert found == {overlap.other.spki, overlap.other.alternative_key.spki}
    issuing = authorities.identity.certificate
    assert keystore.participant(ROBOT).certificate.issuer_der == issuing.subject_der
    return overlap.phase if overlap else issuing.subject_name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "name", "every"),
    [
        ((), "begin", 25),
        (("begin",), "cancel", 25),
        (("begin",), "switch", 13),
        (("begin", "switch"), "finish", 25),
    ],
)
def test_a_step_is_done_or_not_whenever_the_kill_comes(place, prepared, before, name, every):
    original = place / "original"
    shutil.copytree(prepared((ROBOT,)), original, symlinks=True)
    if name == "begin":
        empty_list(original)  # which goes
    for each in before:
        step(each, original)
    start, outcomes = phase_of(original), []
    for root, _ in copies(place, original, partial(step, name), every=every):
        found = phase_of(root)
        outcomes.append(found != start)
        if len(outcomes) % RARELY:
            continue
        check_nothing_broken(root)
        if not outcomes[-1]:
            step(name, root)
            assert phase_of(root) != start
        issue_to(root, "/next")
        assert drafts(root) == []
        assert (root / "public/identity_ca.crl.pem").exists() is False
    check_commitment(outcomes, every)
