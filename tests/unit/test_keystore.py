"""The keystore: what lies where, who may read it, and what it refuses."""

import fcntl
import hashlib
import json
import os
import resource
import sqlite3
import stat
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from pqsec_pki import __version__
from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.certificates import verify_authority, verify_chain
from pqsec_pki.documents import DomainSet, Governance, Kind, Permissions, validate
from pqsec_pki.errors import (
    ExistsError,
    FileError,
    KeystoreError,
    MalformedError,
    PassphraseError,
    PqsecError,
    UsageError,
)
from pqsec_pki.keystore import Keystore, _lock, audit, load_certificate
from pqsec_pki.lifecycle import ParticipantSpec, adopt, issue, revoke, sign_document
from pqsec_pki.smime import Require, verify
from tests.unit.killing import fork

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
CLASSICAL, TRANSITION = profile_named("classical"), profile_named("transition")
CA_FILES = ["identity_ca.cert.pem", "permissions_ca.cert.pem"]
SIX_FILES = {
    *("cert.pem", "key.pem", "identity_ca.cert.pem", "permissions_ca.cert.pem"),
    *("governance.p7s", "permissions.p7s"),
}


def create(root, profile=CLASSICAL, **options):
    given = {
        "name": "Lab",
        "domains": DomainSet.of(0),
        "validity": 10 * YEAR,
        "passphrase": None,
        "now": NOW,
    }
    return Keystore.create(root, profile, **(given | options))


def spec(name, **options):
    given = {"domains": DomainSet.of(0), "publish": ("rt/chatter",), "validity": YEAR}
    return ParticipantSpec(name=name, **(given | options))


def issue_to(keystore, *names, now=NOW, force=False, **options):
    specs = [spec(name, **options) for name in names]
    return issue(keystore, keystore.unlock(None), specs, now=now, force=force)


@pytest.fixture
def root(tmp_path):
    return tmp_path / "keystore"


@pytest.fixture
def keystore(root):
    return create(root)


def mode(path):
    return stat.S_IMODE(path.lstat().st_mode)


def tree(root):
    """Every file under `root` and its bytes, but for the database's own."""
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and "ledger.sqlite3" not in path.name
    }


def check_whole(keystore, name):
    """The participant has everything it needs, and all of it fits together."""
    participant = keystore.participant(name)
    profile, has_second = keystore.profile, keystore.profile.alternative_key is not None
    assert participant.key.public_key.spki == participant.certificate.spki
    verify_chain(
        participant.certificate, participant.identity_ca, now=NOW, require_alternative=has_second
    )
    if has_second:
        alternative = participant.alternative_key.public_key.spki
        assert alternative == participant.certificate.alternative_key.spki
    require = Require.BOTH if has_second else Require.ANY
    for document in (participant.permissions, participant.governance):
        verified = verify(
            document,
            participant.permissions_ca,
            alternative_ca=participant.countersigner,
            require=require,
        )
        assert verified.unchecked == 0
    signed = verify(participant.permissions, participant.permissions_ca).document
    [grant] = Permissions.from_xml(signed).grants
    assert grant.subject_name == participant.certificate.subject_name == f"CN={name}"
    assert participant.key.algorithm is profile.participant_key


# What is made


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_a_keystore_of_every_profile_issues_whole_participants(root, profile):
    keystore = create(root, profile)
    assert Keystore.open(root) == keystore
    [issued] = issue_to(keystore, "/talker")
    check_whole(keystore, "/talker")
    folder = root / "enclaves" / "talker"
    assert {path.name for path in folder.iterdir()} >= SIX_FILES
    assert issued.certificate_size == len((folder / "cert.pem").read_bytes())
    assert issued.permissions_size == len((folder / "permissions.p7s").read_bytes())
    assert issued.not_after == keystore.participant("talker").certificate.not_after
    for ca in (keystore.identity_ca, keystore.permissions_ca):
        verify_authority(ca, now=NOW)
    assert (keystore.countersigner is None) == (profile.alternative_key is None)


