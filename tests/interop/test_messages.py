"""What the stacks really say when they refuse, looked up in the table of their messages."""

import ctypes
import re
import subprocess
from datetime import timedelta
from functools import partial
from pathlib import Path

import pytest

from pqsec_pki.access import Action, Question
from pqsec_pki.algorithms import SIGNATURES, load_private_key, private_key_pem
from pqsec_pki.documents import DomainSet
from pqsec_pki.vendors.messages import recognise
from tests.interop import cyclone_access, fastdds_access
from tests.interop.conftest import permissions_of
from tests.interop.credentials import enrolled
from tests.interop.cyclone import RefusedError
from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.fastdds import participant as fastdds_participant
from tests.interop.test_cyclone import shake_hands
from tests.interop.test_fastdds_messages import FINAL_FIELDS, REPLY_FIELDS, REQUEST_FIELDS

pytestmark = pytest.mark.interop

HEADER = Path("/usr/include/dds/security/dds_security_api_err.h")


def other_key(lab, now):
    return {"key.pem": private_key_pem(SIGNATURES.named("ecdsa-p256").generate())}


def encrypted_key(lab, now):
    """A key that the wrong passphrase does not decrypt: one in 256 it decrypts to noise."""
    key = load_private_key((lab.alice / "key.pem").read_bytes())
    said = b""
    while b"bad decrypt" not in said:
        encrypted = private_key_pem(key, b"secret")
        command = ["openssl", "pkey", "-noout", "-passin", "pass:"]
        said = subprocess.run(command, input=encrypted, capture_output=True, check=False).stderr
    return {"key.pem": encrypted}


def another_ca(lab, now):
    return {"identity_ca.cert.pem": (lab.alice / "permissions_ca.cert.pem").read_bytes()}


def bobs_permissions(lab, now):
    return {"permissions.p7s": (lab.bob / "permissions.p7s").read_bytes()}


def altered(lab, now):
    signed = (lab.alice / "permissions.p7s").read_bytes()
    return {"permissions.p7s": signed.replace(b"<topic>rt/chatter", b"<topic>rt/clatter")}


def unsigned(lab, now):
    return {"permissions.p7s": permissions_of("/lab/alice", now)}


def expired(lab, now):
    old = permissions_of("/lab/alice", now - timedelta(days=60))
    return {"permissions.p7s": lab.sign(old)}


def early(lab, now):
    late = permissions_of("/lab/alice", now + timedelta(days=60))
    return {"permissions.p7s": lab.sign(late)}


def another_domain(lab, now):
    elsewhere = permissions_of("/lab/alice", now, domains=DomainSet.of(10))
    return {"permissions.p7s": lab.sign(elsewhere)}


def strange_element(lab, now):
    document = permissions_of("/lab/alice", now).replace(b"<validity>", b"<odd/><validity>")
    return {"permissions.p7s": lab.sign(document)}


def strange_governance(lab, now):
    document = (lab.keystore.root / "enclaves" / "governance.xml").read_bytes()
    return {"governance.p7s": lab.sign(document.replace(b"<topic_access_rules>", b"<odd/>\\g<0>"))}


def foreign_signer(lab, now):
    return {"permissions_ca.cert.pem": (lab.alice / "identity_ca.cert.pem").read_bytes()}


def no_certificate(lab, now):
    return {"cert.pem": b"not a certificate\n"}


def old_certificate(lab, now):
    return enrolled("ecdsa-p256", "ecdsa-p256", now - timedelta(days=400), "alice")[0]


def new_certificate(lab, now):
    return enrolled("ecdsa-p256", "ecdsa-p256", now + timedelta(days=60), "alice")[0]


