"""pqsec verify-handshake: two participants meet, or the step that fails says why.

Each flaw is made as an attacker or an accident would make it: in the files.
"""

import re
import shutil
from base64 import b64encode
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    load_private_key,
    private_key_pem,
    profile_named,
)
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from tests.cli.conftest import NAMES, PARTICIPANTS
from tests.cli.test_verify import stripped

LINE = "-k k verify-handshake /talker /listener"
ADD_THE_DOMAIN = (
    "add the domain to k/enclaves/governance.xml and run `pqsec -k k sign-governance"
    " k/enclaves/governance.xml --force`; the permissions must name the domain too"
)
KEYS = {
    "ok",
    "initiator",
    "profile",
    "further",
    "replier",
    "why",
    "stacks",
    "signature",
    "key_agreement",
    "token_bytes",
    "steps",
    "milliseconds",
    "domain",
    "shared_domains",
    "topic_flows",
}
SIGNATURES = {
    "transition": "ECDSA-SHA256+ML-DSA-65",
    "hybrid": "MLDSA65-ECDSA-P256-SHA512",
    "pq": "ML-DSA-65",
    "cnsa2": "ML-DSA-87",
    "classical": "ECDSA-SHA256",
}
AGREEMENTS = {
    "transition": "X25519MLKEM768",
    "hybrid": "X25519MLKEM768",
    "pq": "MLKEM768",
    "cnsa2": "MLKEM1024",
    "classical": "ECDH+prime256v1-CEUM",
}
each_profile = pytest.mark.parametrize("profile", NAMES)


@pytest.fixture
def fails(pqsec):
    """fails(step, words...) : the handshake must end with a no, at that step, for that reason."""

    def check(step, *words, line=LINE):
        said = pqsec(f"{line} --json")
        assert said.code == 1, said
        report = said.json
        assert report["ok"] is False
        *before, last = report["steps"]
        assert all(each["ok"] for each in before)
        assert last["ok"] is False
        assert last["name"] == step
        assert not [word for word in words if word not in last["detail"]], last["detail"]
        told = pqsec(line)
        assert told.code == 1
        *passed, failed = told.out.splitlines()[: len(report["steps"])]
        assert all(line.startswith("ok    ") for line in passed)
        assert failed.split("  ", 1)[0] == "FAIL"
        assert failed.removeprefix(f"FAIL  {step} ").strip() == last["detail"]
        hint = [f"hint: {last['hint']}"] if "hint" in last else []
        end = ["", f"They would not meet: {step} failed.", *hint]
        assert told.out.splitlines()[len(report["steps"]) :] == end
        assert told.err == said.err == ""
        return last

    return check


def take(name, source, goal):
    """The file `name` of one folder takes the place of another folder's."""
    shutil.copyfile(source / name, goal / name)


def enclaves(keystore):
    return keystore / "enclaves/talker", keystore / "enclaves/listener"


# They meet


@each_profile
def test_two_of_one_domain_meet(pqsec, keystore, profile):
    keystore(profile)
    report = pqsec(f"{LINE} --json").done().json
    assert set(report) == KEYS
    assert report["ok"] is True
    assert {report["initiator"], report["replier"]} == {"/talker", "/listener"}
    assert report["stacks"] == {"/talker": "pqsec", "/listener": "pqsec"}
    assert report["signature"] == SIGNATURES[profile]
    assert report["key_agreement"] == AGREEMENTS[profile]
    assert list(report["token_bytes"]) == ["request", "reply", "final"]
    assert all(size > 400 for size in report["token_bytes"].values())
    assert all(set(step) == {"name", "ok", "detail"} for step in report["steps"])
    assert all(step["ok"] and step["detail"] for step in report["steps"])
    assert 0 < report["milliseconds"] < 60_000


@each_profile
def test_every_step_is_told_to_a_person(pqsec, keystore, profile):
    keystore(profile)
    names = [step["name"] for step in pqsec(f"{LINE} --json").json["steps"]]
    assert names == [
        "files of /talker",
        "identity of /talker",
        "documents of /talker",
        "files of /listener",
        "identity of /listener",
        "documents of /listener",
        "initiator",
        "auth requests",
        "request",
        "reply",
        "final",
        "authenticated",
        "message /talker to /listener",
        "message /listener to /talker",
        "/talker admits /listener",
        "/listener admits /talker",
    ]
    lines = pqsec(LINE).done().out.splitlines()
    assert [line[:4] for line in lines[: len(names)]] == ["ok  "] * len(names)
    assert all(name in line for name, line in zip(names, lines, strict=False))
    assert f"key agreement {AGREEMENTS[profile]}" in lines[-2]


