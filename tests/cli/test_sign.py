"""pqsec sign-governance and sign-permissions: what is signed keeps to its schema."""

import os
import sqlite3
from contextlib import closing
from hashlib import sha256
from pathlib import Path

import pytest

from pqsec_pki._files import MAX_FILE
from tests.cli.conftest import NAMES, PARTICIPANTS, snapshot

KINDS = ["governance", "permissions"]
WHERE = {"governance": "enclaves/governance.xml", "permissions": "enclaves/talker/permissions.xml"}
SIGNING = {
    "transition": [("ecdsa-p256", False), ("ml-dsa-65", True)],
    "hybrid": [("mldsa65-ecdsa-p256-sha512", False)],
    "pq": [("ml-dsa-65", False)],
    "cnsa2": [("ml-dsa-87", False)],
    "classical": [("ecdsa-p256", False)],
}
# What is done to the XML -> the element and the rule that a person is told.
BREAKS = {
    "governance": [
        (">ENCRYPT<", ">encrypt<", "<discovery_protection_kind>: 'encrypt' is not one of"),
        (">false<", ">FALSE<", "<allow_unauthenticated_participants>: 'FALSE' is not true or"),
        ("<id>0</id>", "<id>-1</id>", "<id>: "),
        ("<id>0</id>", "", "<domains>: is not complete; expected next: "),
        ("topic_access_rules", "topic_rules", "<topic_rules>: is not expected here; expected: "),
        ("<topic_rule>", "<topic_rule strict='yes'>", "<topic_rule>: has no attribute 'strict'"),
        ("<domain_rule>", "<domain_rule>text", "<domain_rule>: holds elements only, no text"),
    ],
    "permissions": [
        (">DENY<", ">Deny<", "<default>: 'Deny' is not one of"),
        ("<not_before>20", "<not_before>2O", "<not_before>: "),
        ("not_after", "not_later", "<not_later>: is not expected here; expected: not_after"),
        (' name="/talker"', "", "<grant>: lacks its attribute 'name'"),
        ("<publish>", "<publish/><publish>", "<publish>: is not complete"),
        ("<subject_name>CN=/talker</subject_name>", "", "<validity>: is not expected here"),
    ],
}


def ledger(keystore):
    with closing(sqlite3.connect(keystore / "private/ledger.sqlite3")) as database:
        return database.execute("SELECT kind, name, sha256 FROM ledger ORDER BY number").fetchall()


def line_of(text, change):
    """The line of `text` on which `change` first stands."""
    return text[: text.index(change)].count("\n") + 1


@pytest.mark.parametrize("profile", NAMES)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_signed_verifies_with_the_profiles_signatures(pqsec, keystore, kind, profile):
    k = keystore(profile)
    said = pqsec(f"-k k sign-{kind} k/{WHERE[kind]} -o new.p7s --json").done().json
    assert said["signed"] == "new.p7s"
    assert said["bytes"] == (k.parent / "new.p7s").stat().st_size
    found = pqsec("-k k verify new.p7s --json").done().json["signatures"]
    assert [(each["algorithm"], each["countersignature"]) for each in found] == SIGNING[profile]
    assert pqsec("validate new.p7s --json").done().json["files"][0]["kind"] == kind


def test_the_keystores_governance_is_edited_signed_and_counts(pqsec, keystore):
    k = keystore()
    governance = k / "enclaves/governance.xml"
    text = governance.read_text().replace("<id>0</id>", "<id>0</id><id>5</id>")
    governance.write_text(text)
    assert pqsec("-k k sign-governance k/enclaves/governance.xml").code == 3
    pqsec("-k k sign-governance k/enclaves/governance.xml --force").done()
    said = pqsec("-k k issue /a /b --domain 5 --publish x").done()
    assert said.err == ""
    pqsec("-k k verify-handshake /a /b --domain 5").done()


# What breaks the schema