CYCLONE = {
    old_certificate: "certificate has expired",
    new_certificate: "certificate is not yet valid",
    encrypted_key: "bad decrypt",
    another_ca: "unable to get local issuer certificate",
    bobs_permissions: "Subject name is invalid",
    altered: "digest failure",
    unsigned: "no content type",
    expired: "Permissions validity period expired for {subject} (expired: {time})",
    early: "Permissions validity period has not started yet for {subject} (start: {time})",
    another_domain: "{topic} denied by default rule",
    strange_element: "Can not parse permissions file",
    strange_governance: "Can not parse governance file",
    foreign_signer: "certificate verify error",
    no_certificate: "no start line",
}
FASTDDS = {
    old_certificate: "certificate has expired",
    new_certificate: "certificate is not yet valid",
    encrypted_key: "Error obtaining private key {path}",
    other_key: "Error verifying private key {path}",
    another_ca: "unable to get local issuer certificate",
    bobs_permissions: (
        "Not found the identity subject name in permissions file. Subject name: {subject}"
    ),
    altered: "Failed verification of the file {path}",
    unsigned: "Cannot read as PKCS7 the file {path}",
    strange_element: "Expected {tag} tag. Line",
    strange_governance: "Error loading Governance XML",
    foreign_signer: "Failed verification of the file {path}",
}


@pytest.fixture
def explains(labs, enclave, now):
    """explains(start, flaw) is the best that is known of what a stack says to that flaw."""

    def explain(start, flaw):
        lab = labs("classical")
        folder = enclave(lab.alice, flaw(lab, now))
        with pytest.raises(RefusedError) as refusal, start(folder) as one:
            one.join(0)
        return best(refusal.value)

    return explain


def best(error):
    return next((found.text for found in recognise(str(error))), None)


def test_what_another_library_left_in_openssls_queue_is_not_said(explains, plugins):
    openssl = ctypes.CDLL("libcrypto.so.3")
    openssl.ERR_new()
    openssl.ERR_set_error(9, 108, None)  # of PEM: no start line
    said = explains(lambda folder: cyclone_participant(plugins, folder), altered)
    assert said == CYCLONE[altered]


@pytest.mark.parametrize("flaw", CYCLONE, ids=lambda flaw: flaw.__name__)
def test_what_cyclone_says_is_explained(explains, plugins, flaw):
    assert explains(lambda folder: cyclone_participant(plugins, folder), flaw) == CYCLONE[flaw]


@pytest.mark.parametrize("flaw", FASTDDS, ids=lambda flaw: flaw.__name__)
def test_what_fastdds_says_is_explained(explains, fastdds, flaw):
    assert explains(lambda folder: fastdds_participant(fastdds, folder), flaw) == FASTDDS[flaw]


def test_what_cyclone_says_of_a_domain_without_governance_is_explained(labs, plugins):
    alice = labs("classical").alice
    with pytest.raises(RefusedError) as refusal, cyclone_participant(plugins, alice) as one:
        one.join(11)
    assert best(refusal.value) == "Could not find domain {domain} in governance"


def test_what_cyclone_says_of_another_algorithm_is_explained(labs, plugins):
    with pytest.raises(RefusedError) as refusal, cyclone_participant(plugins, labs("pq").alice):
        pass
    assert best(refusal.value) == "Certificate authentication algorithm unknown"


def test_what_cyclone_says_of_a_missing_file_is_explained(labs, plugins, enclave):
    folder = enclave(labs("classical").alice, {})
    (folder / "identity_ca.cert.pem").unlink()
    with pytest.raises(RefusedError) as refusal, cyclone_participant(plugins, folder):
        pass
    assert best(refusal.value) == "File could not be found, opened or is empty, path: {path}"


def of_another_ca(labs, other_labs, enclave):
    return other_labs("classical").bob


def with_another_key(labs, other_labs, enclave):
    lab = labs("classical")
    return enclave(lab.bob, other_key(lab, None))


PEERS = {
    of_another_ca: "unable to get local issuer certificate",
    with_another_key: "Failed to finalize digest context",
}


@pytest.fixture
def peer(request, labs, other_labs, enclave):
    """The folder of /lab/bob, with the flaw that the test is for."""
    return request.param(labs, other_labs, enclave)


@pytest.mark.parametrize(
    ("peer", "words"),
    PEERS.items(),
    indirect=["peer"],
    ids=lambda each: getattr(each, "__name__", ""),
)
def test_what_cyclone_says_of_a_peer_is_explained(labs, plugins, peer, words):
    alice = labs("classical").alice
    with cyclone_participant(plugins, alice) as a, cyclone_participant(plugins, peer) as b:
        for one in (a, b):
            one.show(*one.join(0))
        of_b = a.meet(b.guid, b.identity_token)
        of_a = b.meet(a.guid, a.identity_token, of_b.auth_request)
        first, second = ((a, of_b), (b, of_a)) if of_b.begins else ((b, of_a), (a, of_b))
        with pytest.raises(RefusedError) as refusal:
            shake_hands(*first, *second)
    assert best(refusal.value) == words