def test_the_order_of_the_names_does_not_change_who_initiates(pqsec, keystore):
    keystore()
    one = pqsec(f"{LINE} --json").json
    other = pqsec("-k k verify-handshake listener talker --json").json
    assert (one["initiator"], one["why"]) == (other["initiator"], other["why"])
    assert one["why"].startswith(f"{one['initiator']} initiates: its GUID is smaller")


@pytest.mark.parametrize("kem", [*(row.name for row in KEY_AGREEMENTS), "xwing"])
def test_any_key_agreement_can_be_tried(pqsec, keystore, kem):
    keystore("transition")
    row = KEY_AGREEMENTS.named(kem)
    said = pqsec(f"{LINE} --kem {kem} --json").done()
    assert said.json["key_agreement"] == row.wire_name
    recorded = "recorded traffic between pqsec peers stays secret from a quantum computer"
    assert said.err == ("" if row.level else broken("transition", recorded))


@pytest.mark.parametrize(
    ("profile", "kem", "promise"),
    [
        ("hybrid", "mlkem768", "every signature and key agreement is secure while either half is"),
        ("pq", "ecdh-p256", "every signature and key agreement withstands a quantum computer"),
        ("cnsa2", "x25519mlkem768", "CNSA 2.0: ML-DSA-87 and ML-KEM-1024 only"),
        ("classical", "mlkem768", "the key agreement is one that stock stacks run"),
    ],
)
def test_a_key_agreement_that_breaks_a_promise_is_tried_and_noted(
    pqsec, keystore, profile, kem, promise
):
    keystore(profile)
    said = pqsec(f"{LINE} --kem {kem}").done()
    assert said.err == broken(profile, promise)
    assert f"key agreement {KEY_AGREEMENTS.named(kem).wire_name}\n" in said.out


def broken(profile, promise):
    combination = f"this combination breaks what profile {profile} promises: {promise}"
    return f"pqsec: note: {combination}; the handshake runs anyway\n"


def test_an_unknown_key_agreement_is_refused_with_those_there_are(pqsec, keystore):
    keystore()
    pqsec(f"{LINE} --kem kyber").refused(2, "no key agreement named 'kyber'", hint="mlkem768")


def test_nothing_is_written_and_no_passphrase_needed(pqsec, locked, tmp_path):
    pqsec("-k k issue /talker /listener --publish x --passphrase-file right").done()
    before = {path: path.stat().st_mtime_ns for path in locked.rglob("*")}
    pqsec(LINE).done()
    assert {path: path.stat().st_mtime_ns for path in locked.rglob("*")} == before


# Whose certificate


@each_profile
def test_a_certificate_from_another_ca_of_the_same_name_is_refused(fails, keystore, profile):
    talker, _ = enclaves(keystore(profile))
    stranger, _ = enclaves(keystore(profile, "other", "another"))
    for path in [*stranger.glob("cert.pem"), *stranger.glob("*key.pem")]:
        take(path.name, stranger, talker)
    fails("identity of /talker", "certificate of CN=/talker is not signed by this CA")


def test_a_whole_enclave_from_another_keystore_is_refused(fails, keystore, tmp_path):
    k, other = keystore("transition"), keystore("transition", "other", "another")
    shutil.rmtree(k / "enclaves/listener")
    shutil.copytree(other / "enclaves/listener", k / "enclaves/listener", symlinks=True)
    words = ("is not signed by this CA", "the alternative signature of")
    fails("identity of /listener", *words)


def test_an_enclave_that_brings_its_own_cas_fails_at_the_handshake(fails, keystore):
    """All of /listener's own checks pass: it trusts the CA in its own files. Its peer does not."""
    k, other = keystore(), keystore("classical", "other", "another")
    shutil.rmtree(k / "enclaves/listener")
    shutil.copytree(other / "enclaves/listener", k / "enclaves/listener", symlinks=False)
    fails("reply", "the certificate of CN=/talker is not signed by this CA")


@each_profile
def test_the_key_of_another_is_refused(fails, keystore, profile):
    talker, listener = enclaves(keystore(profile))
    take("key.pem", listener, talker)
    step = fails("identity of /talker", "key.pem: not the private key of the certificate")
    assert "pqsec renew /talker" in step["hint"]