@pytest.mark.parametrize(
    ("kind", "flaw"),
    [(kind, flaw) for kind in KINDS for flaw in BREAKS[kind]],
    ids=[f"{kind} {new or f'no {old}'}" for kind in KINDS for old, new, _ in BREAKS[kind]],
)
def test_a_broken_document_is_refused_with_file_line_element_and_rule(
    pqsec, keystore, tmp_path, kind, flaw
):
    old, new, words = flaw
    text = (keystore() / WHERE[kind]).read_text()
    assert old in text
    (tmp_path / "broken.xml").write_text(text.replace(old, new))
    before = snapshot(tmp_path)
    said = pqsec(f"-k k sign-{kind} broken.xml")
    said.refused(1, words, problems=text.count(old) if old == ">ENCRYPT<" else 1)
    assert all(error.startswith("broken.xml: line ") for error in said.errors)
    number = int(said.err.split("line ")[1].split(":")[0])
    assert abs(number - line_of(text, old)) <= 1  # what is missing is told where it should be
    assert snapshot(tmp_path) == before


def test_everything_that_is_wrong_is_said_at_once(pqsec, keystore, tmp_path):
    text = (keystore() / WHERE["governance"]).read_text()
    (tmp_path / "broken.xml").write_text(text.replace("ENCRYPT", "encrypt"))
    said = pqsec("-k k sign-governance broken.xml")
    said.refused(1, problems=text.count("ENCRYPT"))
    broken = [n for n, line in enumerate(text.splitlines(), start=1) if "ENCRYPT" in line]
    assert len(broken) == text.count("ENCRYPT")
    for number, error in zip(broken, said.errors, strict=True):
        assert error.startswith(f"broken.xml: line {number}: <")
        assert ">: 'encrypt' is not one of 'NONE', " in error


@pytest.mark.parametrize(("kind", "other"), [KINDS, KINDS[::-1]])
def test_a_document_of_the_other_kind_is_refused(pqsec, keystore, tmp_path, kind, other):
    keystore()
    said = pqsec(f"-k k sign-{kind} k/{WHERE[other]} -o out.p7s")
    said.refused(1, WHERE[other], f"is a {other} document, not a {kind} one")
    assert not (tmp_path / "out.p7s").exists()


# What is no document


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0\xff\xfe" * 99,
        b"<dds>",
        b"x" * (9 << 20),
        b'<!DOCTYPE dds [<!ENTITY a "b">]><dds>&a;</dds>',
        b'<!DOCTYPE dds SYSTEM "/etc/hostname"><dds/>',
        b"<a>" * 5000 + b"</a>" * 5000,
    ],
    ids=["empty", "binary", "cut", "huge", "entity", "external", "deep"],
)
def test_what_is_no_xml_is_refused_by_name_and_not_signed(pqsec, keystore, tmp_path, kind, content):
    keystore()
    (tmp_path / "in.xml").write_bytes(content)
    unreadable = len(content) > MAX_FILE
    pqsec(f"-k k sign-{kind} in.xml").refused(3 if unreadable else 1, "in.xml: ")
    assert not (tmp_path / "in.p7s").exists()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("content", ["<dds/>", "<html><body/></html>", "<dds xmlns='urn:x'/>"])