def test_a_changed_profile_is_kept(root):
    create(root, TRANSITION.changed({"permissions_key": "rsa-2048", "alternative_key": "mldsa87"}))
    keystore = Keystore.open(root)
    issue_to(keystore, "/talker")
    check_whole(keystore, "/talker")
    assert keystore.permissions_ca.public_key.algorithm.name == "rsa-2048"


def test_the_two_authorities_are_never_the_same(root):
    keystore = create(root, TRANSITION)
    certificates = [keystore.identity_ca, keystore.permissions_ca, keystore.countersigner]
    assert len({each.spki for each in certificates}) == 3
    assert len({each.subject_name for each in certificates}) == 3


def test_the_governance_is_signed_and_readable(keystore, root):
    verified = verify(keystore.governance, keystore.permissions_ca)
    assert validate(verified.document) is Kind.GOVERNANCE
    plain = (root / "enclaves" / "governance.xml").read_bytes()
    assert Governance.from_xml(plain) == Governance.from_xml(verified.document)


def test_links_lead_to_the_shared_files(keystore, root):
    issue_to(keystore, "/talker", "/fleet/eu/robot1")
    for folder in (root / "enclaves/talker", root / "enclaves/fleet/eu/robot1"):
        for name in CA_FILES:
            assert (folder / name).is_symlink()
            assert not (folder / name).readlink().is_absolute()
            assert (folder / name).read_bytes() == (root / "public" / name).read_bytes()
        assert (folder / "governance.p7s").read_bytes() == keystore.governance


def test_a_keystore_can_be_moved(keystore, root):
    issue_to(keystore, "/fleet/robot1")
    moved = root.rename(root.with_name("elsewhere"))
    check_whole(Keystore.open(moved), "/fleet/robot1")


def test_permissions_say_what_was_wished_for(keystore):
    issue_to(keystore, "/talker", publish=("rt/a", "rt/b"), subscribe=("rt/c",))
    signed = keystore.participant("/talker").permissions
    [grant] = Permissions.from_xml(verify(signed, keystore.permissions_ca).document).grants
    [rule] = [rule for rule in grant.rules if rule.allow]
    topics = [topic for criteria in rule.publish for topic in criteria.topics]
    assert topics == ["rt/a", "rt/b"]
    certificate = keystore.participant("/talker").certificate
    assert (grant.not_before, grant.not_after) == (certificate.not_before, certificate.not_after)


def test_names_are_made_regular_and_listed(keystore):
    issue_to(keystore, "talker", "//fleet//robot1/", "/fleet")
    assert keystore.names() == ["/fleet", "/fleet/robot1", "/talker"]
    assert keystore.participant("fleet/robot1/").name == "/fleet/robot1"
    for name in keystore.names():
        check_whole(keystore, name)


def test_the_ledger_has_everything_that_was_issued(root):
    keystore = create(root, TRANSITION)
    issue_to(keystore, "/a", "/b", now=NOW + YEAR)
    entries = keystore.ledger()
    kinds = [entry.kind for entry in entries]
    assert (
        kinds
        == ["identity-ca", "permissions-ca", "permissions-ca", "governance"]
        + [
            "participant",
            "permissions",
        ]
        * 2
    )
    by_name = {(entry.kind, entry.name): entry for entry in entries}
    certificate = keystore.participant("/a").certificate
    entry = by_name["participant", "/a"]
    assert entry.at == "2027-11-21T12:00:00+00:00"
    assert entry.serial == f"{certificate.serial_number:x}"
    assert entry.sha256 == certificate.fingerprint
    assert entry.not_after == certificate.not_after.isoformat()


def signed_governance(keystore, goal, **options):
    xml = Governance.protected(DomainSet.of(0)).to_xml()
    unlocked = keystore.unlock(None)
    given = {"now": NOW} | options
    return sign_document(keystore, Kind.GOVERNANCE, xml, goal, unlocked, **given)


def test_a_signed_document_is_entered_in_the_ledger(keystore, tmp_path):
    signed = signed_governance(keystore, tmp_path / "g.p7s")
    assert (tmp_path / "g.p7s").read_bytes() == signed
    assert keystore.ledger()[-1].name == str(tmp_path / "g.p7s")
    assert keystore.ledger()[-1].sha256 == hashlib.sha256(signed).hexdigest()


