"""The rules about the size of handshakes: what they reckon is what is sent."""

from dataclasses import replace

import pytest

from pqsec_pki.algorithms import PROFILES, STOCK_AGREEMENT
from pqsec_pki.documents import Criteria, Permissions
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint.enclaves.size import MANY, reply_size
from pqsec_pki.selfcheck import verify_handshake
from pqsec_pki.stacks import DATAGRAM, FAST_DDS_LIMIT, FRAGMENT, Stack
from tests.unit.keystores import NOW
from tests.unit.linting import TALKER, Lab

DER_SLACK = 8
"""Bytes that an ECDSA signature may be shorter than the longest, and padding."""


@pytest.mark.parametrize("profile", PROFILES, ids=lambda profile: profile.name)
def test_the_reckoned_size_is_what_is_sent(tmp_path, profile):
    keystore = Keystore.open(Lab(tmp_path, profile.name).root)
    report = verify_handshake(keystore, "/listener", "/talker", domain=0, now=NOW)
    [sent] = [each for each in report.sent if each.name == "reply"]
    reckoned = {size(keystore, name) for name in ("/listener", "/talker")}
    assert any(0 <= each - len(sent.data) <= DER_SLACK for each in reckoned)


def size(keystore, name):
    who, agreement = keystore.participant(name), keystore.profile.key_agreement
    key = who.certificate.handshake_keys[0]
    return reply_size(who.certificate, who.permissions, key.algorithm, agreement)


def with_topics(lab, number):
    """/talker may also publish that many topics, each of 30 characters."""
    [grant] = Permissions.from_xml((lab / TALKER / "permissions.xml").read_bytes()).grants
    [rule] = grant.rules
    topics = tuple(f"rt/{each:027}" for each in range(number))
    wide = replace(rule, publish=(*rule.publish, Criteria(topics=topics)))
    lab.sign_permissions(Permissions(grants=(replace(grant, rules=(wide,)),)))


@pytest.mark.parametrize(
    ("profile", "topics", "targets", "rules"),
    [
        ("classical", 0, [Stack.FASTDDS], set()),
        ("classical", 120, [], set()),
        ("classical", 120, [Stack.CYCLONEDDS], set()),
        ("classical", 120, [Stack.FASTDDS], {"PQS501"}),
        ("transition", 0, [Stack.FASTDDS], {"PQS501"}),
        ("transition", 0, [Stack.OPENDDS], set()),
        ("classical", 1200, [], {"PQS503"}),
        ("classical", 1500, [], {"PQS502", "PQS503"}),
        ("classical", 1500, [Stack.CYCLONEDDS], {"PQS503"}),
        ("cnsa2", 0, [], set()),
        ("classical", 6000, [], {"PQS502", "PQS503", "PQS504"}),
    ],
)
def test_sizes(tmp_path, profile, topics, targets, rules):
    lab = Lab(tmp_path, profile)
    if topics:
        with_topics(lab, topics)
    assert {rule for rule in lab.found(*targets) if rule.startswith("PQS5")} == rules


def test_a_limit_is_told_with_what_it_is_made_of(tmp_path):
    lab = Lab(tmp_path)
    finding = lab.found(Stack.FASTDDS)["PQS501"]
    certificate, permissions = (
        (lab / TALKER / name).read_bytes() for name in ("cert.pem", "permissions.p7s")
    )
    assert str(len(certificate)) in finding.message
    assert finding.path.name in {"talker", "listener"}
    assert len(certificate) + len(permissions) < 2 * FAST_DDS_LIMIT.size


def test_the_limits_stand_in_their_order():
    assert FAST_DDS_LIMIT.size < MANY * FRAGMENT < DATAGRAM


def test_stock_stacks_are_reckoned_with_their_own_suite(tmp_path):
    keystore = Keystore.open(Lab(tmp_path).root)
    who = keystore.participant("/talker")
    row = who.certificate.public_key.algorithm
    stock = reply_size(who.certificate, who.permissions, row, STOCK_AGREEMENT)
    assert stock < size(keystore, "/talker")
