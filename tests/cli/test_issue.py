"""pqsec issue: participants whole or not at all, private to their owner, and in the ledger."""

import os
import re
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from hashlib import sha256

import pytest

from pqsec_pki._times import rfc3339
from pqsec_pki.certificates import Certificate
from pqsec_pki.keystore import Keystore
from tests.cli.conftest import NAMES, snapshot

FILES = {
    "cert.pem",
    "key.pem",
    "permissions.xml",
    "permissions.p7s",
    "governance.p7s",
    "identity_ca.cert.pem",
    "permissions_ca.cert.pem",
}
SECOND = {"alt.key.pem", "permissions_ca.alt.cert.pem"}
TOPIC = "--publish rt/chatter"


def certificate(folder):
    return Certificate.from_pem((folder / "cert.pem").read_bytes())


def allowed(folder, action):
    """The topics that permissions.xml lets the participant publish or subscribe to."""
    xml = (folder / "permissions.xml").read_text()
    rules = re.findall(r"<allow_rule>.*?</allow_rule>", xml, re.DOTALL)
    sections = re.findall(rf"<{action}>(.*?)</{action}>", "".join(rules), re.DOTALL)
    return re.findall(r"<topic>(.*?)</topic>", "".join(sections))


def ledger(keystore):
    with closing(sqlite3.connect(keystore / "private/ledger.sqlite3")) as database:
        return database.execute(
            "SELECT kind, name, serial, sha256, not_after FROM ledger ORDER BY number"
        ).fetchall()


@pytest.mark.parametrize("profile", NAMES)
def test_an_enclave_holds_the_files_that_ros_reads_and_opens_them_through_links(domains, profile):
    k = domains(profile)
    expected = FILES | (SECOND if profile == "transition" else set())
    for name in ("talker", "listener"):
        folder = k / "enclaves" / name
        assert {path.name for path in folder.iterdir()} == expected
        for shared in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
            assert (folder / shared).read_bytes() == (k / "public" / shared).read_bytes()
            assert not (folder / shared).readlink().is_absolute()
        assert (folder / "governance.p7s").samefile(k / "enclaves/governance.p7s")


def test_two_participants_share_no_key(domains):
    folders = [domains("transition") / "enclaves" / name for name in ("talker", "listener")]
    for file in ("key.pem", "alt.key.pem", "cert.pem", "permissions.p7s"):
        assert len({(folder / file).read_bytes() for folder in folders}) == 2


# Names


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("/talker2", "/talker2"),
        ("talker2", "/talker2"),
        ("/fleet/robot1", "/fleet/robot1"),
        ("fleet//robot1/", "/fleet/robot1"),
        ("/a.b-c_d/E9", "/a.b-c_d/E9"),
        ("/" + "x" * 63, "/" + "x" * 63),
        ("/talker/below", "/talker/below"),
        ("/governance", "/governance"),
    ],
)
def test_a_name_is_made_an_absolute_enclave_path_and_the_subject(pqsec, keystore, given, name):
    k = keystore()
    issued = pqsec(f"-k k issue --json {TOPIC}", given).done().json["issued"]
    assert [each["name"] for each in issued] == [name]
    folder = k / f"enclaves{name}"
    assert certificate(folder).subject_name == f"CN={name}"
    assert name in pqsec("-k k ca show --json").json["participants"]
    pqsec("-k k verify-handshake /talker", name).done()


def test_a_nested_enclave_links_to_what_it_shares(pqsec, keystore):
    k = keystore("transition")
    pqsec(f"-k k issue /a/b/c/d {TOPIC}").done()
    pqsec("-k k verify-handshake /a/b/c/d /talker").done()
    assert {path.name for path in (k / "enclaves/a/b/c/d").iterdir()} == FILES | SECOND


@pytest.mark.parametrize(
    "name",
    [
        "",
        "/",
        "//",
        "..",
        "/../escape",
        "/a/../b",
        "/a/./b",
        "/.hidden",
        "/-dash",
        "/a b",
        "/a\nb",
        "/a=b",
        "/a,b",
        "/é",
        "/а",  # noqa: RUF001 -- Cyrillic, which looks like a Latin a
        "/٣",
        "/a\\b",
        "/$(id)",
        "/cert.pem",
        "/a/key.pem/b",
        "/x.p7s",
        "/" + "x" * 64,
        "/" + "x" * 300,
    ],
)
def test_a_name_that_cannot_be_folder_and_subject_is_refused(pqsec, keystore, tmp_path, name):
    k = keystore()
    before = snapshot(tmp_path)
    pqsec(f"-k k issue {TOPIC} --", name).refused(2)
    assert snapshot(tmp_path) == before
    assert not list(k.rglob("*escape*"))


