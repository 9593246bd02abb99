"""A new generation of CAs: everybody comes along, and nothing of the old is trusted."""

import hashlib
import json
import shutil
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki._times import said
from pqsec_pki.algorithms import PROFILES, load_private_key, profile_named
from pqsec_pki.certificates import Reason, verify_chain
from pqsec_pki.documents import DomainSet, Governance, Grant, Kind, Permissions
from pqsec_pki.errors import (
    KeystoreError,
    MalformedError,
    PassphraseError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import Keystore, audit, governance_digest, status
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Renewal,
    Rollover,
    Scope,
    apply_rollover,
    issue,
    plan_rollover,
    renew,
    revoke,
    sign_document,
    sign_governance,
)
from pqsec_pki.lint import Severity, check
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.smime import verify
from tests.unit.keystores import DAY, NOW, TWO, add, made, rotate

LATER = NOW + 30 * DAY


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def rotated(keystore, profile=None, *, kept=None, passphrase=None, **terms):
    terms = Rollover(profile=profile_named(profile) if profile else keystore.profile, **terms)
    return rotate(keystore, terms, kept=kept, passphrase=passphrase, now=LATER)


def allowed(keystore, name):
    one = keystore.participant(name)
    verified = verify(
        one.permissions,
        one.permissions_ca,
        alternative_ca=one.countersigner,
        require=keystore.anchors.required,
    )
    [grant] = Permissions.from_xml(verified.document).grants
    return grant.rules


def errors_in(keystore):
    report = check([keystore.root], now=LATER)
    return [str(each) for each in report.findings if each.rule.severity is Severity.ERROR]


def assert_whole(keystore, names=TWO):
    """Every participant is the new CAs', they meet, and nothing complains."""
    twice = keystore.profile.alternative_key is not None
    for name in names:
        one = keystore.participant(name)
        verify_chain(one.certificate, keystore.identity_ca, now=LATER, require_alternative=twice)
        assert one.key.public_key.spki == one.certificate.spki
        assert (one.alternative_key is not None) == twice
        folder = keystore.root / f"enclaves{name}"
        assert not [path for path in folder.iterdir() if not path.exists()], "a link leads nowhere"
    setup = HandshakeSetup(keystore=keystore, domain=0, now=LATER)
    assert run_handshake(setup, *(HandshakeParty(name=name) for name in names[:2])).ok
    audit(keystore)
    assert errors_in(keystore) == []
    assert Keystore.open(keystore.root) == keystore
    assert not list(keystore.root.glob(".*"))


# What is made


@pytest.mark.parametrize("to", [profile.name for profile in PROFILES])
@pytest.mark.parametrize("start", ["classical", "transition", "pq"])
def test_everybody_comes_along_from_any_profile_to_any(tmp_path, start, to):
    keystore = made(tmp_path / "k", start)
    old, rules = keystore.identity_ca, allowed(keystore, "/talker")
    done = rotated(keystore, to)
    assert done.keystore.profile.name == to
    assert done.plan.generation == 2
    assert done.plan.left_out == {}
    assert [each.name for each in done.issued] == list(TWO)
    assert allowed(done.keystore, "/talker") == rules
    assert done.keystore.identity_ca.spki != old.spki
    assert_whole(done.keystore)


def test_keys_stay_where_the_profile_asks_for_no_other_kind(keystore):
    before = {name: keystore.participant(name).certificate for name in TWO}
    done = rotated(keystore)
    for name in TWO:
        after = done.keystore.participant(name).certificate
        assert after.spki == before[name].spki
        assert after.serial_number != before[name].serial_number
        assert after.not_after == LATER + 90 * DAY
    assert_whole(done.keystore)


def test_keys_are_new_if_that_is_asked_for(keystore):
    before = keystore.participant("/talker").certificate.spki
    done = rotated(keystore, rekey=True)
    assert done.keystore.participant("/talker").certificate.spki != before
    assert_whole(done.keystore)


