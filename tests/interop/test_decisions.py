"""The readings answer as the stacks they are named for: policies and questions at random.

The stacks' own access control judges documents that we signed, as a participant's own
stack and as its peers. A disagreement shows the question, both answers and the documents.
"""

import locale
import shutil
from collections import Counter
from dataclasses import replace
from datetime import timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from pqsec_pki.access import (
    CYCLONEDDS,
    CYCLONEDDS_11,
    FASTDDS,
    Action,
    Question,
    Viewpoint,
    decide,
)
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import (
    Criteria,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    Permissions,
)
from pqsec_pki.documents.domains import MAX_DOMAIN_ID
from tests.interop import cyclone_access, fastdds_access
from tests.interop.cyclone import plugins_of
from tests.interop.policies import DOMAINS, EVERYWHERE, Maker, questions
from tests.longer import LONG

pytestmark = pytest.mark.interop

POLICIES = 30 if LONG else 8
DAY = timedelta(days=1)
SUBJECT = "CN=/lab/alice"

NAME, LAB, UNIT, COUNTRY, MAIL = (
    NameOID.COMMON_NAME,
    NameOID.ORGANIZATION_NAME,
    NameOID.ORGANIZATIONAL_UNIT_NAME,
    NameOID.COUNTRY_NAME,
    NameOID.EMAIL_ADDRESS,
)
SUBJECTS = (
    [(NAME, "/robot")],
    [(NAME, "/robot/admin")],
    [(NAME, "/x/x")],
    [(NAME, "/x//y")],
    [(COUNTRY, "ES"), (LAB, "Lab"), (NAME, "x")],
    [(UNIT, "a"), (UNIT, "b"), (NAME, "x")],
    [(NAME, "x"), (MAIL, "x@lab.example")],
    [(NAME, "ñ")],
    [(LAB, "Acme, Inc"), (NAME, 'a+"b"|c')],
    [(NAME, " a  b ")],
)
SPELLINGS = (
    "CN=/robot",
    "CN=/robot/admin",
    "CN=/admin/robot",
    "CN=/robotics",
    "CN = /robot",
    "CN=/x",
    "CN=/x/x",
    "CN=/x//y",
    "CN=x,O=Lab,C=ES",
    "C=ES,O=Lab,CN=x",
    "CN=x, O=Lab , C=ES",
    "CN = x, O = Lab, C = ES",
    "/C=ES/O=Lab/CN=x",
    "CN=x,O=Lab",
    "CN=x,O=Lab,L=Madrid,C=ES",
    "cn=x,O=Lab,C=ES",
    "CN=x,OU=b,OU=a",
    "OU=a,OU=b,CN=x",
    "emailAddress=x@lab.example,CN=x",
    "1.2.840.113549.1.9.1=x@lab.example,CN=x",
    "CN=ñ",
    "CN=\\C3\\B1",
    'CN=a\\+\\"b\\"|c,O=Acme\\, Inc',
    "CN=\\ a  b\\ ",
    "gibberish",
    "CN=x" + ",O=x" * 20,
    "CN=x,foo",
    "CN=/robot,foo,=",
    "CN=/x /x",
    " CN=/robot",
    "CN=x,  OU = b, OU=  a",
)


class Tally:
    """How often a stack agreed with its reading, by its answers."""

    def __init__(self, interpretation) -> None:
        self._reading = interpretation
        self.answers = Counter()

    def compare(self, governance, permissions, question, side, refusal):
        """AssertionError with all there is to know if our answer is not theirs."""
        decision = decide(governance, permissions, question, self._reading, by=side)
        assert decision.allowed is not bool(refusal), "\n".join(
            [
                f"{question}",
                f"{self._reading.title}, {side}: {refusal or 'yes'}",
                f"ours: {decision.allowed}, {decision.reason}",
                governance.to_xml().decode(),
                permissions.to_xml().decode(),
            ]
        )
        self.answers[decision.allowed] += 1


@pytest.fixture
def folder(labs, tmp_path):
    """The files of a participant, to be written over."""
    return shutil.copytree(labs("classical").alice, tmp_path / "alice")