def test_several_names_are_issued_at_once(pqsec, keystore):
    k = keystore("pq")
    said = pqsec(f"-k k issue /b /a /fleet/1/arm {TOPIC}").done()
    assert [line.split()[0] for line in said.out.splitlines()] == ["/b", "/a", "/fleet/1/arm"]
    serials = {certificate(k / "enclaves" / name).serial_number for name in ("a", "b")}
    assert len(serials) == 2


@pytest.mark.parametrize("names", ["/a /b /a", "/a a", "/a /b /bad!", "/a /talker"])
def test_if_one_name_cannot_be_none_is_issued(pqsec, keystore, names):
    k = keystore()
    before = snapshot(k)
    assert pqsec(f"-k k issue {names} {TOPIC}").code in {2, 3}
    assert snapshot(k) == before
    assert not (k / "enclaves/a").exists()


# What it may do


def test_topics_stand_in_the_permissions_as_given(pqsec, keystore):
    k = keystore()
    topics = ["rt/chatter", "Square", "a*", "*", "a<b&c", 'q"uote']
    options = [option for topic in topics for option in ("--publish", topic)]
    pqsec("-k k issue /a --subscribe rt/other", *options).done()
    escaped = ["rt/chatter", "Square", "a*", "*", "a&lt;b&amp;c"]
    assert allowed(k / "enclaves/a", "publish")[:5] == escaped
    assert allowed(k / "enclaves/a", "subscribe") == ["rt/other"]
    pqsec("validate k/enclaves/a/permissions.p7s").done()


def test_a_topic_named_twice_stands_once(pqsec, keystore):
    k = keystore()
    pqsec("-k k issue /a --publish rt/x --publish rt/x --ros-publish /x").done()
    assert allowed(k / "enclaves/a", "publish") == ["rt/x"]


@pytest.mark.parametrize("topic", ["", "a\x01b", "\x7f\ufffe", "\udcff"])
def test_a_topic_xml_cannot_carry_is_refused(pqsec, keystore, topic):
    k = keystore()
    before = snapshot(k)
    pqsec("-k k issue /a --publish", topic).refused(2)
    assert snapshot(k) == before


@pytest.mark.parametrize(
    ("option", "publish", "subscribe"),
    [
        ("--ros-publish /chatter", {"rt/chatter"}, set()),
        ("--ros-subscribe /ns/chatter", set(), {"rt/ns/chatter"}),
        ("--ros-service /add", {"rr/addReply"}, {"rq/addRequest"}),
        ("--ros-client /add", {"rq/addRequest"}, {"rr/addReply"}),
        (
            "--ros-action-server /fib",
            {"rt/fib/_action/feedback", "rt/fib/_action/status", "rr/fib/_action/send_goalReply"},
            {"rq/fib/_action/send_goalRequest", "rq/fib/_action/cancel_goalRequest"},
        ),
        (
            "--ros-action-client /fib",
            {"rq/fib/_action/send_goalRequest", "rq/fib/_action/get_resultRequest"},
            {"rt/fib/_action/feedback", "rt/fib/_action/status", "rr/fib/_action/send_goalReply"},
        ),
        (
            "--ros-node /talker",
            {"ros_discovery_info", "rt/rosout", "rr/talker/get_parametersReply"},
            {"ros_discovery_info", "rq/talker/get_parametersRequest"},
        ),
    ],
)
def test_ros_names_are_mangled(pqsec, keystore, option, publish, subscribe):
    k = keystore()
    said = pqsec(f"-k k issue /a {option}").done()
    assert said.err == ""
    assert publish <= set(allowed(k / "enclaves/a", "publish"))
    assert subscribe <= set(allowed(k / "enclaves/a", "subscribe"))
    assert bool(subscribe) == bool(allowed(k / "enclaves/a", "subscribe"))


@pytest.mark.parametrize("name", ["chatter", "/a//b", "/a/", "/1a", "/a b", "/a-b", "/", ""])
@pytest.mark.parametrize("option", ["--ros-publish", "--ros-action-client", "--ros-node"])
def test_a_name_that_ros_would_not_take_is_refused(pqsec, keystore, option, name):
    k = keystore()
    pqsec(f"-k k issue /a {option}", name).refused(2, "is not a full ROS 2 name")
    assert not (k / "enclaves/a").exists()


