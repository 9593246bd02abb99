"""Two identity CAs are trusted at once, and robots go from one to the other without a gap."""

import shutil

import pytest

from pqsec_pki.algorithms import is_encrypted, load_private_key
from pqsec_pki.certificates import Certificate, RevokedCertificate, revocation_list, verify_chain
from pqsec_pki.errors import KeystoreError, PassphraseError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore, Overlap, Phase, audit, status
from pqsec_pki.lifecycle import (
    Rollover,
    Scope,
    change_passphrase,
    plan_rollover,
    renew,
    renew_list,
    revoke,
)
from tests.unit.keystores import (
    DAY,
    NOW,
    TWO,
    add,
    begin_overlap,
    cancel_overlap,
    finish_overlap,
    made,
    rotate,
    switch_overlap,
)
from tests.unit.plugin_wire import RefusedError, shaken, side
from tests.unit.test_ledger import alter

LATER = NOW + 30 * DAY


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def terms(keystore, **more):
    return Rollover(profile=keystore.profile, **{"scope": Scope.IDENTITY, **more})


def begin(keystore, passphrase=None, **more):
    kept = keystore.unlock(passphrase)
    how = terms(keystore, **more)
    return begin_overlap(keystore, how, kept=kept, passphrase=passphrase, now=LATER)


def switch(keystore, passphrase=None, **more):
    kept = keystore.unlock(passphrase)
    how = terms(keystore, **more)
    return switch_overlap(keystore, how, kept=kept, passphrase=passphrase, now=LATER)


def finish(keystore):
    return finish_overlap(keystore, now=LATER)


def cancel(keystore):
    return cancel_overlap(keystore, now=LATER)


STEPS = {"begun": [begin], "switched": [begin, switch]}


def brought_to(keystore, phase):
    for step in STEPS[phase]:
        step(keystore)
    return keystore


def trusted_in(folder):
    return Certificate.all_from_pem((folder / "identity_ca.cert.pem").read_bytes())


def takes(folder, other):
    """Whether who has these files takes the certificate of who has those."""
    peer = Certificate.from_pem((other / "cert.pem").read_bytes())
    twice = peer.alternative is not None
    for ca in trusted_in(folder):
        try:
            verify_chain(peer, ca, now=LATER, require_alternative=twice)
        except VerificationError:
            continue
        return True
    return False


def snapshot(root):
    files = [path for path in root.rglob("*") if path.is_file() and "ledger." not in path.name]
    return {path.relative_to(root): path.read_bytes() for path in files}


@pytest.mark.parametrize("details", ["{}", '{"overlap": "x"}', "no JSON"])
def test_a_damaged_line_about_two_cas_is_an_error_of_ours(keystore, details):
    begin(keystore)
    alter(keystore, "UPDATE ledger SET details = 'X' WHERE kind = 'trust'".replace("X", details))
    with pytest.raises(KeystoreError, match=r"line on trust CN=.* is damaged"):
        Overlap.of(keystore)


# The way there


@pytest.mark.parametrize("profile", ["classical", "transition", "hybrid", "pq"])
def test_robots_of_a_round_take_those_of_the_round_before_and_after(tmp_path, profile):
    keystore = made(tmp_path / "k", profile)
    robots = []
    for number, step in enumerate([None, begin, switch, finish]):
        if step:
            step(keystore)
        audit(keystore)
        robots.append(tmp_path / f"robot{number}")
        shutil.copytree(keystore.root / "enclaves/talker", robots[-1])
    meet = [[takes(a, b) and takes(b, a) for b in robots] for a in robots]
    assert meet == [
        [True, True, False, False],
        [True, True, True, False],
        [False, True, True, True],
        [False, False, True, True],
    ]