@pytest.mark.parametrize(
    "words", sorted({*REQUEST_FIELDS.values(), *REPLY_FIELDS.values(), *FINAL_FIELDS.values()})
)
def test_what_fastdds_says_of_altered_handshakes_is_explained(words):
    assert recognise(words, stack="fastdds")


def test_every_message_of_cyclones_table_is_explained(requires):
    header = requires(
        HEADER if HEADER.exists() else None,
        "Cyclone DDS's headers",
        "apt-get install cyclonedds-dev",
    )
    defined = dict(re.findall(r'#define DDS_SECURITY_ERR_(\w+) +(\d+|".*")', header.read_text()))
    texts = {
        k.removesuffix("_MESSAGE"): v.strip('"')
        for k, v in defined.items()
        if k.endswith("_MESSAGE")
    }
    assert len(texts) >= 45
    for name, text in texts.items():
        code = int(defined.get(f"{name}_CODE", "133"))  # one of the names is misspelt
        said = re.sub("%[sd]", "7", text)
        found = recognise(f"{said}(code: {code})", stack="cyclonedds")
        assert code == 0 or [each.message.code for each in found] == [code], text


DENYING = """<deny_rule><domains><id>0</id></domains>
<publish><topics><topic>rt/chatter</topic></topics></publish></deny_rule><allow_rule>"""


def as_issued(lab, now):
    return {}


def denying(lab, now):
    document = permissions_of("/lab/alice", now).replace(b"<allow_rule>", DENYING.encode(), 1)
    return {"permissions.p7s": lab.sign(document)}


def other_topic_rules(lab, now):
    document = (lab.keystore.root / "enclaves" / "governance.xml").read_bytes()
    changed = document.replace(b"<topic_expression>*<", b"<topic_expression>other<")
    return {"governance.p7s": lab.sign(changed)}


# (flaw, topic, partitions): what is known of what the stack says
CYCLONE_DECIDES = {
    (as_issued, "rt/other"): "{topic} denied by default rule",
    (denying, "rt/chatter"): "{topic} found in deny_rule.",
    (other_topic_rules, "rt/chatter"): (
        "Could not find {topic} topic attributes for domain({domain}) in governance"
    ),
}
FASTDDS_DECIDES = {
    (as_issued, "rt/other"): "{topic} topic not found in allow rule",
    (as_issued, "rt/chatter", "floor"): "{partition} partition not found in rule",
    (denying, "rt/chatter"): "{topic} topic denied by deny rule",
    (other_topic_rules, "rt/chatter"): "Not found topic access rule for topic {topic}",
    (another_domain, "rt/chatter"): "Not found a rule allowing to use the domain_id",
}


@pytest.fixture
def decides(labs, enclave, now):
    """decides(access_control, flaw, topic, ...) is the best of why alice may not publish it."""

    def ask(access_control, flaw, topic, *partitions):
        lab = labs("classical")
        asked = {"subject": "CN=/lab/alice", "domain": 0, "action": Action.PUBLISH, "now": now}
        question = Question(topic=topic, partitions=partitions, **asked)
        with access_control(enclave(lab.alice, flaw(lab, now)), 0) as control:
            return best(control.own(question) or control.peer(question))

    return ask


@pytest.mark.parametrize("case", CYCLONE_DECIDES, ids=lambda case: case[0].__name__)
def test_what_cyclone_says_of_an_endpoint_is_explained(decides, plugins, case):
    access_control = partial(cyclone_access.access_control, plugins)
    assert decides(access_control, *case) == CYCLONE_DECIDES[case]


@pytest.mark.parametrize("case", FASTDDS_DECIDES, ids=lambda case: f"{case[0].__name__}{len(case)}")
def test_what_fastdds_says_of_an_endpoint_is_explained(decides, fastdds, case):
    access_control = partial(fastdds_access.access_control, fastdds)
    assert decides(access_control, *case) == FASTDDS_DECIDES[case]