def test_without_topics_all_is_denied_and_that_is_said(pqsec, keystore):
    k = keystore()
    said = pqsec("-k k issue /a").done()
    assert said.err == (
        "pqsec: note: no topic named: the permissions deny everything, also joining the domain\n"
    )
    assert allowed(k / "enclaves/a", "publish") == []
    assert "<default>DENY</default>" in (k / "enclaves/a/permissions.xml").read_text()
    report = pqsec("-k k verify-handshake /talker /a --json")
    assert report.code == 1
    assert "may not join domain 0" in report.json["steps"][-1]["detail"]


def test_domains_may_differ_from_the_cas_and_a_domain_nobody_governs_is_said(pqsec, keystore):
    k = keystore()
    said = pqsec(f"-k k issue /a --domain 0,7-8 {TOPIC}").done()
    assert "pqsec: note: the governance does not name domain 7, 8" in said.err
    xml = re.sub(r"\s+", "", (k / "enclaves/a/permissions.xml").read_text())
    assert "<id>0</id><id_range><min>7</min><max>8</max></id_range>" in xml
    pqsec("-k k verify-handshake /a /talker").done()
    assert pqsec("-k k verify-handshake /a /talker --domain 7").code == 1


@pytest.mark.parametrize("text", ["231", "x", "2-1", "0,,1", ""])
def test_domains_that_are_none_are_refused(pqsec, keystore, text):
    k = keystore()
    pqsec(f"-k k issue /a {TOPIC} --domain", text).refused(2)
    assert not (k / "enclaves/a").exists()


# How long


def test_a_participant_ends_with_its_ca_and_that_is_said(pqsec, make_domain, tmp_path):
    make_domain(tmp_path, "--no-passphrase --profile classical --validity 30d")
    said = pqsec(f"-k k issue /a {TOPIC} --validity 2y").done()
    ca = Keystore.open(tmp_path / "k").identity_ca
    assert f"pqsec: note: valid only until {ca.not_after:%Y-%m-%d}" in said.err
    leaf = certificate(tmp_path / "k/enclaves/a")
    assert leaf.not_after == ca.not_after
    assert leaf.not_before >= ca.not_before
    xml = (tmp_path / "k/enclaves/a/permissions.xml").read_text()
    assert f"<not_after>{ca.not_after:%Y-%m-%dT%H:%M:%SZ}</not_after>" in xml


def test_validity_is_one_year_or_what_is_asked(pqsec, keystore):
    k = keystore()
    assert pqsec(f"-k k issue /a {TOPIC}").done().err == ""
    pqsec(f"-k k issue /b {TOPIC} --validity 12h").done()
    for name, span in (("a", timedelta(days=365)), ("b", timedelta(hours=12))):
        left = certificate(k / f"enclaves/{name}").not_after - datetime.now(UTC)
        assert span - timedelta(minutes=5) < left <= span


@pytest.mark.parametrize("text", ["0d", "x", "-1y", "999999y"])
def test_a_validity_that_is_none_is_refused(pqsec, keystore, text):
    k = keystore()
    pqsec(f"-k k issue /a {TOPIC} --validity={text}").refused(2)
    assert not (k / "enclaves/a").exists()


def test_an_expired_identity_ca_issues_nothing(pqsec, expired_ca):
    said = pqsec(f"-k k issue /a {TOPIC}")
    said.refused(3, "the identity CA expired", hint="pqsec ca rotate")
    assert not (expired_ca / "enclaves/a").exists()


@pytest.fixture
def expired_ca(tmp_path, domains):
    profile = Keystore.open(domains("classical")).profile
    return Keystore.create(
        tmp_path / "k",
        profile,
        name="",
        domains=Keystore.open(domains("classical")).domains,
        validity=timedelta(days=30),
        passphrase=None,
        now=datetime.now(UTC) - timedelta(days=60),
    ).root


# Again


def test_what_was_issued_is_not_issued_again(pqsec, keystore):
    k = keystore()
    before = snapshot(k)
    said = pqsec(f"-k k issue /new talker /listener {TOPIC}")
    said.refused(3, "already issued: /listener, /talker", hint="--force")
    assert snapshot(k) == before