def test_a_document_that_cannot_be_written_is_not_in_the_ledger(keystore, tmp_path):
    before = keystore.ledger()
    (tmp_path / "g.p7s").write_text("mine")
    with pytest.raises(ExistsError):
        signed_governance(keystore, tmp_path / "g.p7s")
    with pytest.raises(FileError):
        signed_governance(keystore, tmp_path / "no/folder/g.p7s")
    assert keystore.ledger() == before
    assert (tmp_path / "g.p7s").read_text() == "mine"


def test_a_document_that_cannot_be_entered_is_not_written(keystore, root, tmp_path):
    for file in (root / "private").glob("ledger.sqlite3*"):
        file.unlink()
    (root / "private/ledger.sqlite3").write_bytes(b"not a database" * 100)
    with pytest.raises(KeystoreError, match="not a ledger"):
        signed_governance(keystore, tmp_path / "g.p7s")
    assert not (tmp_path / "g.p7s").exists()
    assert not (root / ".journal").exists()


def test_a_file_name_of_any_bytes_can_be_entered(keystore, tmp_path):
    goal = tmp_path / os.fsdecode(b"g\xff.p7s")
    signed_governance(keystore, goal)
    assert keystore.ledger()[-1].name.endswith("g\\xff.p7s")


def test_an_expired_permissions_ca_signs_nothing(keystore, tmp_path):
    with pytest.raises(KeystoreError, match="CN=Lab Permissions CA expired on 2036-11-18"):
        signed_governance(keystore, tmp_path / "g.p7s", now=NOW + 11 * YEAR)


def test_lines_of_the_ledger_are_only_added(keystore, root):
    with closing(sqlite3.connect(root / "private/ledger.sqlite3")) as database:
        for statement in ("DELETE FROM ledger", "UPDATE ledger SET name = 'x'"):
            with pytest.raises(sqlite3.IntegrityError, match="lines are only added"):
                database.execute(statement)


@pytest.mark.parametrize("place", ["private/ledger.sqlite3", "private"])
def test_a_ledger_behind_a_link_is_refused(keystore, root, tmp_path, place):
    for file in (root / "private").glob("ledger.sqlite3-*"):
        file.unlink()
    (root / place).rename(tmp_path / "elsewhere")
    (root / place).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(KeystoreError, match=f"{place} should be a f"):
        issue_to(keystore, "/new")
    assert keystore.names() == []


@pytest.mark.parametrize("kind", ["link", "file"])
def test_leftovers_of_any_kind_are_swept_away(keystore, root, tmp_path, kind):
    if kind == "link":
        (root / ".draft-x").symlink_to(tmp_path)
    else:
        (root / ".draft-x").write_text("")
    issue_to(keystore, "/new")
    assert keystore.names() == ["/new"]
    assert not (root / ".draft-x").is_symlink()
    assert not (root / ".draft-x").exists()
    assert tmp_path.is_dir()


def test_one_key_for_both_cas_is_refused(keystore, root):
    for kind in ("public/{}.cert.pem", "private/{}.key.pem"):
        data = (root / kind.format("identity_ca")).read_bytes()
        (root / kind.format("permissions_ca")).write_bytes(data)
    with pytest.raises(
        KeystoreError, match="the identity CA and the permissions CA have the same key"
    ):
        keystore.unlock(None)


def test_a_forced_issue_replaces_key_certificate_and_permissions(keystore):
    issue_to(keystore, "/talker")
    old = keystore.participant("/talker")
    issue_to(keystore, "/talker", force=True)
    new = keystore.participant("/talker")
    assert new.certificate.spki != old.certificate.spki
    assert new.permissions != old.permissions
    check_whole(keystore, "/talker")
    lines = [entry for entry in keystore.ledger() if entry.kind == "participant"]
    assert [entry.sha256 for entry in lines] == [
        old.certificate.fingerprint,
        new.certificate.fingerprint,
    ]


def test_what_the_user_put_beside_a_participant_stays(keystore, root):
    issue_to(keystore, "/talker")
    (root / "enclaves/talker/notes.txt").write_bytes(b"mine")
    issue_to(keystore, "/talker", force=True)
    assert (root / "enclaves/talker/notes.txt").read_bytes() == b"mine"