WIDE_TOPICS = ("aé", "é", "日", "ab", "éx", "aéx", "aß", "b")
WIDE_PATTERNS = (
    *("a?", "?", "??", "a[!b]", "[!a]", "[é-ü]", "[[:alpha:]]", "[é]*", "a*", "aé", "???"),
    *("a[^b]x", "[!a]x"),
)


@pytest.fixture(params=FASTDDS.locales, ids=lambda row: row.locale)
def fast_dds_in(request, fastdds, labs, folder):
    """The reading for a locale, and Fast DDS in this process, which is in that locale."""
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_ALL, request.param.locale)
    yield signing_witness(request.param, labs, folder, fastdds)
    locale.setlocale(locale.LC_ALL, before)


@pytest.mark.parametrize("where", ["a topic", "a denied topic", "a partition", "governance"])
def test_fast_dds_matches_by_the_locale_of_its_process_as_its_reading(fast_dds_in, now, where):
    """Its fnmatch follows setlocale: a Python process has C.UTF-8, a C++ process that never calls
    it has C."""
    tally, is_partition = Tally(fast_dds_in.interpretation), where == "a partition"
    for pattern in WIDE_PATTERNS:
        governance, grant = wide_documents(pattern, where, now)
        permissions = Permissions(grants=(grant,))
        with fast_dds_in(governance, permissions, 0) as stack:
            for name in WIDE_TOPICS:
                asked = Question(
                    subject=SUBJECT,
                    domain=0,
                    action=Action.PUBLISH,
                    now=now,
                    topic="topic" if is_partition else name,
                    partitions=(name,) if is_partition else (),
                )
                tally.compare(governance, permissions, asked, Viewpoint.OWN, stack.own(asked))
                tally.compare(governance, permissions, asked, Viewpoint.PEER, stack.peer(asked))
    assert min(tally.answers[True], tally.answers[False]) > len(WIDE_TOPICS), tally.answers


def wide_documents(pattern, where, now):
    """Governance, and a grant to publish, with the pattern in one place."""
    governance = Governance.protected(DomainSet.of(0))
    grant = anything_for(SUBJECT, now)
    [rule] = grant.rules
    here = {
        "a topic": (Criteria(topics=(pattern,)),),
        "a partition": (Criteria(topics=("topic",), partitions=(pattern,)),),
    }.get(where, rule.publish)
    rules = (replace(rule, publish=here),)
    if where == "a denied topic":
        denied = replace(rule, allow=False, publish=(Criteria(topics=(pattern,)),), subscribe=())
        rules = (denied, *rules)
    if where == "governance":
        [domain_rule] = governance.domain_rules
        [topic_rule] = domain_rule.topic_rules
        opened = replace(topic_rule, topic_expression=pattern, enable_write_access_control=False)
        here = (replace(domain_rule, topic_rules=(opened, topic_rule)),)
        governance = replace(governance, domain_rules=here)
        rules = (replace(rule, publish=(Criteria(topics=("nothing",)),)),)
    return governance, replace(grant, rules=rules)


WITNESSES = {
    CYCLONEDDS: ("plugins", cyclone_access),
    FASTDDS: ("fastdds", fastdds_access),
    CYCLONEDDS_11: ("plugins_11", cyclone_access),
}


@pytest.fixture(params=WITNESSES, ids=lambda interpretation: interpretation.name)
def witness(request, labs, folder):
    """The reading of a stack, and witness(governance, permissions, domain), the stack itself."""
    installed, stack = WITNESSES[request.param]
    library = request.getfixturevalue(installed)
    return signing_witness(request.param, labs, folder, library, stack)


def signing_witness(interpretation, labs, folder, library, stack=fastdds_access):
    sign = labs("classical").sign

    def witness(governance, permissions, domain):
        (folder / "governance.p7s").write_bytes(sign(governance.to_xml()))
        (folder / "permissions.p7s").write_bytes(sign(permissions.to_xml()))
        return stack.access_control(library, folder, domain)

    witness.interpretation = interpretation
    return witness


def test_a_library_of_another_version_is_not_asked(plugins, tmp_path):
    [library] = plugins.parent.glob("libddsc.so.0.10.*")
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/libddsc.so").symlink_to(library)
    with pytest.raises(AssertionError, match=r"has Cyclone DDS 0\.10\.[0-9]+, not 11\.0"):
        plugins_of(tmp_path, "11.0")
    assert plugins_of(tmp_path, "0.10") == tmp_path / "lib"