@pytest.mark.parametrize("lost", [("cert.pem",), ("cert.pem", "key.pem")])
def test_what_lost_its_certificate_is_not_issued_again_without_force(pqsec, keystore, lost):
    """Its key and its permissions would be lost too."""
    k = keystore()
    for file in lost:
        (k / "enclaves/listener" / file).unlink()
    before = snapshot(k)
    pqsec("-k k issue /listener").refused(3, "already issued: /listener", hint="--force")
    assert snapshot(k) == before
    pqsec(f"-k k issue /listener/arm {TOPIC}").done()
    (k / "enclaves/empty/arm").mkdir(parents=True)
    pqsec(f"-k k issue /empty {TOPIC}").done()
    pqsec(f"-k k issue /listener {TOPIC} --force").done()
    pqsec("-k k verify-handshake /talker /listener").done()


@pytest.mark.parametrize("profile", ["classical", "transition"])
def test_force_replaces_keys_certificate_and_permissions(pqsec, keystore, profile):
    k = keystore(profile)
    before = snapshot(k / "enclaves/talker")
    pqsec("-k k issue /talker --force --publish rt/new --subscribe rt/new").done()
    after = snapshot(k / "enclaves/talker")
    same = {name for name in after if after[name] == before[name]}
    assert same == {"governance.p7s", *(name for name in after if "_ca." in name)}
    assert allowed(k / "enclaves/talker", "publish") == ["rt/new"]
    pqsec("-k k verify-handshake /talker /listener").done()
    assert len([row for row in ledger(k) if row[:2] == ("participant", "/talker")]) == 2


# Who may read it


def test_keys_are_their_owners_only_whatever_the_umask(pqsec, keystore):
    k = keystore("transition")
    before = os.umask(0)
    try:
        pqsec(f"-k k issue /fleet/a {TOPIC}").done()
    finally:
        os.umask(before)
    folder = k / "enclaves/fleet/a"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert folder.parent.stat().st_mode & 0o777 == 0o755
    modes = {p.name: p.stat().st_mode & 0o777 for p in folder.iterdir() if not p.is_symlink()}
    assert {name for name, mode in modes.items() if mode == 0o600} == {"key.pem", "alt.key.pem"}
    assert set(modes.values()) == {0o600, 0o644}


def test_replacing_closes_a_folder_that_was_opened(pqsec, keystore):
    k = keystore()
    (k / "enclaves/talker").chmod(0o777)
    (k / "enclaves/talker/key.pem").chmod(0o666)
    pqsec(f"-k k issue /talker --force {TOPIC}").done()
    assert (k / "enclaves/talker").stat().st_mode & 0o777 == 0o700
    assert (k / "enclaves/talker/key.pem").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize(
    "line", ["issue /a --publish x", "issue /a --json", "issue /talker --force"]
)
def test_no_private_key_is_shown(pqsec, keystore, line):
    k = keystore()
    said = pqsec(f"-k k {line}").done()
    for path in k.rglob("*key.pem"):
        for text in path.read_text().splitlines()[1:-1]:
            assert text not in said.out + said.err


# What stops it


def test_a_wrong_passphrase_issues_nothing(pqsec, locked):
    before = snapshot(locked)
    said = pqsec(f"-k k issue /a {TOPIC} --passphrase-file wrong")
    said.refused(3, "private/identity_ca.key.pem", "wrong passphrase", hint="--passphrase-file")
    assert snapshot(locked) == before
    pqsec(f"-k k issue /a {TOPIC} --passphrase-file right").done()


def test_encrypted_keys_without_terminal_and_passphrase_are_a_usage_error(process, locked):
    before = snapshot(locked)
    said = process(f"-k k issue /a {TOPIC}")
    said.refused(2, "no terminal", hint="--passphrase-file FILE, or set PQSEC_PASSPHRASE_FILE")
    assert snapshot(locked) == before


def test_a_passphrase_nobody_needs_is_not_read(pqsec, keystore):
    keystore()
    pqsec(f"-k k issue /a {TOPIC} --passphrase-file nowhere").done()


def test_a_keystore_that_is_not_there_is_not_made(pqsec, tmp_path):
    pqsec(f"-k k issue /a {TOPIC}").refused(3, "k does not exist", hint="ca init")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "lost",
    [
        "private/identity_ca.key.pem",
        "private/permissions_ca.key.pem",
        "private/permissions_ca.alt.key.pem",
        "public/identity_ca.cert.pem",
        "public/permissions_ca.cert.pem",
        "public/permissions_ca.alt.cert.pem",
    ],
)
def test_a_lost_file_is_named_and_nothing_is_issued(pqsec, keystore, lost):
    k = keystore("transition")
    (k / lost).unlink()
    pqsec(f"-k k issue /a {TOPIC}").refused(3, lost)
    assert not (k / "enclaves/a").exists()