def test_the_alternative_key_of_another_is_refused(fails, keystore):
    talker, listener = enclaves(keystore("transition"))
    take("alt.key.pem", listener, talker)
    fails("identity of /talker", "alt.key.pem: not the alternative key of the certificate")


def test_a_lost_alternative_key_is_refused(fails, keystore):
    talker, _ = enclaves(keystore("transition"))
    (talker / "alt.key.pem").unlink()
    fails("identity of /talker", "alt.key.pem: it is missing")


def test_a_classical_enclave_in_a_transition_domain_is_refused(fails, keystore):
    k, plain = keystore("transition"), keystore("classical", "plain")
    shutil.rmtree(k / "enclaves/talker")
    shutil.copytree(plain / "enclaves/talker", k / "enclaves/talker", symlinks=False)
    words = "no alternative key, where profile transition has ml-dsa-65"
    fails("identity of /talker", words)


@pytest.mark.parametrize(
    ("days", "words"), [(-60, "CN=/late expired on "), (60, "CN=/late is not valid before ")]
)
@pytest.mark.parametrize("profile", ["classical", "transition", "pq"])
def test_a_certificate_out_of_its_time_is_refused(fails, old_domain, profile, days, words):
    k = old_domain(profile)
    moment = datetime.now(UTC) + timedelta(days=days)
    month = timedelta(days=30)
    spec = ParticipantSpec(name="/late", domains=k.domains, publish=("x",), validity=month)
    issue(k, k.unlock(None), [spec], now=moment)
    last = fails("identity of /late", words, line="-k k verify-handshake /talker /late")
    assert ("`pqsec renew /late` renews" in last.get("hint", "")) == (days < 0)


def test_a_ca_that_has_expired_is_refused(fails, old_domain):
    old_domain("classical", timedelta(days=60))
    words = ("the CA certificate expired on", "the certificate of CN=/talker expired on")
    fails("identity of /talker", *words)


@pytest.fixture
def old_domain(tmp_path):
    """old_domain("pq", validity) is a keystore `k` of 90 days ago, with one participant."""

    def make(profile, validity=timedelta(days=900)):
        then = datetime.now(UTC) - timedelta(days=90)
        domains = DomainSet.of(0)
        k = Keystore.create(
            tmp_path / "k",
            profile_named(profile),
            name="",
            domains=domains,
            validity=validity,
            passphrase=None,
            now=then,
        )
        specs = [
            ParticipantSpec(name=name, domains=domains, publish=("x",), validity=validity)
            for name in PARTICIPANTS
        ]
        issue(k, k.unlock(None), specs, now=then)
        return k

    return make


# What is permitted


@each_profile
def test_permissions_of_another_are_refused(fails, keystore, profile):
    talker, listener = enclaves(keystore(profile))
    take("permissions.p7s", listener, talker)
    fails("documents of /talker", "/talker may not join domain 0: no grant is for CN=/talker")


@each_profile
def test_permissions_signed_by_another_domain_are_refused(fails, keystore, profile):
    _, listener = enclaves(keystore(profile))
    take("permissions.p7s", enclaves(keystore(profile, "other", "another"))[1], listener)
    words = ("permissions.p7s: ", "not signed by CN=Permissions CA but by another certificate")
    fails("documents of /listener", *words)


@pytest.fixture
def resign(pqsec, tmp_path):
    """resign(file, pattern, new) edits a document of the keystore and has its CA sign it."""

    def edit(file, pattern, new):
        path = tmp_path / "k/enclaves" / file
        text, changes = re.subn(pattern, new, path.read_text(), flags=re.DOTALL)
        assert changes == 1
        path.write_text(text)
        kind = path.stem
        pqsec(f"-k k sign-{kind} k/enclaves/{file} --force").done()

    return edit


@pytest.mark.parametrize(("days", "words"), [(-60, "ended at "), (60, "starts at ")])
def test_permissions_out_of_their_time_are_refused(resign, fails, keystore, days, words):
    keystore("transition")
    middle = datetime.now(UTC) + timedelta(days=days)
    span = (middle - timedelta(days=9), middle + timedelta(days=9))
    first, last = (f"{time:%Y-%m-%dT%H:%M:%SZ}" for time in span)
    span = f"<validity><not_before>{first}</not_before><not_after>{last}</not_after></validity>"
    resign("talker/permissions.xml", "<validity>.*</validity>", span)
    fails("documents of /talker", f"/talker may not join domain 0: grant '/talker' {words}")