# Who may read it


@pytest.mark.usefixtures("umask")
def test_keys_are_private_whatever_the_umask(root):
    keystore = create(root, TRANSITION)
    issue_to(keystore, "/fleet/robot1", "/talker")
    issue_to(keystore, "/talker", force=True)
    keys = list(root.rglob("*key.pem"))
    assert len(keys) == 4 + 2 * 2
    assert {mode(key) for key in keys} == {0o600}
    assert {mode(key.parent) for key in keys} == {0o700}
    others = [path for path in root.rglob("*.pem") if path not in keys and not path.is_symlink()]
    assert {mode(path) for path in others} == {0o644}
    assert mode(root / "pqsec.json") == 0o644
    assert mode(root / "private/ledger.sqlite3") == 0o600


@pytest.mark.usefixtures("umask")
def test_nobody_else_may_write_anywhere_whatever_the_umask(root):
    keystore = create(root, TRANSITION)
    issue_to(keystore, "/fleet/eu/robot1", "/talker")
    paths = [root, *(path for path in root.rglob("*") if not path.is_symlink())]
    assert [path for path in paths if mode(path) & 0o022] == []


def test_a_folder_that_the_user_closed_stays_closed(root):
    root.mkdir(mode=0o700)
    keystore = create(root)
    assert mode(root) == 0o700
    issue_to(keystore, "/talker")
    (root / "enclaves/talker").chmod(0o500)
    issue_to(keystore, "/talker", force=True)
    assert mode(root / "enclaves/talker") == 0o500


def test_a_folder_that_others_may_write_in_is_refused(root):
    root.mkdir()
    root.chmod(0o777)
    with pytest.raises(KeystoreError, match="anybody may write there") as refused:
        create(root)
    assert refused.value.hint == f"chmod go-w {root}"
    assert list(root.iterdir()) == []
    root.chmod(0o755)
    create(root)


# Passphrases


def test_a_locked_keystore_opens_with_its_passphrase_only(root):
    keystore = create(root, TRANSITION, passphrase=b"horse")
    assert keystore.is_locked()
    assert not create(root.with_name("other")).is_locked()
    for wrong in (None, b"", b"cow"):
        with pytest.raises(PassphraseError) as caught:
            keystore.unlock(wrong)
        assert "passphrase" in caught.value.hint
        assert ".key.pem" in str(caught.value)
    authorities = keystore.unlock(b"horse")
    issue(keystore, authorities, [spec("/talker")], now=NOW)
    check_whole(keystore, "/talker")
    assert "Key(" not in repr(authorities)
    assert "Key(" not in repr(keystore.participant("/talker"))


def test_keys_of_another_keystore_are_refused(root):
    keystore, other = create(root, TRANSITION), create(root.with_name("other"), TRANSITION)
    for key in (root / "private").glob("*.key.pem"):
        mine = key.read_bytes()
        key.write_bytes((other.root / "private" / key.name).read_bytes())
        with pytest.raises(
            KeystoreError, match=r"CN=Lab .*: a private key does not match the certificate"
        ):
            keystore.unlock(None)
        key.write_bytes(mine)
    keystore.unlock(None)


# What is refused


def test_a_keystore_is_never_made_twice(keystore, root):
    before = tree(root)
    with pytest.raises(ExistsError, match="already has") as caught:
        create(root)
    assert "never overwritten" in caught.value.hint
    assert tree(root) == before


@pytest.mark.parametrize("name", ["private", "public", "enclaves", "pqsec.json"])
def test_a_folder_that_could_be_a_keystore_is_left_alone(root, name):
    (root / name).mkdir(parents=True)
    with pytest.raises(ExistsError, match=f"already has {name}"):
        create(root)
    assert [path.name for path in root.iterdir()] == [name]


def test_a_keystore_is_made_in_a_folder_with_other_things(root):
    root.mkdir()
    (root / "README").write_bytes(b"mine")
    create(root)
    assert (root / "README").read_bytes() == b"mine"