@pytest.mark.parametrize("file", ["identity_ca", "permissions_ca", "permissions_ca.alt"])
def test_a_ca_key_that_is_not_its_certificates_issues_nothing(pqsec, keystore, file):
    k, other = keystore("transition"), keystore("transition", "other", "another")
    name = f"private/{file}.key.pem"
    (k / name).write_bytes((other / name).read_bytes())
    pqsec(f"-k k issue /a {TOPIC}").refused(3, "a private key does not match the certificate")
    assert not (k / "enclaves/a").exists()


def test_nothing_is_issued_through_a_link_that_leads_out(pqsec, keystore, tmp_path):
    k = keystore()
    (tmp_path / "elsewhere").mkdir()
    (k / "enclaves/fleet").symlink_to(tmp_path / "elsewhere")
    pqsec(f"-k k issue /fleet/a {TOPIC}").refused(3, "fleet should be a folder")
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_ledger_that_is_none_is_said(pqsec, keystore):
    k = keystore()
    (k / "private/ledger.sqlite3").write_bytes(b"not a database" * 100)
    pqsec(f"-k k issue /a {TOPIC}").refused(3, "private/ledger.sqlite3")


# The ledger


def test_the_ledger_has_all_that_was_made(pqsec, keystore):
    k = keystore("transition")
    pqsec(f"-k k issue /a {TOPIC}").done()
    rows = ledger(k)
    assert [row[:2] for row in rows[:4]] == [
        ("identity-ca", "CN=Identity CA"),
        ("permissions-ca", "CN=Permissions CA"),
        ("permissions-ca", "CN=Permissions CA ml-dsa-65"),
        ("governance", ""),
    ]
    made = [
        (kind, name)
        for name in ("/talker", "/listener", "/a")
        for kind in ("participant", "permissions")
    ]
    assert sorted(row[:2] for row in rows[4:]) == sorted(made)


def test_the_ledger_tells_serial_end_and_digest_of_the_files(pqsec, keystore):
    k = keystore()
    issued = pqsec(f"-k k issue /a {TOPIC} --json").done().json["issued"][0]
    leaf = certificate(k / "enclaves/a")
    signed = (k / "enclaves/a/permissions.p7s").read_bytes()
    end = leaf.not_after.isoformat()
    assert ledger(k)[-2:] == [
        ("participant", "/a", f"{leaf.serial_number:x}", leaf.fingerprint, end),
        ("permissions", "/a", None, sha256(signed).hexdigest(), None),
    ]
    assert issued["serial"] == f"{leaf.serial_number:x}"
    assert issued["not_after"] == rfc3339(leaf.not_after)
    assert issued["permissions_bytes"] == len(signed)
    assert issued["certificate_bytes"] == (k / "enclaves/a/cert.pem").stat().st_size
    assert datetime.fromisoformat(issued["not_after"]) == leaf.not_after


def test_a_refused_command_leaves_the_ledger_as_it_was(pqsec, keystore):
    k = keystore()
    before = ledger(k)
    pqsec(f"-k k issue /talker {TOPIC}").refused(3)
    pqsec("-k k issue /a --publish", "").refused(2)
    assert ledger(k) == before


def test_a_lost_governance_stops_the_issue_before_anything_is_replaced(pqsec, keystore):
    k = keystore()
    (k / "enclaves/governance.p7s").unlink()
    before = snapshot(k)
    said = pqsec(f"-k k issue /talker --force {TOPIC}")
    said.refused(3, "k/enclaves/governance.p7s: no such file or directory")
    assert snapshot(k) == before


def test_topics_that_look_like_mistakes_are_noted_in_one_line(pqsec, keystore):
    keystore()
    pqsec("-k k issue /a --subscribe rt/image --subscribe rt/scan").done()
    done = pqsec("-k k issue /b --publish rt/imag --publish rt//scan").done()
    [line] = [each for each in done.err.splitlines() if "rt/" in each]
    assert "rt//scan has //" in line
    assert line.endswith("; and 1 more, see `pqsec check`")
    done = pqsec("-k k permit /b --remove --publish rt//scan --yes").done()
    [line] = [each for each in done.err.splitlines() if "rt/" in each]
    assert "/b may publish rt/imag, and nobody may subscribe to it: did you mean rt/image?" in line
    pqsec("-k k permit /b --publish rt/image --yes").done()
    done = pqsec("-k k permit /b --remove --publish rt/imag --yes").done()
    assert "did you mean" not in done.err