def test_permissions_for_another_domain_are_refused(resign, fails, keystore):
    keystore()
    resign("talker/permissions.xml", "<id>0</id>", "<id>7</id>")
    words = "/talker may not join domain 0: grant '/talker' has no allow_rule for domain 0"
    step = fails("documents of /talker", words)
    assert "`pqsec explain --participant /talker --join` shows where it may" in step["hint"]


def test_governance_for_another_domain_is_refused(resign, fails, keystore):
    keystore()
    resign("governance.xml", "<id>0</id>", "<id>7</id>")
    words = "may not join domain 0: no governance rule names domain 0"
    assert fails("documents of /talker", words)["hint"] == ADD_THE_DOMAIN


def test_another_domain_than_both_are_for_is_refused(fails, keystore):
    keystore()
    words = "may not join domain 7: no governance rule names domain 7"
    step = fails("documents of /talker", words, line=f"{LINE} --domain 7")
    assert step["hint"] == ADD_THE_DOMAIN


def test_the_command_that_adds_a_domain_to_governance_works_as_it_is_told(
    pqsec, fails, keystore, tmp_path
):
    keystore()
    words = "may not join domain 7: no governance rule names domain 7"
    hint = fails("documents of /talker", words, line=f"{LINE} --domain 7")["hint"]
    governance = tmp_path / "k/enclaves/governance.xml"
    text = governance.read_text()
    governance.write_text(text.replace("<id>0</id>", "<id>0</id><id>7</id>"))
    assert governance.read_text() != text
    pqsec(hint.split("`")[1].removeprefix("pqsec ")).done()
    step = fails("documents of /talker", "may not join domain 7", line=f"{LINE} --domain 7")
    assert "no governance rule" not in step["detail"]


@pytest.mark.parametrize("domain", ["-1", "231", "x", ""])
def test_a_domain_that_is_none_is_a_usage_error(pqsec, keystore, domain):
    keystore()
    pqsec(f"{LINE} --domain={domain}").refused(2, "--domain")


@each_profile
@pytest.mark.parametrize(
    ("file", "step"),
    [
        ("governance.p7s", "documents of /talker"),
        ("talker/permissions.p7s", "documents of /talker"),
        ("listener/permissions.p7s", "documents of /listener"),
    ],
)
def test_xml_altered_after_it_was_signed_is_refused(fails, keystore, profile, file, step):
    path = keystore(profile) / "enclaves" / file
    old, new = (b"ENCRYPT", b"NONE") if "governance" in file else (b"rt/chatter", b"*")
    signed = path.read_bytes()
    assert old in signed
    path.write_bytes(signed.replace(old, new))
    fails(step, f"{path.name}: the content was changed after signing")


@pytest.mark.parametrize("file", ["governance.p7s", "talker/permissions.p7s"])
def test_a_stripped_countersignature_is_refused(fails, keystore, file):
    path = keystore("transition") / "enclaves" / file
    path.write_bytes(stripped(path.read_bytes()))
    words = "there is no post-quantum signature that could be checked, and one is required"
    fails("documents of /talker", f"{path.name}: {words}")


@each_profile
def test_another_permissions_ca_is_refused(fails, keystore, profile):
    k, other = keystore(profile), keystore(profile, "other", "another")
    take("permissions_ca.cert.pem", other / "public", k / "public")
    words = "governance.p7s: not signed by CN=Permissions CA but by another certificate"
    fails("documents of /talker", words)


def test_another_countersigner_is_refused(fails, keystore):
    k, other = keystore("transition"), keystore("transition", "other", "another")
    take("permissions_ca.alt.cert.pem", other / "public", k / "public")
    fails("documents of /talker", "governance.p7s: there is no post-quantum signature")


@pytest.mark.parametrize(
    "content", [b"", b"\0\xff" * 99, b"<dds/>"], ids=["empty", "binary", "XML"]
)
@pytest.mark.parametrize("file", ["governance.p7s", "talker/permissions.p7s"])
def test_a_document_that_is_none_is_named(fails, keystore, file, content):
    path = keystore() / "enclaves" / file
    path.write_bytes(content)
    fails("documents of /talker", f"{path.name}: ")


@pytest.mark.parametrize("profile", ["classical", "transition", "pq"])
def test_a_certificate_whose_signature_was_altered_is_refused(fails, keystore, profile):
    talker, _ = enclaves(keystore(profile))
    der = bytearray(Certificate.from_pem((talker / "cert.pem").read_bytes()).der)
    der[-1] ^= 1
    text = b64encode(der).decode()
    pem = f"-----BEGIN CERTIFICATE-----\n{text}\n-----END CERTIFICATE-----\n"
    (talker / "cert.pem").write_text(pem)
    fails("identity of /talker", "the certificate of CN=/talker is not signed by this CA")