@pytest.mark.parametrize(
    "options", [{"name": "x" * 60}, {"name": "Läb"}, {"validity": timedelta()}]
)
def test_a_keystore_that_cannot_be_made_leaves_nothing(root, options):
    with pytest.raises(UsageError):
        create(root, TRANSITION, **options)
    assert not root.exists()


def test_a_participant_is_not_issued_twice_unless_forced(keystore, root):
    issue_to(keystore, "/talker")
    before = tree(root)
    with pytest.raises(ExistsError, match="already issued: /talker"):
        issue_to(keystore, "/listener", "/talker")
    assert tree(root) == before
    assert keystore.names() == ["/talker"]


def test_a_participant_that_another_command_is_issuing_is_not_replaced(keystore, root):
    """The other command was killed after its commitment: its change is finished first."""
    authorities = keystore.unlock(None)
    child = fork()
    if child == 0:
        rename = os.rename

        def kill_after(source, goal, **options):
            rename(source, goal, **options)
            os._exit(9)

        os.rename = kill_after
        issue(keystore, authorities, [spec("/talker")], now=NOW)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert (root / ".journal").is_dir()
    theirs = [path.read_bytes() for path in (root / ".journal").rglob("cert.pem")]
    with pytest.raises(ExistsError, match="already issued: /talker"):
        issue(keystore, authorities, [spec("/talker")], now=NOW)
    assert [(root / "enclaves/talker/cert.pem").read_bytes()] == theirs
    check_whole(keystore, "/talker")


def test_a_name_asked_for_twice_is_refused(keystore):
    with pytest.raises(UsageError, match="/talker is given twice"):
        issue_to(keystore, "/talker", "talker/")


@pytest.mark.parametrize(
    "name",
    ["", "/", "//", "..", "/../x", "/a/../b", "/a/./b", "/.hidden", "/-x", "/a b", "/é", "/a\0b",
     "/key.pem", "/fleet/governance.p7s", "/permissions.xml", "/key.p11", "/a\nb", "/a\\b",
     "/" + "x" * 64],
)  # fmt: skip
def test_a_name_that_cannot_be_a_folder_and_a_common_name_is_refused(keystore, root, name):
    before = tree(root)
    with pytest.raises(UsageError):
        issue_to(keystore, name)
    assert tree(root) == before


def test_one_bad_wish_among_good_ones_makes_none(keystore, root):
    before = tree(root)
    specs = [spec("/a"), spec("/b", validity=timedelta(days=10**6)), spec("/c")]
    with pytest.raises(UsageError, match="reaches beyond 2261"):
        issue(keystore, keystore.unlock(None), specs, now=NOW)
    assert tree(root) == before
    assert list(root.glob(".draft-*")) == []
    assert [entry.kind for entry in keystore.ledger()].count("participant") == 0


@pytest.mark.parametrize("planted", ["enclaves/talker", "enclaves/fleet"])
@pytest.mark.parametrize("kind", ["link to a folder", "link to nowhere", "file"])
def test_nothing_is_written_through_a_link_or_over_a_file(keystore, root, tmp_path, planted, kind):
    victim = tmp_path / "victim"
    if kind == "file":
        (root / planted).write_bytes(b"mine")
    else:
        (root / planted).symlink_to(victim)
    if kind == "link to a folder":
        victim.mkdir()
    for force in (False, True):
        with pytest.raises(KeystoreError, match="should be a folder, and is not"):
            issue_to(keystore, "/talker", "/fleet/robot1", force=force)
    assert not victim.exists() or list(victim.iterdir()) == []
    assert list(root.glob(".draft-*")) == []


def test_a_link_to_a_keystore_may_be_used(keystore, root):
    link = root.with_name("link")
    link.symlink_to(root)
    issue_to(Keystore.open(link), "/talker")
    check_whole(keystore, "/talker")