def test_the_new_cas_are_named_after_the_old_with_their_generation(keystore):
    for number in (2, 3):
        keystore = rotated(keystore).keystore
        assert keystore.identity_ca.subject_name == f"CN=Test G{number} Identity CA"
        assert keystore.permissions_ca.subject_name == f"CN=Test G{number} Permissions CA"
    keystore = rotated(keystore, name="Fleet").keystore
    assert keystore.identity_ca.subject_name == "CN=Fleet Identity CA"


def test_a_governance_that_was_changed_is_signed_as_it_was(keystore):
    path = keystore.root / "enclaves/governance.p7s"
    xml = (keystore.root / "enclaves/governance.xml").read_bytes().replace(b"ENCRYPT", b"SIGN")
    authorities = keystore.unlock(None)
    sign_document(keystore, Kind.GOVERNANCE, xml, path, authorities, now=NOW, force=True)
    new = rotated(keystore).keystore
    assert b"SIGN" in verify(new.governance, new.permissions_ca).document
    assert verify(new.governance, new.permissions_ca).document.split() == xml.split()


def test_what_a_domain_file_wanted_is_still_found_in_the_ledger(keystore):
    governance = Governance.protected(DomainSet.of(0))
    authorities = keystore.unlock(None)
    sign_governance(keystore, authorities, governance, now=NOW, config_digest="governance's")
    spec = ParticipantSpec(
        name="/marked", domains=DomainSet.of(0), validity=90 * DAY, config_digest="its own"
    )
    issue(keystore, authorities, [spec], now=NOW)
    before = config_digests(keystore)
    new = rotated(keystore).keystore
    assert governance_digest(new) == governance_digest(keystore) == "governance's"
    assert config_digests(new) == before
    assert before["/marked"] == "its own"


def config_digests(keystore):
    return {each.name: each.config_digest for each in status(keystore, now=NOW).participants}


def test_the_ledger_has_both_generations(keystore):
    before = len(keystore.ledger())
    rotated(keystore)
    kinds = [each.kind for each in keystore.ledger()[before:]]
    assert sorted(kinds) == sorted(
        ["identity-ca", "permissions-ca", "governance", *["participant", "permissions"] * 2]
    )
    assert {each.state for each in status(keystore, now=LATER).participants} == {"valid"}


# One CA only


@pytest.mark.parametrize("scope", [Scope.IDENTITY, Scope.PERMISSIONS])
@pytest.mark.parametrize("profile", ["classical", "transition"])
def test_one_ca_may_stay(tmp_path, profile, scope):
    keystore = made(tmp_path / "k", profile)
    before = (keystore.identity_ca.der, keystore.permissions_ca.der)
    new = rotated(keystore, scope=scope, kept=keystore.unlock(None)).keystore
    after = (new.identity_ca.der, new.permissions_ca.der)
    stays = 1 if scope is Scope.IDENTITY else 0
    assert after[stays] == before[stays]
    assert after[1 - stays] != before[1 - stays]
    assert_whole(new)
    archived = {path.name for path in (new.root / "private/generations/1").iterdir()}
    assert all(name.startswith(f"{scope}_ca.") for name in archived)


def test_one_ca_cannot_stay_while_the_profile_changes(keystore):
    with pytest.raises(UsageError, match="a new profile applies to both CAs"):
        rotated(keystore, "pq", scope=Scope.IDENTITY, kept=keystore.unlock(None))


def test_cas_that_made_way_meanwhile_are_not_kept(keystore):
    kept = keystore.unlock(None)
    rotated(keystore)
    with pytest.raises(KeystoreError, match="has been replaced by another CA meanwhile"):
        rotated(keystore, scope=Scope.IDENTITY, kept=kept)


# The old CAs


def test_the_old_cas_are_kept_for_their_owner_only(keystore):
    old = {path.name: path.read_bytes() for path in keystore.root.glob("p*/*.pem")}
    done = rotated(keystore)
    assert done.plan.archive == keystore.root / "private/generations/1"
    assert {path.name: path.read_bytes() for path in done.plan.archive.iterdir()} == old
    assert done.plan.archive.stat().st_mode & 0o777 == 0o700
    keys = list(done.plan.archive.glob("*.key.pem"))
    assert len(keys) == 2
    assert {path.stat().st_mode & 0o777 for path in keys} == {0o600}