@pytest.mark.parametrize("file", ["cert.pem", "key.pem", "alt.key.pem", "identity_ca.cert.pem"])
@pytest.mark.parametrize(
    "content",
    [b"", b"\0\xff" * 99, b"-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----\n"],
    ids=["empty", "binary", "hollow"],
)
def test_a_file_that_is_no_key_or_certificate_is_named(fails, keystore, file, content):
    (keystore("transition") / "enclaves/talker" / file).write_bytes(content)
    step = fails("files of /talker", f"k/enclaves/talker/{file}: ")
    assert step["detail"].count(file) == 1
    assert (
        step["hint"]
        == "restore it from a backup, or reissue it: `pqsec renew /talker` keeps its permissions"
    )


@pytest.mark.parametrize(
    "file", ["key.pem", "permissions.p7s", "governance.p7s", "permissions_ca.cert.pem"]
)
def test_a_missing_file_is_named(fails, keystore, file):
    (keystore() / "enclaves/listener" / file).unlink()
    step = fails("files of /listener", "k/enclaves/listener lacks ")
    assert step["detail"] == f"k/enclaves/listener lacks {file}"
    # What it may do is not known without its permissions.
    way = "pqsec issue" if file == "permissions.p7s" else "pqsec renew"
    assert f"{way} /listener" in step["hint"]


def test_all_missing_files_are_named(fails, pqsec, keystore):
    k = keystore("transition")
    for file in ("key.pem", "permissions.p7s", "governance.p7s"):
        (k / "enclaves/talker" / file).unlink()
    words = "k/enclaves/talker lacks permissions.p7s, governance.p7s, key.pem"
    step = fails("files of /talker", words, line="-k k verify-handshake talker// /listener")
    pqsec(f"-k k {step['hint'].partition(': pqsec ')[2].partition(' ...')[0]} --publish x").done()
    pqsec(LINE).done()


def test_a_certificate_that_leads_nowhere_is_named(fails, keystore):
    file = keystore() / "enclaves/talker/cert.pem"
    file.unlink()
    file.symlink_to("nowhere")
    fails("files of /talker", "k/enclaves/talker lacks cert.pem")


def test_a_lost_ca_certificate_is_missed_behind_its_link(fails, keystore):
    (keystore() / "public/identity_ca.cert.pem").unlink()
    step = fails("files of /talker", "k/enclaves/talker lacks identity_ca.cert.pem")
    shared = "k/public/identity_ca.cert.pem"
    assert step["hint"] == f"restore {shared}, which all participants share"


def test_a_participants_key_that_is_encrypted_is_named(fails, keystore):
    k = keystore()
    key = load_private_key((k / "enclaves/talker/key.pem").read_bytes())
    (k / "enclaves/talker/key.pem").write_bytes(private_key_pem(key, b"open sesame, please"))
    words = "k/enclaves/talker/key.pem: the private key is encrypted and no passphrase was given"
    step = fails("files of /talker", words)
    assert (
        step["hint"]
        == "restore it from a backup, or reissue it: `pqsec renew /talker` keeps its permissions"
    )


# What cannot be tried at all


def test_a_participant_does_not_meet_itself(fails, keystore):
    keystore()
    step = fails(
        "initiator",
        "both are /talker: a participant has no handshake with itself",
        line="-k k verify-handshake /talker talker/",
    )
    assert step["hint"] == "name two different participants"


@pytest.mark.parametrize("line", ["/talker /nobody", "/nobody /talker", "/talker /talker/arm"])
def test_an_unknown_participant_is_named_with_the_way_to_make_it(pqsec, keystore, line):
    keystore()
    name = line.replace("/talker ", "").replace(" /talker", "")
    said = pqsec(f"-k k verify-handshake {line}")
    said.refused(3, f"there is no participant {name} in k", hint=f"pqsec issue {name}")


@pytest.mark.parametrize("line", ["verify-handshake /talker /listener", "renew /listener"])
def test_a_participant_without_its_certificate_is_not_taken_for_an_unknown_one(
    pqsec, keystore, line
):
    (keystore() / "enclaves/listener/cert.pem").unlink()
    said = pqsec(f"-k k {line}")
    said.refused(3, "k/enclaves/listener lacks cert.pem", hint="restore it from a backup")
    assert "no participant" not in said.err