def test_a_committed_change_is_not_finished_through_a_link(tmp_path, root):
    keystore = create(root)
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "file").write_bytes(b"precious")
    issue_to(keystore, "/old")
    (root / ".journal/0").mkdir(parents=True)  # as a command leaves it that was killed
    (root / ".journal/0/cert.pem").write_bytes(b"x")
    (root / ".journal/moves.json").write_text('{"targets": ["enclaves/new"], "entries": []}')
    (root / "enclaves/new").symlink_to(victim)
    with pytest.raises(KeystoreError, match="should be a folder, and is not"):
        Keystore.open(root, to_change=True)
    assert [path.name for path in victim.iterdir()] == ["file"]
    (root / "enclaves/new").unlink()
    assert Keystore.open(root, to_change=True).names() == ["/new", "/old"]


@pytest.mark.parametrize(
    "moves",
    ["", "{", "[]", "5", "{}", '{"targets": []}', '{"targets": 5, "entries": []}', "[" * 100_000,
     '{"targets": [], "entries": [5]}', '{"targets": [], "entries": [{"at": "x"}]}', "\0"],
)  # fmt: skip
def test_a_journal_that_cannot_be_read_is_refused(keystore, root, moves):
    (root / ".journal").mkdir()
    (root / ".journal/moves.json").write_text(moves)
    with pytest.raises(KeystoreError, match="this unfinished change cannot be read"):
        Keystore.open(root, to_change=True)
    with pytest.raises(KeystoreError):
        issue_to(keystore, "/talker")


@pytest.mark.parametrize("target", ["../outside", "enclaves/../../outside", "/outside", "a\0b"])
def test_a_journal_that_leads_out_of_the_keystore_is_refused(root, keystore, target):
    (root / ".journal/0").mkdir(parents=True)
    moves = {"targets": [target], "entries": []}
    (root / ".journal/moves.json").write_text(json.dumps(moves))
    with pytest.raises(KeystoreError, match="this unfinished change cannot be read"):
        Keystore.open(root, to_change=True)
    assert (root / ".journal/0").is_dir()


def test_a_folder_that_is_no_keystore_is_refused_with_the_way_out(tmp_path):
    for root, words in ((tmp_path, "is not a pqsec keystore"), (tmp_path / "no", "does not exist")):
        with pytest.raises(KeystoreError, match=words) as caught:
            Keystore.open(root)
        assert "ca init" in caught.value.hint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", [Keystore.open, create])
@pytest.mark.parametrize("place", ["x" * 300, "file/below"])
def test_a_place_where_no_folder_can_be_is_refused(tmp_path, make, place):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(PqsecError):
        make(tmp_path / place)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "settings",
    ["", "null", "5", "[]", "{", "[" * 100_000, '{"format": 3}', '{"format": 4}', "\0",
     '{"format": 3, "algorithms": 5, "domains": "0"}',
     '{"format": 3, "algorithms": [], "domains": "0"}'],
)  # fmt: skip
def test_settings_that_are_none_are_refused(keystore, root, settings):
    (root / "pqsec.json").write_text(settings)
    with pytest.raises(KeystoreError, match=r"pqsec\.json"):
        Keystore.open(root)
    assert keystore.profile is CLASSICAL


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"domains": value}, id=f"domains {value}")
        for value in (None, 5, [], {}, "", "x", "1-", "9-1", "\ud800")
    ]
    + [
        pytest.param({"algorithms": value}, id=f"algorithms {value}")
        for value in (
            *("classical", {"profile": "classical"}, [{"profile": []}], []),
            [profile_named("classical").to_names()] * 2,
        )
    ]
    + [pytest.param({"format": value}, id=f"format {value}") for value in (None, "1", 0, 1e400)],
)
def test_altered_settings_are_refused(keystore, root, change):
    settings = json.loads((root / "pqsec.json").read_bytes())
    (root / "pqsec.json").write_text(json.dumps(settings | change))
    with pytest.raises(KeystoreError, match=r"pqsec\.json"):
        Keystore.open(root)


@pytest.mark.parametrize(
    ("made_by", "words"),
    [("0.9.0", "made by pqsec 0.9.0, in format 5"), (None, "made by another version of pqsec"),
     ("\x1b[2J", r"made by pqsec \\u001b\[2J")],
)  # fmt: skip
def test_a_keystore_in_a_format_to_come_is_refused_with_the_way_out(keystore, root, made_by, words):
    settings = json.loads((root / "pqsec.json").read_bytes())
    assert settings["pqsec"] == __version__
    changed = settings | {"format": 5, "pqsec": made_by}
    (root / "pqsec.json").write_text(json.dumps(changed))
    with pytest.raises(KeystoreError, match=words) as refused:
        Keystore.open(root)
    assert f"this is pqsec {__version__}, which reads formats 3 and 4" in str(refused.value)
    assert "backed up before the upgrade" in refused.value.hint