def test_old_keys_are_overwritten_if_that_is_wanted(keystore):
    path = keystore.root / "private/identity_ca.key.pem"
    size = path.stat().st_size
    with path.open("rb") as old_file:  # the file lives on without a name
        done = rotated(keystore, destroy=True)
        assert old_file.read() == bytes(size)
    assert sorted(path.name for path in done.plan.archive.iterdir()) == [
        "identity_ca.cert.pem",
        "permissions_ca.cert.pem",
    ]
    assert_whole(done.keystore)


def test_a_copy_that_shares_the_files_is_not_overwritten(keystore, tmp_path):
    copy = tmp_path / "backup.pem"
    copy.hardlink_to(keystore.root / "private/identity_ca.key.pem")
    rotated(keystore, destroy=True)
    load_private_key(copy.read_bytes())


def test_a_key_that_is_a_link_to_elsewhere_is_not_said_to_be_destroyed(keystore, tmp_path):
    path = keystore.root / "private/identity_ca.key.pem"
    path.rename(tmp_path / "stick.pem")
    path.symlink_to(tmp_path / "stick.pem")
    with pytest.raises(KeystoreError, match=r"is a link: pqsec does not destroy its target"):
        rotated(keystore, destroy=True)
    assert_whole(rotated(keystore).keystore)
    load_private_key((tmp_path / "stick.pem").read_bytes())