def test_the_old_ca_issues_until_it_is_switched(keystore):
    old = keystore.identity_ca
    begun = begin(keystore)
    assert begun.plan.generation == 2
    found = Overlap.of(keystore)
    assert found.phase is begun.overlap.phase is Phase.BEGUN
    assert found.issuing.der == begun.overlap.issuing.der == old.der
    assert found.other.der == begun.overlap.other.der
    assert begun.overlap.other.subject_name == "CN=Test G2 Identity CA"
    add(keystore, now=LATER, **{"/late": "0"})
    renew(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    for name in (*TWO, "/late"):
        verify_chain(keystore.participant(name).certificate, old, now=LATER)
        assert len(trusted_in(keystore.root / f"enclaves{name}")) == 2
    audit(keystore)


def test_the_new_ca_issues_all_anew_once_it_is_switched(keystore):
    new = begin(keystore).overlap.other
    permissions_ca = keystore.permissions_ca.der
    keys = {name: keystore.participant(name).certificate.spki for name in TWO}
    done = switch(keystore)
    assert (done.plan.generation, sorted(each.name for each in done.issued)) == (2, list(TWO))
    assert keystore.identity_ca.der == new.der
    assert keystore.permissions_ca.der == permissions_ca
    assert Overlap.of(keystore).phase is Phase.SWITCHED
    add(keystore, now=LATER, **{"/late": "0"})
    for name in (*TWO, "/late"):
        verify_chain(keystore.participant(name).certificate, new, now=LATER)
    assert {name: keystore.participant(name).certificate.spki for name in TWO} == keys
    assert not list(keystore.root.glob("private/next*"))
    states = {each.state for each in status(keystore, now=LATER).participants}
    assert states == {"valid"}
    audit(keystore)


def test_at_the_end_the_new_ca_alone_is_trusted(keystore):
    old = keystore.identity_ca
    brought_to(keystore, "switched")
    assert finish(keystore).other.der == old.der
    assert Overlap.of(keystore) is None
    assert [each.der for each in trusted_in(keystore.root / "public")] == [keystore.identity_ca.der]
    audit(keystore)
    rotate(keystore, Rollover(profile=keystore.profile), passphrase=None, now=LATER)
    assert keystore.identity_ca.subject_name == "CN=Test G3 Identity CA"


def test_what_has_begun_is_taken_back(keystore):
    before = snapshot(keystore.root)
    for _ in range(2):
        begin(keystore)
        key = keystore.root / "private/next_identity_ca.key.pem"
        size = key.stat().st_size
        with key.open("rb") as file:  # it lives on without a name
            cancel(keystore)
            assert file.read() == bytes(size)
        assert snapshot(keystore.root) == before
        audit(keystore)
    brought_to(keystore, "switched")


def test_the_ledger_tells_of_each_step(keystore):
    for step in (begin, cancel, begin, switch, finish):
        step(keystore)
    for step in (begin, cancel, begin, cancel):  # each ends with the same file
        step(keystore)
    lines = [each for each in keystore.ledger() if each.kind.startswith("trust")]
    begun = ["begun", "cancelled"]
    assert [each.details["overlap"] for each in lines] == [
        *begun,
        *("begun", "switched", "finished"),
        *begun,
        *begun,
    ]


def test_new_keys_and_an_old_ca_without_its_key_if_that_is_wanted(keystore):
    begin(keystore, name="Fleet", validity=400 * DAY)
    assert Overlap.of(keystore).other.subject_name == "CN=Fleet Identity CA"
    before = keystore.participant("/talker").certificate.spki
    done = switch(keystore, rekey=True, destroy=True)
    assert keystore.participant("/talker").certificate.spki != before
    assert [path.name for path in done.plan.archive.iterdir()] == ["identity_ca.cert.pem"]
    finish(keystore)


def test_a_key_that_is_on_its_robot_is_certified_by_the_new_ca(keystore):
    (keystore.root / "enclaves/talker/key.pem").unlink()
    begin(keystore)
    assert switch(keystore).plan.left_out == {}
    path = keystore.root / "enclaves/talker/cert.pem"
    verify_chain(Certificate.from_pem(path.read_bytes()), keystore.identity_ca, now=LATER)


@pytest.fixture
def robots(tmp_path):
    """The files of one robot in each round."""
    keystore, found = made(tmp_path / "k", "pq"), []
    for number, step in enumerate([None, begin_overlap, switch_overlap, finish_overlap]):
        if step is finish_overlap:
            step(keystore, now=NOW)
        elif step:
            kept = keystore.unlock(None)
            step(keystore, terms(keystore), kept=kept, passphrase=None, now=NOW)
        found.append(tmp_path / f"robot{number}")
        shutil.copytree(keystore.root / "enclaves/talker", found[-1])
    return found


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 3)])
def test_pqsecs_plugin_meets_robots_of_the_round_before_and_after(robots, pair):
    one, other = (robots[number] for number in pair)
    assert shaken(side(one), side(other))
    assert shaken(side(other), side(one))


@pytest.mark.parametrize("pair", [(0, 2), (1, 3), (0, 3)])
def test_pqsecs_plugin_refuses_who_missed_a_round(robots, pair):
    one, other = (robots[number] for number in pair)
    with pytest.raises(RefusedError, match=r"was issued by CN=Test .*, not by CN=Test"):
        shaken(side(one), side(other))


