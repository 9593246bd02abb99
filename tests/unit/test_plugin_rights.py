"""What permissions say of a topic before it is known in which partition its endpoints will be."""

import pytest

from pqsec_pki.access import Action, Question, decide
from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import (
    Criteria,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
)
from pqsec_pki.errors import VerificationError
from pqsec_pki.plugin.credentials import Properties
from pqsec_pki.plugin.rights import anywhere, end_of
from pqsec_pki.plugin.trust import ParticipantTrust
from pqsec_pki.problems import Code
from pqsec_pki.smime import Signer, sign
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import properties

DOMAINS = DomainSet.parse("0")
GOVERNANCE = Governance.protected(DOMAINS)
ALL = Criteria(topics=("*",))
THERE = Criteria(topics=("chatter",), partitions=("there",))
TAGGED = Criteria(topics=("chatter",), data_tags=(("kind", "secret"),))
PLAIN = Criteria(topics=("chatter",))


def rule(criteria, *, allow):
    return PermissionRule(allow=allow, domains=DOMAINS, publish=(criteria,))


@pytest.mark.parametrize(
    ("rules", "may"),
    [
        ([rule(THERE, allow=True)], True),
        ([rule(TAGGED, allow=True)], True),
        ([rule(THERE, allow=False), rule(ALL, allow=True)], True),
        ([rule(TAGGED, allow=False), rule(ALL, allow=True)], True),
        ([rule(PLAIN, allow=False), rule(ALL, allow=True)], False),
        ([rule(PLAIN, allow=False), rule(THERE, allow=True)], False),
    ],
)
def test_a_topic_is_denied_if_it_is_denied_everywhere(rules, may):
    grant = Grant(
        name="g",
        subject_name="CN=robot",
        not_before=NOW - DAY,
        not_after=NOW + DAY,
        rules=tuple(rules),
    )
    question = Question(
        subject="CN=robot", domain=0, action=Action.PUBLISH, now=NOW, topic="chatter"
    )
    decision = decide(GOVERNANCE, anywhere(Permissions(grants=(grant,))), question)
    assert decision.allowed is may


@pytest.mark.parametrize(("days", "end"), [(9, 9), (11, 10)])
def test_permissions_end_with_who_signed_them(days, end):
    authorities = [
        Authority.create(name, SIGNATURES.named("ml-dsa-44"), now=NOW, validity=each * DAY)
        for name, each in (("CA", 20), ("Second", days))
    ]
    ca, second = (each.certificate for each in authorities)
    anchors = TrustAnchors(identity_cas=(ca,), permissions_ca=ca, countersigner=second)
    grant = Grant(
        name="g",
        subject_name="CN=robot",
        not_before=NOW - DAY,
        not_after=NOW + 10 * DAY,
        rules=(rule(ALL, allow=True),),
    )
    assert end_of(grant, anchors) == (NOW + end * DAY).timestamp() + 1


@pytest.mark.parametrize("kind", ["ecdsa-p256", "mldsa65+p256"])
def test_every_signature_that_is_pinned_must_be_there(tmp_path, kind):
    """C25: the file beside the CA's pins a countersigner, whatever signs first."""
    ca = Authority.create("CA", SIGNATURES.named(kind), now=NOW, validity=DAY)
    second = Authority.create("Second", SIGNATURES.named("ml-dsa-65"), now=NOW, validity=DAY)
    folder = made(tmp_path / "k", "classical").root / "enclaves/talker"
    (folder / "permissions_ca.cert.pem").unlink()
    (folder / "permissions_ca.cert.pem").write_bytes(ca.certificate.pem)

    def accepted(message):
        anchors = ParticipantTrust.of(Properties(*properties(folder)), NOW).anchors
        return anchors.governance(message, NOW)

    main, counter = (Signer(each.certificate, each.key) for each in (ca, second))
    document = GOVERNANCE.to_xml()
    once = sign(document, main, now=NOW)
    assert accepted(once)
    (folder / "permissions_ca.alt.cert.pem").write_bytes(second.certificate.pem)
    assert accepted(sign(document, main, countersigner=counter, now=NOW))
    with pytest.raises(VerificationError) as refusal:
        accepted(once)
    assert [each.code for each in refusal.value.problems] == [Code.SIGNATURE_MISSING]
