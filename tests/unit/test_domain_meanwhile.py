"""Between a plan and its steps another command was at work: nothing is done twice, or undone."""

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.domain import StepAction, apply_plan, read_domain
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import audit
from pqsec_pki.lifecycle import Rollover, revoke
from tests.unit.domains import DAY, NAMES, NOW, damage
from tests.unit.keystores import rotate
from tests.unit.killing import at_once, check_whole


def serials(scene):
    return {each.name: each.serial for each in scene.keystore.ledger() if each.serial}


def drop_certificate(scene):
    scene.file_of("/r1", "cert.pem").unlink()


def spoil_certificate(scene):
    damage(scene.file_of("/r1", "cert.pem"))


def another_role(scene):
    scene.change("rt/cmd", "rt/order")


def one_more(scene):
    scene.change("1..3", "1..4")


def one_less(scene):
    scene.change("1..3", "1..2")
    scene.change("name: Lab", "name: Lab\nprune: true")


def nothing(scene):
    """Only time passes."""


@pytest.mark.parametrize(
    ("what", "days", "action"),
    [
        (drop_certificate, 0, StepAction.REPLACE),
        (spoil_certificate, 0, StepAction.REPLACE),
        (another_role, 0, StepAction.SIGN_PERMISSIONS),
        (one_more, 0, StepAction.ISSUE),
        (one_less, 0, StepAction.REVOKE),
        (nothing, 70, StepAction.RENEW),
    ],
    ids=lambda each: getattr(each, "__name__", None),
)
def test_what_another_apply_did_is_not_done_again(scene, what, days, action):
    now = NOW + days * DAY
    what(scene)
    found = scene.plan(now)
    assert {step.action for step in found.steps} == {action}
    scene.apply(now)  # the other command
    before, lines = serials(scene), len(scene.keystore.ledger())
    assert scene.take(found, now) == []
    assert serials(scene) == before
    assert len(scene.keystore.ledger()) == lines
    assert scene.plan(now).in_order


def test_a_governance_that_another_apply_signed_is_not_signed_again(scene):
    scene.change("name: Lab", "name: Lab\ngovernance: authenticated")
    found = scene.plan()
    scene.apply()
    assert scene.take(found) == []


def test_what_is_left_of_the_plan_is_done(scene):
    another_role(scene)
    found = scene.plan()
    text = scene.file.read_text()
    scene.write(text.replace("1..3", "1..2"))
    scene.apply()  # the other command knows of /r1 and /r2
    scene.write(text)
    assert scene.take(found) == [(StepAction.SIGN_PERMISSIONS, "/r3")]
    assert scene.plan().in_order


def test_who_was_revoked_meanwhile_stays_so(scene):
    now = NOW + 70 * DAY
    found = scene.plan(now)
    keystore = scene.keystore
    revoke(keystore, keystore.unlock(None), ["/r2"], now=now)
    assert sorted(name for _, name in scene.take(found, now)) == ["/monitor", "/r1", "/r3"]
    assert [each.name for each in scene.plan(now).blocked] == ["/r2"]


def test_new_cas_meanwhile_end_it(scene):
    another_role(scene)
    found = scene.plan()
    desired, keystore = read_domain(scene.file), scene.keystore
    authorities = keystore.unlock(None)
    terms = Rollover(profile=profile_named("classical"))
    rotate(scene.keystore, terms, passphrase=None, now=NOW)
    with pytest.raises(KeystoreError, match="has been replaced by another CA meanwhile"):
        list(apply_plan(desired, keystore, authorities, found, now=NOW))
    assert scene.allowed("/r1")[1] == ["rt/cmd"]


def test_who_holds_a_keystore_may_change_it_and_others_wait(scene, monkeypatch):
    monkeypatch.setattr("pqsec_pki.keystore._lock.PATIENCE", 0)
    another_role(scene)
    with scene.keystore.hold():
        codes = at_once(scene.apply, scene.apply)
        assert codes == [1, 1]
        scene.apply()
    assert scene.plan().in_order
    assert at_once(scene.apply) == [0]


def test_two_that_begin_with_one_plan_make_everybody_once(scene):
    scene.change("1..3", "1..12")
    drop_certificate(scene)
    found = scene.plan()
    codes = at_once(lambda: scene.take(found), lambda: scene.take(found))
    assert codes == [0, 0]
    entries = [each for each in scene.keystore.ledger() if each.kind == "participant"]
    assert len(entries) == len(NAMES) + 9 + 1
    assert scene.plan().in_order
    for name in ("/r1", "/r12"):
        check_whole(scene.keystore, name)
    audit(scene.keystore)