def test_settings_without_the_version_that_made_them_are_read(keystore, root):
    settings = json.loads((root / "pqsec.json").read_bytes())
    del settings["pqsec"]
    (root / "pqsec.json").write_text(json.dumps(settings))
    assert Keystore.open(root).names() == keystore.names()


def test_settings_that_break_the_profiles_promise_are_refused(root):
    create(root, TRANSITION)
    text = (root / "pqsec.json").read_text()
    (root / "pqsec.json").write_text(text.replace("ml-dsa-65", "ecdsa-p256"))
    with pytest.raises(KeystoreError, match="promises"):
        Keystore.open(root)


@pytest.mark.parametrize("missing", sorted(SIX_FILES))
def test_a_participant_that_lacks_a_file_is_refused_by_its_name(keystore, root, missing):
    issue_to(keystore, "/talker")
    (root / "enclaves/talker" / missing).unlink()
    with pytest.raises(KeystoreError, match=f"lacks {missing}"):
        keystore.participant("/talker")


@pytest.mark.parametrize("name", ["/nobody", "/talker/below", "x" * 60])
def test_a_participant_that_is_not_there_is_refused(keystore, name):
    issue_to(keystore, "/talker")
    with pytest.raises(KeystoreError, match="there is no participant") as caught:
        keystore.participant(name)
    assert "pqsec issue" in caught.value.hint


@pytest.mark.parametrize("name", ["x" * 300, "/".join(["x" * 200] * 30)])
def test_a_participant_of_a_name_too_long_for_the_disk_is_refused(keystore, name):
    with pytest.raises((FileError, KeystoreError)):
        keystore.participant(name)


@pytest.mark.parametrize("file", ["cert.pem", "key.pem"])
def test_a_participants_file_that_cannot_be_read_is_named(keystore, root, file):
    issue_to(keystore, "/talker")
    (root / "enclaves/talker" / file).write_bytes(b"broken")
    with pytest.raises(MalformedError, match=file):
        keystore.participant("/talker")


def test_a_certificate_file_that_is_missing_is_named(root):
    with pytest.raises(FileError, match=r"cert\.pem: no such file"):
        load_certificate(root / "cert.pem")


@pytest.mark.parametrize("file", ["identity_ca.cert.pem", "permissions_ca.cert.pem"])
def test_a_keystore_without_a_ca_certificate_is_refused(keystore, root, file):
    (root / "public" / file).unlink()
    with pytest.raises(FileError, match=file):
        keystore.unlock(None)


def test_a_ledger_that_is_none_is_refused(keystore, root):
    for file in (root / "private").glob("ledger.*"):
        file.unlink()
    (root / "private/ledger.sqlite3").write_bytes(b"not a database, but long enough" * 100)
    with pytest.raises(KeystoreError, match="not a ledger"):
        keystore.ledger()


@pytest.mark.parametrize("how", ["gone", "empty", "without a table"])
@pytest.mark.parametrize("command", ["issue", "read"])
def test_a_lost_ledger_is_not_begun_anew(keystore, root, how, command):
    """One that is would not know who was revoked."""
    issue_to(keystore, "/talker")
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    ledger = root / "private/ledger.sqlite3"
    ledger.unlink()
    if how == "empty":
        ledger.touch()
    elif how == "without a table":
        with closing(sqlite3.connect(ledger)) as database:
            database.execute("PRAGMA journal_mode = WAL")
    work = {"issue": lambda: issue_to(keystore, "/talker", force=True), "read": keystore.ledger}
    with pytest.raises(KeystoreError, match="is missing or empty") as refused:
        work[command]()
    assert "backup" in refused.value.hint
    assert ledger.exists() == (how != "gone")