@pytest.mark.slow(but=1)
def test_a_stack_answers_as_its_reading(witness):
    tally = Tally(witness.interpretation)
    for seed in range(POLICIES):
        made = Maker(seed)
        documents = made.governance(), made.permissions(SUBJECT)
        for domain in DOMAINS:
            with witness(*documents, domain) as stack:
                for question in questions(SUBJECT, domain, witness.interpretation):
                    tally.compare(*documents, question, Viewpoint.OWN, stack.own(question))
                    tally.compare(*documents, question, Viewpoint.PEER, stack.peer(question))
    assert min(tally.answers[True], tally.answers[False]) > 30 * POLICIES, tally.answers


@pytest.mark.slow
def test_a_stack_finds_the_grants_of_a_subject_as_its_reading(witness, folder, now):
    tally, governance = Tally(witness.interpretation), Governance.protected(DomainSet.of(0))
    for parts in SUBJECTS:
        identity = identity_of(parts, now)
        for name, content in identity.items():
            (folder / name).write_bytes(content)
        subject = Certificate.from_pem(identity["cert.pem"]).subject_name
        question = Question(subject=subject, domain=0, action=Action.JOIN, now=now)
        for spelling in (subject, *SPELLINGS):
            permissions = Permissions(grants=(anything_for(spelling, now),))
            with witness(governance, permissions, 0) as stack:
                tally.compare(governance, permissions, question, Viewpoint.OWN, stack.own(question))
    assert tally.answers[True] > len(SUBJECTS), tally.answers


RANGES = (
    DomainRange(first=0),
    DomainRange(first=0, last=0),
    DomainRange(first=1, last=5),
    DomainRange(first=5, last=0),
    DomainRange(first=5, last=1),
    DomainRange(first=0, last=231),
    DomainRange(first=0, last=MAX_DOMAIN_ID),
    231,
)


@pytest.mark.parametrize("whose", ["governance", "permissions"])
def test_a_stack_finds_a_domain_in_a_range_as_its_reading(witness, now, whose):
    tally, grant = Tally(witness.interpretation), anything_for(SUBJECT, now)
    for part in RANGES:
        domains = {"governance": EVERYWHERE, "permissions": EVERYWHERE}
        domains |= {whose: DomainSet(parts=(part,))}
        governance = Governance.protected(domains["governance"])
        rules = tuple(replace(rule, domains=domains["permissions"]) for rule in grant.rules)
        permissions = Permissions(grants=(replace(grant, rules=rules),))
        for domain in DOMAINS:
            asked = {"subject": SUBJECT, "domain": domain, "now": now}
            question = Question(action=Action.PUBLISH, topic="a", **asked)
            with witness(governance, permissions, domain) as stack:
                tally.compare(governance, permissions, question, Viewpoint.OWN, stack.own(question))
                tally.compare(
                    governance, permissions, question, Viewpoint.PEER, stack.peer(question)
                )
    assert min(tally.answers[True], tally.answers[False]) > len(DOMAINS), tally.answers


def anything_for(subject, now):
    """A grant for that subject to publish all on domain 0."""
    return Grant.least(
        subject_name=subject,
        not_before=now - DAY,
        not_after=now + DAY,
        domains=DomainSet.of(0),
        publish=["*"],
    )


def identity_of(parts, now):
    """The CA, certificate and key of a subject, in the order of the certificate."""
    key = ec.generate_private_key(ec.SECP256R1())
    ca = x509.Name([x509.NameAttribute(NAME, "CA")])
    name = x509.Name([x509.NameAttribute(*part) for part in parts])

    def certified(subject, serial):
        spki, until = key.public_key(), now + 9 * DAY
        made = x509.CertificateBuilder(ca, subject, spki, serial, now - DAY, until)
        constraints = x509.BasicConstraints(ca=subject == ca, path_length=None)
        signed = made.add_extension(constraints, critical=True).sign(key, hashes.SHA256())
        return signed.public_bytes(Encoding.PEM)

    return {
        "identity_ca.cert.pem": certified(ca, 1),
        "cert.pem": certified(name, 2),
        "key.pem": key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
    }