def test_old_cas_need_no_passphrase_and_new_ones_have_theirs(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    for key in (keystore.root / "private").glob("*.key.pem"):
        key.write_text("lost")
    new = rotated(keystore, passphrase=b"new").keystore
    with pytest.raises(PassphraseError):
        new.unlock(None)
    new.unlock(b"new")
    assert_whole(new)


def test_files_that_the_new_profile_has_no_use_for_go(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    new = rotated(keystore, "pq").keystore
    assert not list(new.root.glob("p*/*alt*"))
    assert not list((new.root / "enclaves").rglob("*alt*"))
    assert len(list((new.root / "private/generations/1").glob("*.alt.*"))) == 3


# Who is revoked, or has its key elsewhere


def test_the_revoked_stay_behind_and_the_new_list_is_empty(keystore):
    add(keystore, **{"/stolen": "0"})
    revoke(keystore, keystore.unlock(None), ["/stolen"], now=NOW)
    stolen = keystore.participant("/stolen").certificate
    done = rotated(keystore)
    new = done.keystore
    assert done.plan.left_out == {"/stolen": "revoked"}
    assert done.plan.new_list
    found = new.revocation_list
    found.verify(new.identity_ca)
    assert (found.number, found.revoked) == (1, ())
    assert new.participant("/stolen").certificate.der == stolen.der
    with pytest.raises(VerificationError):
        verify_chain(stolen, new.identity_ca, now=LATER)
    setup = HandshakeSetup(keystore=new, domain=0, now=LATER)
    assert run_handshake(setup, HandshakeParty(name="/talker"), HandshakeParty(name="/listener")).ok
    assert not run_handshake(
        setup, HandshakeParty(name="/talker"), HandshakeParty(name="/stolen")
    ).ok
    audit(new)


def test_a_key_that_is_elsewhere_is_certified_again(keystore):
    (keystore.root / "enclaves/talker/key.pem").unlink()
    before = keystore.root / "enclaves/talker/cert.pem"
    old = before.read_bytes()
    done = rotated(keystore, rekey=True)
    assert done.plan.left_out == {}
    assert before.read_bytes() != old
    assert not (keystore.root / "enclaves/talker/key.pem").exists()


def test_a_key_that_is_elsewhere_and_of_another_kind_stays_behind(keystore):
    (keystore.root / "enclaves/talker/key.pem").unlink()
    done = rotated(keystore, "pq")
    assert list(done.plan.left_out) == ["/talker"]
    assert "needs a new request" in done.plan.left_out["/talker"]
    assert [each.name for each in done.issued] == ["/listener"]
    states = {each.name: each.state for each in status(done.keystore, now=LATER).participants}
    assert states == {"/talker": "previous-ca", "/listener": "valid"}


def test_whose_policy_has_ended_stays_behind_and_is_in_nobodys_way(keystore):
    end = NOW + 10 * DAY
    grant = Grant.least(
        subject_name="CN=/x",
        not_before=NOW,
        not_after=end,
        domains=DomainSet.of(0),
        publish=("x",),
    )
    for name, late in (("/ended", timedelta()), ("/goes/on", 40 * DAY)):
        allowed_until = replace(grant, not_after=end + late)
        spec = ParticipantSpec(
            name=name, domains=DomainSet.of(0), validity=90 * DAY, grants=(allowed_until,)
        )
        issue(keystore, keystore.unlock(None), [spec], now=NOW)
    told = plan_rollover(keystore, Rollover(profile=keystore.profile), now=LATER).left_out
    done = rotated(keystore)
    assert done.plan.left_out == told == {"/ended": f"its permissions ended on {said(end)}"}
    assert sorted(each.name for each in done.issued) == sorted([*TWO, "/goes/on"])
    setup = HandshakeSetup(keystore=done.keystore, domain=0, now=LATER)
    assert run_handshake(setup, HandshakeParty(name="/talker"), HandshakeParty(name="/goes/on")).ok
    audit(done.keystore)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_key_that_was_revoked_as_compromised_is_not_certified_again(keystore, elsewhere):
    old = keystore.participant("/talker").certificate
    authorities = keystore.unlock(None)
    renew(keystore, authorities, ["/talker"], Renewal(rekey=False), now=NOW)
    serial = f"{old.serial_number:x}"  # of the same key, and the certificate before
    revoke(keystore, authorities, [serial], reason=Reason.KEY_COMPROMISE, now=NOW)
    if elsewhere:
        (keystore.root / "enclaves/talker/key.pem").unlink()
    told = plan_rollover(keystore, Rollover(profile=keystore.profile), now=LATER)
    done = rotated(keystore)
    assert done.plan.left_out == told.left_out
    if elsewhere:
        assert "compromised: it needs a new request" in done.plan.left_out["/talker"]
    else:
        assert told.rekeyed == ("/talker",)
        assert done.keystore.participant("/talker").certificate.spki != old.spki
        assert_whole(done.keystore)


def test_what_the_plan_says_is_done(keystore):
    authorities = keystore.unlock(None)
    add(keystore, **{"/compromised": "0", "/revoked": "0"})
    renew(keystore, authorities, ["/compromised"], Renewal(rekey=False), now=NOW)
    first = next(each for each in keystore.ledger() if each.name == "/compromised")
    revoke(keystore, authorities, [first.serial], reason=Reason.KEY_COMPROMISE, now=NOW)
    revoke(keystore, authorities, ["/revoked"], now=NOW)
    plan = plan_rollover(keystore, Rollover(profile=keystore.profile), now=LATER)
    assert plan.left_out == {"/revoked": "revoked"}
    assert (plan.keeping, plan.rekeyed) == (TWO, ("/compromised",))
    before = {name: keystore.participant(name).certificate.spki for name in keystore.names()}
    done = apply_rollover(keystore, plan, now=LATER)
    assert [each.name for each in done.issued] == ["/compromised", *TWO]
    same = {
        name
        for name, spki in before.items()
        if done.keystore.participant(name).certificate.spki == spki
    }
    assert same == {*plan.keeping, "/revoked"}
    assert "do not reissue /revoked: revoked" in plan.steps


def test_a_plan_is_not_executed_after_another_change(keystore):
    plan = plan_rollover(keystore, Rollover(profile=keystore.profile), now=LATER)
    add(keystore, **{"/new": "0"})
    before = digest(keystore.root)
    with pytest.raises(KeystoreError, match="changed after the plan was made") as caught:
        apply_rollover(keystore, plan, now=LATER)
    assert caught.value.hint == "run the command again"
    assert digest(keystore.root) == before


def test_who_stayed_behind_once_is_in_nobodys_way_later(keystore):
    (keystore.root / "enclaves/talker/key.pem").unlink()
    pq = rotated(keystore, "pq").keystore
    told = plan_rollover(pq, Rollover(profile=profile_named("classical")), now=LATER).left_out
    done = rotated(pq, "classical")  # the profile that its key is of
    assert done.plan.left_out == told
    assert done.plan.left_out == {"/talker": "it was not reissued before: its CA has been replaced"}
    assert [each.name for each in done.issued] == ["/listener"]
    audit(done.keystore)


# What is refused


def flaw(keystore, file, data):
    path = keystore.root / file
    path.write_bytes(data(path.read_bytes()))


@pytest.mark.parametrize(
    ("file", "data", "error", "message"),
    [
        (
            "enclaves/talker/permissions.p7s",
            lambda data: data.replace(b"DENY", b"ALLOW"),
            KeystoreError,
            "is not the newest permissions",
        ),
        (
            "enclaves/talker/cert.pem",
            lambda data: data.replace(b"-----BEGIN", b"-----NO", 1),
            MalformedError,
            "cert.pem",
        ),
        (
            "enclaves/governance.p7s",
            lambda data: data.replace(b"ENCRYPT", b"NONE"),
            VerificationError,
            "governance.p7s: the content was changed",
        ),
    ],
    ids=["altered permissions", "a lost certificate", "an altered governance"],
)
def test_nothing_is_done_with_files_that_are_not_the_cas(keystore, file, data, error, message):
    flaw(keystore, file, data)
    before = digest(keystore.root)
    with pytest.raises(error, match=message):
        rotated(keystore)
    assert digest(keystore.root) == before


def digest(root):
    files = [path for path in root.rglob("*") if path.is_file() and "sqlite" not in path.name]
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def unsigned(keystore):
    (keystore.root / "enclaves/governance.p7s").write_bytes(b"not signed")


def of_before(keystore):
    path = keystore.root / "enclaves/talker/permissions.p7s"
    before = path.read_bytes()
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    path.write_bytes(before)


def copied(keystore):
    shutil.copytree(keystore.root / "enclaves/talker", keystore.root / "enclaves/copied")


@pytest.mark.parametrize(
    ("flaw", "words", "hint"),
    [
        (unsigned, "governance.p7s: not an S/MIME", "sign-governance"),
        (of_before, "is not the newest permissions", "restore that file"),
        (copied, "the ledger has no certificate for /copied", "move its folder out"),
    ],
)
def test_the_plan_tells_what_would_stop_it(keystore, flaw, words, hint):
    flaw(keystore)
    for work in (rotated, lambda k: plan_rollover(k, Rollover(profile=k.profile), now=LATER)):
        with pytest.raises(PqsecError, match=words) as caught:
            work(keystore)
        assert hint in caught.value.hint


def lost(keystore):
    (keystore.root / "private/ledger.sqlite3").unlink()


def from_a_backup(keystore):
    path = keystore.root / "private/ledger.sqlite3"
    before = path.read_bytes()
    add(keystore, **{"/new": "0"})
    path.write_bytes(before)
    (keystore.root / "public/ledger.checkpoint").unlink()


@pytest.mark.parametrize(
    ("ledger", "words"),
    [(lost, "ledger"), (from_a_backup, "the ledger has no certificate for /new")],
)
def test_a_ledger_that_is_not_whole_is_no_reason_to_leave_robots_behind(keystore, ledger, words):
    ledger(keystore)
    before = digest(keystore.root)
    with pytest.raises(KeystoreError, match=words):
        rotated(keystore)
    assert digest(keystore.root) == before


@pytest.mark.parametrize(("folder", "number"), [("7", 9), ("1²", 2), ("old", 2), ("0", 2)])
def test_generations_are_counted_by_folders_that_are_numbers(keystore, folder, number):
    (keystore.root / "private/generations" / folder).mkdir(parents=True)
    assert rotated(keystore).plan.generation == number


def test_a_name_that_grows_too_long_is_refused_with_the_way_out(tmp_path):
    keystore = Keystore.create(
        tmp_path / "k",
        profile_named("classical"),
        name="N" * 49,
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    with pytest.raises(UsageError, match="has 67") as caught:
        rotated(keystore)
    assert "--name" in caught.value.hint
    assert rotated(keystore, name="Short").keystore.identity_ca.subject_name.startswith("CN=Short")


def test_a_ca_that_expired_cannot_stay(keystore):
    late = NOW + 1000 * DAY
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    kept = keystore.unlock(None)
    with pytest.raises(KeystoreError, match="Permissions CA expired on") as caught:
        rotate(keystore, terms, kept=kept, passphrase=None, now=late)
    assert "pqsec ca rotate" in caught.value.hint
    both = replace(terms, scope=Scope.BOTH)
    new = rotate(keystore, both, passphrase=None, now=late).keystore
    audit(new)
    assert {each.state for each in status(new, now=late).participants} == {"valid"}


def test_who_unlocked_the_cas_before_cannot_issue_after(keystore):
    old = keystore.unlock(None)
    new = rotated(keystore).keystore
    governance = (new.root / "enclaves/governance.xml").read_bytes()
    for work in (
        lambda: renew(new, old, ["/talker"], now=LATER),
        lambda: revoke(new, old, ["/talker"], now=LATER),
        lambda: sign_document(new, Kind.GOVERNANCE, governance, new.root / "x.p7s", old, now=LATER),
    ):
        with pytest.raises(KeystoreError, match="has been replaced by another CA meanwhile"):
            work()
    assert_whole(new)


def test_settings_name_the_new_profile(keystore):
    rotated(keystore, "transition")
    settings = json.loads((keystore.root / "pqsec.json").read_text())
    assert settings["algorithms"][0]["profile"] == "transition"
    assert settings["domains"] == "0"


def test_a_copy_can_be_rotated_too(keystore, tmp_path):
    shutil.copytree(keystore.root, tmp_path / "copy", symlinks=True)
    assert_whole(rotated(Keystore.open(tmp_path / "copy"), validity=timedelta(days=365)).keystore)


# What the journal says is removed


@pytest.mark.parametrize("place", ["../outside", "enclaves/../../outside", "/outside", "a\0b"])
def test_a_journal_removes_nothing_outside_the_keystore(keystore, place):
    (keystore.root.parent / "outside").write_text("precious")
    (keystore.root / ".journal").mkdir()
    moves = {"targets": [], "removed": [place], "entries": []}
    (keystore.root / ".journal/moves.json").write_text(json.dumps(moves))
    with pytest.raises(KeystoreError, match="this unfinished change cannot be read"):
        Keystore.open(keystore.root, to_change=True)
    assert (keystore.root.parent / "outside").read_text() == "precious"


def test_a_journal_removes_nothing_through_a_link(keystore, tmp_path):
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim/key.pem").write_text("precious")
    (keystore.root / "enclaves/new").symlink_to(tmp_path / "victim")
    (keystore.root / ".journal").mkdir()
    moves = {"targets": [], "removed": ["enclaves/new/key.pem"], "entries": []}
    (keystore.root / ".journal/moves.json").write_text(json.dumps(moves))
    with pytest.raises(KeystoreError, match="should be a folder, and is not"):
        Keystore.open(keystore.root, to_change=True)
    assert (tmp_path / "victim/key.pem").read_text() == "precious"


def test_a_folder_where_a_key_should_be_stops_it_before_anything_is_done(tmp_path):
    keystore = made(tmp_path / "k", "transition")
    path = keystore.root / "enclaves/talker/alt.key.pem"
    path.unlink()
    path.mkdir()
    before = digest(keystore.root)
    with pytest.raises(KeystoreError, match="should be a file, and is a folder"):
        rotated(keystore, "pq")
    assert digest(keystore.root) == before
    assert not list(keystore.root.glob(".*"))