def test_pqsecs_plugin_trusts_one_ca_beside_a_revocation_list(tmp_path):
    keystore = made(tmp_path / "listed", "pq")
    renew_list(keystore, keystore.unlock(None), now=NOW)
    folder = keystore.root / "enclaves/talker"
    other = made(tmp_path / "other", "pq")
    for trusting, peer in ((keystore, other), (other, keystore)):
        path = trusting.root / "public/identity_ca.cert.pem"
        path.write_bytes(path.read_bytes() + peer.identity_ca.pem)
    peer = side(other.root / "enclaves/talker")
    assert shaken(side(folder), peer)
    list_of_one = {"org.eclipse.cyclonedds.sec.auth.crl": f"file:{folder}/crl.pem"}
    with pytest.raises(RefusedError, match="not signed by this CA"):
        shaken(side(folder, **list_of_one), peer)


def test_an_enclave_with_a_ca_file_of_its_own_gets_the_link(keystore):
    path = keystore.root / "enclaves/talker/identity_ca.cert.pem"
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)
    begin(keystore)
    assert len(trusted_in(path.parent)) == 2
    assert path.is_symlink()
    audit(keystore)


# Passphrases


def test_the_next_ca_has_the_passphrase_of_the_others(keystore):
    change_passphrase(keystore, keystore.unlock(None), b"right")
    begin(keystore, b"right")
    key = keystore.root / "private/next_identity_ca.key.pem"
    assert is_encrypted(key.read_bytes())
    assert key.stat().st_mode & 0o777 == 0o600
    with pytest.raises(PassphraseError):
        switch(keystore, b"wrong")
    switch(keystore, b"right")
    keystore.unlock(b"right")


def test_the_passphrase_stays_while_the_next_ca_has_a_key_of_its_own(keystore):
    begin(keystore)
    with pytest.raises(KeystoreError, match="would keep the old passphrase") as caught:
        change_passphrase(keystore, keystore.unlock(None), b"new")
    assert "--overlap switch" in caught.value.hint
    switch(keystore)
    change_passphrase(keystore, keystore.unlock(None), b"new")
    finish(keystore)


# What is refused


@pytest.mark.parametrize(
    ("phase", "step", "words"),
    [
        ("none", switch, "no overlap has begun"),
        ("none", finish, "no overlap has begun"),
        ("none", cancel, "no overlap has begun"),
        ("begun", begin, "an overlap has begun already"),
        ("begun", finish, "the overlap is begun"),
        ("switched", begin, "an overlap has begun already"),
        ("switched", switch, "the overlap is switched"),
        ("switched", cancel, "the overlap is switched"),
    ],
)
def test_a_step_that_is_not_due_changes_nothing(keystore, phase, step, words):
    brought_to(keystore, phase) if phase != "none" else None
    before = snapshot(keystore.root)
    with pytest.raises(KeystoreError, match=words) as caught:
        step(keystore)
    assert "pqsec ca rotate --overlap" in caught.value.hint
    assert snapshot(keystore.root) == before


def rotated(keystore):
    rotate(keystore, Rollover(profile=keystore.profile), passphrase=None, now=LATER)


def permissions_rotated(keystore):
    only = terms(keystore, scope=Scope.PERMISSIONS)
    rotate(keystore, only, kept=keystore.unlock(None), passphrase=None, now=LATER)


def foreseen(keystore):
    plan_rollover(keystore, Rollover(profile=keystore.profile), now=LATER)


def revoked(keystore):
    revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER)


def listed(keystore):
    renew_list(keystore, keystore.unlock(None), now=LATER)


@pytest.mark.parametrize("phase", list(STEPS))
@pytest.mark.parametrize("work", [rotated, permissions_rotated, foreseen, revoked, listed])
def test_what_cannot_be_while_two_are_trusted_has_to_wait(keystore, phase, work):
    brought_to(keystore, phase)
    before, lines = snapshot(keystore.root), len(keystore.ledger())
    with pytest.raises(KeystoreError, match="two identity CAs are trusted") as caught:
        work(keystore)
    assert "--overlap" in caught.value.hint
    assert (snapshot(keystore.root), len(keystore.ledger())) == (before, lines)
    while Overlap.of(keystore):
        (finish if Overlap.of(keystore).phase is Phase.SWITCHED else cancel)(keystore)
    work(keystore)


@pytest.mark.parametrize("scope", [Scope.BOTH, Scope.PERMISSIONS])
def test_an_overlap_of_permissions_cas_is_refused(keystore, scope):
    with pytest.raises(UsageError, match="no stack trusts two permissions CAs"):
        begin(keystore, scope=scope)


def test_two_cas_of_one_name_are_refused(keystore):
    before = snapshot(keystore.root)
    with pytest.raises(UsageError, match="is the name of the old identity CA"):
        begin(keystore, name="Test")
    assert snapshot(keystore.root) == before