@pytest.mark.parametrize("name", ["/../talker", "/", "", "/talker/cert.pem"])
def test_a_name_that_can_be_none_is_a_usage_error(pqsec, keystore, name):
    keystore()
    pqsec("-k k verify-handshake /talker", name).refused(2, "cannot be a participant's name")


# Where they meet, and what they may say there


@pytest.fixture
def fleet(pqsec, keystore):
    """Keystore `k` of domains 0-3: /one on 1, /two on 1 and 2, /three on 2 and 3."""
    keystore()
    pqsec("governance new --domain 0-3 -o g.yaml").done()
    pqsec("-k k sign-governance g.yaml -o k/enclaves/governance.p7s --force").done()
    pqsec("-k k issue /one --domain 1 --publish rt/cmd --subscribe rt/scan").done()
    pqsec("-k k issue /two --domain 1-2 --subscribe rt/cmd --publish 'rt/s*'").done()
    pqsec("-k k issue /three --domain 2-3 --publish rt/pose").done()


def meet(pqsec, names, code=0):
    said = pqsec(f"-k k verify-handshake {names} --json")
    assert said.code == code, said
    return said.json


def test_two_meet_on_a_domain_that_both_may_join(pqsec, fleet):
    found = meet(pqsec, "/one /two")
    assert (found["domain"], found["shared_domains"]) == (1, [1])
    pqsec("-k k issue /four --domain 1-3 --publish rt/cmd").done()
    found = meet(pqsec, "/four /two")
    assert (found["domain"], found["shared_domains"]) == (1, [1, 2])
    told = pqsec("-k k verify-handshake /four /two").done().out
    assert "They meet on domain 1; both may join 2 too.\n" in told
    assert "They meet on domain 2" in pqsec("-k k verify-handshake /four /two --domain 2").out


def test_two_that_share_no_domain_are_told_so(pqsec, fleet, fails):
    step = fails(
        "common domain",
        "they share no domain: /one may join domain 1, /three may join domains 2, 3",
        line="-k k verify-handshake /one /three",
    )
    assert "--force" not in step["hint"]
    pqsec("-k k verify-handshake /one /three --attack all").refused(1, "they share no domain")
    # Where a domain is named, it is that one that is told of.
    fails("documents of /three", "domain 1", line="-k k verify-handshake /one /three --domain 1")


def test_what_two_may_say_to_each_other_is_told(pqsec, fleet):
    assert meet(pqsec, "/one /two")["topic_flows"] == [
        {"from": "/one", "to": "/two", "topics": ["rt/cmd"]},
        {"from": "/two", "to": "/one", "topics": ["rt/scan"]},
    ]
    told = pqsec("-k k verify-handshake /one /two").done().out
    assert "\n/one to /two: rt/cmd\n/two to /one: rt/scan\n" in told


def test_two_that_meet_and_share_no_topic_are_told_so(pqsec, fleet):
    found = meet(pqsec, "/two /three")
    assert found["ok"] is True
    assert [each["topics"] for each in found["topic_flows"]] == [[], []]
    told = pqsec("-k k verify-handshake /two /three").done().out
    assert "\n/two to /three: no topic\n/three to /two: no topic\n" in told
    assert "the other may publish, ros_discovery_info aside." in told
    assert "They share no topic: " not in pqsec("-k k verify-handshake /one /two").out


def test_all_pairs_tell_who_shares_no_topic_and_which_way(pqsec, fleet):
    pqsec("-k k issue /ear --domain 3 --subscribe 'rt/p*'").done()
    said = pqsec("-k k verify-handshake --all").done().out
    rows = {line.split()[1]: line.split()[2:] for line in said.splitlines()[1:7]}
    # /ear /listener /one /talker /three /two
    assert rows["/three"] == ["ok", "-", "-", "-", "met"]
    assert rows["/ear"] == ["-", "-", "-", "met", "-"]
    assert rows["/one"] == ["-", "-", "-", "-", "ok"]
    assert "1 without a common topic" in said
    assert "met: it succeeds, but " in said
    found = pqsec("-k k verify-handshake --all --json").done().json
    assert found["totals"]["no_common_topic"] == 1
    talks = {tuple(each["pair"]): each["topic_flows"] for each in found["pairs"]}
    assert talks["/ear", "/three"] == [
        {"from": "/ear", "to": "/three", "topics": []},
        {"from": "/three", "to": "/ear", "topics": ["rt/pose"]},
    ]