def test_a_keystore_whose_ledger_is_lost_for_good_can_be_adopted(keystore, root):
    """As docs/reference/keystore.md says; who was revoked is then known from the list."""
    issue_to(keystore, "/talker", "/listener")
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    (root / "private/ledger.sqlite3").unlink()
    (root / "pqsec.json").unlink()
    adopt(root, now=NOW)
    again = Keystore.open(root)
    audit(again)
    with pytest.raises(KeystoreError, match="revoked: /talker"):
        issue_to(again, "/talker", force=True)
    issue_to(again, "/listener", force=True)


def test_a_folder_in_place_of_a_file_is_refused_before_anything_is_done(keystore, root):
    """Else the change would be committed, and never be finished."""
    issue_to(keystore, "/talker")
    place = root / "enclaves/talker/permissions.p7s"
    place.unlink()
    place.mkdir()
    with pytest.raises(KeystoreError, match=r"permissions\.p7s should be a file, and is a folder"):
        issue_to(keystore, "/talker", force=True)
    assert list(root.glob(".*")) == []
    place.rmdir()
    issue_to(keystore, "/talker", force=True)


def test_a_ledger_of_other_columns_is_refused(keystore, root):
    (root / "private/ledger.sqlite3").unlink()
    database = sqlite3.connect(root / "private/ledger.sqlite3")
    database.execute("CREATE TABLE issued (name TEXT)")
    database.commit()
    database.close()
    with pytest.raises(KeystoreError, match=r"ledger\.sqlite3"):
        keystore.ledger()


def test_a_keystore_that_another_command_holds_is_waited_for_and_given_up(
    keystore, root, monkeypatch
):
    monkeypatch.setattr(_lock, "PATIENCE", 0.2)
    handle = os.open(root, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        with pytest.raises(KeystoreError, match="another pqsec command is using this keystore"):
            issue_to(keystore, "/talker")
    finally:
        os.close(handle)
    issue_to(keystore, "/talker")


def test_a_full_disk_leaves_nothing_half_made(keystore, root):
    before = tree(root)
    authorities = keystore.unlock(None)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FileError, match=r"file too large|disk i/o error"):
            issue(keystore, authorities, [spec("/talker")], now=NOW)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert tree(root) == before
    assert list(root.glob(".draft-*")) == []
    issue_to(keystore, "/talker")
    check_whole(keystore, "/talker")


NOBODY = 65534


def as_nobody(folder, action):
    """What `action` raised, run in `folder` by a user who owns nothing there."""
    reader, writer = os.pipe()
    child = fork()
    if child == 0:
        os.chdir(folder)
        if os.getuid() == 0:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
        try:
            action()
        except BaseException as error:  # noqa: BLE001 -- told to the parent
            os.write(writer, f"{type(error).__name__}: {error}".encode())
        os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    with os.fdopen(reader) as told:
        return told.read()


def test_a_folder_where_nothing_may_be_written_is_refused(keystore, root):
    authorities = keystore.unlock(None)
    here = Keystore(Path(), keystore.profiles, keystore.domains)
    if os.getuid() == 0:
        os.chown(root, NOBODY, NOBODY)
    root.chmod(0o555)
    told = as_nobody(root, lambda: issue(here, authorities, [spec("/talker")], now=NOW))
    assert told.startswith("FileError")
    assert told.endswith("permission denied")
    told = as_nobody(root, lambda: create(Path("new")))
    assert told == "FileError: new: permission denied"
    root.chmod(0o755)
    assert keystore.names() == []


def test_a_folder_where_nothing_may_be_read_is_refused(keystore, root):
    issue_to(keystore, "/talker")
    here = Keystore(Path("keystore"), keystore.profiles, keystore.domains)
    told = as_nobody(root.parent, lambda: here.participant("/talker"))
    assert told == "FileError: keystore/enclaves/talker/cert.pem: permission denied"
    told = as_nobody(root.parent, lambda: here.unlock(None))
    assert told.endswith("permission denied")
    root.chmod(0o000)
    told = as_nobody(root.parent, lambda: Keystore.open(Path("keystore")))
    root.chmod(0o755)
    assert told == "FileError: keystore: permission denied"