def test_another_profile_is_no_overlap(tmp_path, keystore):
    other = made(tmp_path / "other", "pq").profile
    how = Rollover(profile=other, scope=Scope.IDENTITY)
    with pytest.raises(UsageError, match="a new profile applies to both CAs"):
        begin_overlap(keystore, how, kept=keystore.unlock(None), passphrase=None, now=LATER)


@pytest.mark.parametrize("lost", [False, True])
def test_who_is_revoked_is_not_let_in_again_by_an_overlap(keystore, lost):
    revoked(keystore)
    if lost:
        (keystore.root / "public/identity_ca.crl.pem").unlink()
    before = snapshot(keystore.root)
    with pytest.raises(KeystoreError, match=r"1 revoked would be accepted again \((/|serial)"):
        begin(keystore)
    assert snapshot(keystore.root) == before


def test_who_is_revoked_in_the_list_alone_is_not_let_in_again_either(keystore):
    """As after a ledger was lost."""
    revoked = RevokedCertificate(4711, NOW, None)
    made = revocation_list(
        keystore.unlock(None).identity, [revoked], number=1, now=NOW, validity=90 * DAY
    )
    (keystore.root / "public/identity_ca.crl.pem").write_bytes(made.pem)
    with pytest.raises(KeystoreError, match=r"1 revoked would be accepted again \((/|serial)"):
        begin(keystore)


def test_who_was_revoked_and_has_ended_is_in_nobodys_way(keystore):
    revoked(keystore)
    late = NOW + 91 * DAY
    begun = begin_overlap(
        keystore, terms(keystore), kept=keystore.unlock(None), passphrase=None, now=late
    )
    assert begun.plan.drop_list


def test_a_list_that_names_nobody_is_gone_and_comes_back_with_the_next_revocation(keystore):
    listed(keystore)
    assert begin(keystore).plan.drop_list
    assert not list(keystore.root.rglob("*crl.pem"))
    audit(keystore)
    switch(keystore)
    finish(keystore)
    revoked(keystore)
    assert keystore.participant("/listener").revocation_list.revoked
    audit(keystore)


# What others do to it


def test_a_second_ca_that_others_put_there_is_no_overlap_and_shows(tmp_path, keystore):
    rogue = made(tmp_path / "other", "classical").identity_ca
    path = keystore.root / "public/identity_ca.cert.pem"
    path.write_bytes(path.read_bytes() + rogue.pem)
    assert Overlap.of(keystore) is None
    with pytest.raises(VerificationError, match=r"identity_ca\.cert\.pem is not in the ledger"):
        audit(keystore)
    begin(keystore)  # which writes the file again
    audit(keystore)


@pytest.mark.parametrize("steps", [[begin, switch, finish], [begin, cancel, begin, cancel]])
def test_a_ca_that_is_put_back_after_the_end_shows(keystore, steps):
    path = keystore.root / "public/identity_ca.cert.pem"
    for step in steps:
        both = path.read_bytes()
        step(keystore)
    path.write_bytes(both)
    assert Overlap.of(keystore) is None
    with pytest.raises(VerificationError, match="has 2 certificates, but the ledger"):
        audit(keystore)


def test_a_key_that_is_not_the_next_cas_does_not_issue(tmp_path, keystore):
    begin(keystore)
    other = made(tmp_path / "other", "classical")
    key = keystore.root / "private/next_identity_ca.key.pem"
    key.write_bytes((other.root / "private/identity_ca.key.pem").read_bytes())
    before = snapshot(keystore.root)
    with pytest.raises(KeystoreError, match="a private key does not match the certificate"):
        switch(keystore)
    assert snapshot(keystore.root) == before


def test_the_next_ca_of_an_overlap_that_was_cancelled_meanwhile_does_not_issue(keystore):
    begin(keystore)
    old, kept = keystore.root.parent / "copy", keystore.unlock(None)
    shutil.copytree(keystore.root, old, symlinks=True)
    cancel(keystore)
    begin(keystore)
    for name in ("private/next_identity_ca.key.pem", "public/identity_ca.cert.pem"):
        shutil.copy(old / name, keystore.root / name)
    with pytest.raises(KeystoreError):
        switch_overlap(keystore, terms(keystore), kept=kept, passphrase=None, now=LATER)
    load_private_key((keystore.root / "private/identity_ca.key.pem").read_bytes())


def test_a_copy_goes_on_where_the_original_was(keystore, tmp_path):
    begin(keystore)
    shutil.copytree(keystore.root, tmp_path / "copy", symlinks=True)
    copy = Keystore.open(tmp_path / "copy")
    switch(copy)
    finish(copy)
    assert Overlap.of(keystore).phase is Phase.BEGUN