def test_xml_that_is_no_document_is_refused_by_name_and_not_signed(
    pqsec, keystore, tmp_path, kind, content
):
    keystore()
    (tmp_path / "in.xml").write_text(content)
    pqsec(f"-k k sign-{kind} in.xml").refused(1, "in.xml: line 1: <")
    assert not (tmp_path / "in.p7s").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_is_missing_or_a_folder_is_refused(pqsec, keystore, tmp_path, kind):
    keystore()
    said = pqsec(f"-k k sign-{kind} nowhere.xml").refused(3, "no such file")
    assert said.err.count("nowhere.xml") == 1
    pqsec(f"-k k sign-{kind} k").refused(2, "is a directory")
    assert {path.name for path in tmp_path.iterdir()} == {"k"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_signed_file_is_not_signed_again(pqsec, keystore, tmp_path, kind):
    keystore()
    signed = WHERE[kind].replace(".xml", ".p7s")
    pqsec(f"-k k sign-{kind} k/{signed} -o again.p7s").refused(1, signed)
    assert not (tmp_path / "again.p7s").exists()


# Where it is written


def test_without_output_it_stands_beside_the_file(pqsec, keystore, tmp_path):
    (tmp_path / "mine.xml").write_bytes((keystore() / WHERE["governance"]).read_bytes())
    said = pqsec("-k k sign-governance mine.xml").done()
    assert said.out == f"mine.p7s  ({(tmp_path / 'mine.p7s').stat().st_size} bytes)\n"
    assert (tmp_path / "mine.p7s").stat().st_mode & 0o777 == 0o644
    assert {path.name for path in tmp_path.iterdir()} == {"k", "mine.xml", "mine.p7s"}


def test_what_stands_there_stays_without_force(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "out").write_text("mine")
    line = f"-k k sign-governance k/{WHERE['governance']} -o out"
    pqsec(line).refused(3, "out exists", hint="--force")
    assert (tmp_path / "out").read_text() == "mine"
    pqsec(f"{line} --force").done()
    pqsec("-k k verify out").done()


@pytest.mark.usefixtures("locked")
@pytest.mark.parametrize("kind", KINDS)
def test_what_stands_there_is_seen_before_a_passphrase_is_needed(process, keystore, tmp_path, kind):
    document = (keystore(name="source") / WHERE[kind]).read_bytes()
    (tmp_path / "mine.xml").write_bytes(document)
    for output, goal in (("", "mine.p7s"), ("-o out", "out")):
        (tmp_path / goal).write_text("mine")
        said = process(f"-k k sign-{kind} mine.xml {output}")
        said.refused(3, f"{goal} exists", hint="choose another place, or --force to replace it")
        process(f"-k k sign-{kind} mine.xml {output} --force").refused(2, "no terminal")
        assert (tmp_path / goal).read_text() == "mine"


@pytest.mark.parametrize("dangling", [False, True], ids=["link", "dangling link"])
def test_a_link_at_the_output_is_replaced_not_followed(pqsec, keystore, tmp_path, dangling):
    keystore()
    if not dangling:
        (tmp_path / "target").write_text("mine")
    (tmp_path / "out").symlink_to("target")
    line = f"-k k sign-governance k/{WHERE['governance']} -o out"
    pqsec(line).refused(3, "out exists")
    assert (tmp_path / "out").is_symlink()
    pqsec(f"{line} --force").done()
    assert not (tmp_path / "out").is_symlink()
    assert (tmp_path / "target").exists() is not dangling
    assert dangling or (tmp_path / "target").read_text() == "mine"


@pytest.mark.parametrize(
    ("output", "code"), [("no/such/folder", 3), ("k", 2), ("k/pqsec.json/x", 3), ("x" * 300, 3)]
)
def test_an_output_that_cannot_be_is_refused(pqsec, keystore, tmp_path, output, code):
    keystore()
    before = snapshot(tmp_path)
    pqsec(f"-k k sign-governance k/{WHERE['governance']} --force -o", output).refused(code)
    assert snapshot(tmp_path) == before


def test_the_mode_of_the_output_does_not_depend_on_the_umask(pqsec, keystore, tmp_path):
    keystore()
    before = os.umask(0)
    try:
        pqsec(f"-k k sign-governance k/{WHERE['governance']} -o out").done()
    finally:
        os.umask(before)
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o644


# Who signs


def test_a_wrong_passphrase_signs_nothing(pqsec, locked, tmp_path):
    line = f"-k k sign-governance k/{WHERE['governance']} -o out --passphrase-file"
    pqsec(line, "wrong").refused(3, "wrong passphrase", hint="--passphrase-file")
    assert not (tmp_path / "out").exists()
    pqsec(line, "right").done()


def test_a_broken_document_is_told_before_a_passphrase_is_needed(process, locked, tmp_path):
    (tmp_path / "broken.xml").write_text("<dds/>")
    process("-k k sign-governance broken.xml").refused(1, "broken.xml: line 1: <dds>: ")


def test_without_keystore_nothing_is_signed(pqsec, keystore, tmp_path):
    keystore()
    pqsec(f"sign-governance k/{WHERE['governance']} -o out").refused(2, "no keystore named")
    pqsec(f"-k no sign-governance k/{WHERE['governance']} -o out").refused(3, "no does not exist")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("profile", ["pq", "cnsa2", "hybrid"])
def test_the_certificate_is_embedded_only_on_demand_where_no_stock_stack_reads(
    pqsec, keystore, profile
):
    k = keystore(profile)
    line = f"-k k sign-governance k/{WHERE['governance']} --json -o"
    small = pqsec(f"{line} small").json["bytes"]
    large = pqsec(f"{line} large --embed-certificate").json["bytes"]
    # both base64, but not with the same breaks
    assert large - small > 0.99 * (k / "public/permissions_ca.cert.pem").stat().st_size - 99
    pqsec("-k k verify large").done()


def test_what_was_signed_is_in_the_ledger(pqsec, keystore, tmp_path):
    k = keystore()
    pqsec(f"-k k sign-permissions k/{WHERE['permissions']} -o out").done()
    rows = ledger(k)
    assert rows[-1] == ("permissions", "out", sha256((tmp_path / "out").read_bytes()).hexdigest())
    assert {name for kind, name, _ in rows if kind == "participant"} == set(PARTICIPANTS)


def test_the_ledger_tells_of_a_file_only_once_it_is_there(pqsec, keystore, tmp_path):
    k = keystore()
    before = ledger(k)
    line = f"-k k sign-permissions k/{WHERE['permissions']} -o"
    pqsec(line, "no/such/folder").refused(3)
    assert ledger(k) == before
    for file in (k / "private").glob("ledger.sqlite3*"):
        file.rename(tmp_path / file.name)
    for lost in (b"", b"not a database" * 100):
        (k / "private/ledger.sqlite3").write_bytes(lost)
        pqsec(line, "out").refused(3, "private/ledger.sqlite3")
        assert not (tmp_path / "out").exists()
    for file in tmp_path.glob("ledger.sqlite3*"):
        file.rename(k / "private" / file.name)
    pqsec(line, "out").done()
    signed = sha256((tmp_path / "out").read_bytes()).hexdigest()
    assert ledger(k) == [*before, ("permissions", "out", signed)]


def test_a_device_is_not_replaced_even_when_forced(pqsec, keystore, tmp_path):
    keystore()
    os.mkfifo(tmp_path / "pipe")
    pqsec(f"-k k sign-permissions k/{WHERE['permissions']} -o pipe --force").refused(
        3, "pipe: not a file"
    )
    assert (tmp_path / "pipe").is_fifo()


# What lies beside what is signed


def edited(keystore_path, name):
    """That document of the keystore, with another topic; in a file of its own."""
    text = (keystore_path / WHERE[name]).with_suffix(".xml").read_text()
    assert "</topic>" in text or name == "governance"
    path = keystore_path.parent / "edited.xml"
    path.write_text(text.replace("rt/chatter", "rt/parole").replace("ENCRYPT", "SIGN"))
    return path


@pytest.mark.parametrize("name", ["permissions", "governance"])
@pytest.mark.parametrize("link", [False, True], ids=["", "by-a-link"])
def test_what_is_signed_over_a_document_of_the_keystore_changes_its_xml_too(
    pqsec, keystore, tmp_path, name, link
):
    k = keystore()
    new = edited(k, name).read_bytes()
    goal = k / Path(WHERE[name]).with_suffix(".p7s")
    said = goal.relative_to(tmp_path)
    if link:
        (tmp_path / "way").symlink_to(goal.parent)
        said = Path("way") / goal.name
    pqsec(f"-k k sign-{name} edited.xml -o {said}").refused(3, "exists")
    assert goal.with_suffix(".xml").read_bytes() != new
    told = pqsec(f"-k k sign-{name} edited.xml -o {said} --force").done()
    assert told.err == ""
    assert goal.with_suffix(".xml").read_bytes() == new
    assert ledger(k)[-1] == (name, str(said), sha256(goal.read_bytes()).hexdigest())
    # So signing the XML, as hints say, loses nothing.
    pqsec(f"-k k sign-{name} {goal.with_suffix('.xml')} --force").done()
    pqsec("-k k renew /talker").done()
    signed = pqsec(f"{name} read {goal}").done().out
    assert ("rt/parole" if name == "permissions" else "SIGN") in signed


def test_an_older_xml_beside_a_copy_elsewhere_is_told(pqsec, keystore, tmp_path):
    k = keystore()
    new = edited(k, "permissions")
    (tmp_path / "out.xml").write_bytes((k / WHERE["permissions"]).with_suffix(".xml").read_bytes())
    said = pqsec(f"-k k sign-permissions {new} -o out.p7s").done()
    assert "out.xml differs from the document that was signed" in said.err
