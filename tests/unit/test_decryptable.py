"""What a quantum computer decrypts later, because stock participants get its keys by ECDH."""

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import product

import pytest

from pqsec_pki.access import Action, Question, decide, decryptable_later, topics_named
from pqsec_pki.access.matrix import DocumentOwner
from pqsec_pki.documents import (
    DomainSet,
    Governance,
    Grant,
    Permissions,
    ProtectionKind,
    TopicRule,
)
from tests.interop.policies import TOPICS, Maker

NOW = datetime(2026, 6, 1, tzinfo=UTC)
END = datetime(2027, 6, 1, tzinfo=UTC)
NONE, SIGN, ENCRYPT = ProtectionKind.NONE, ProtectionKind.SIGN, ProtectionKind.ENCRYPT
ORIGIN = ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION


def topic(expression="*", *, data=ENCRYPT, metadata=ENCRYPT, control=True):
    return TopicRule(
        topic_expression=expression,
        enable_discovery_protection=True,
        enable_liveliness_protection=True,
        enable_read_access_control=control,
        enable_write_access_control=control,
        metadata_protection_kind=metadata,
        data_protection_kind=data,
    )


def governance(*topics, rtps=SIGN, domains="0"):
    [rule] = Governance.protected(DomainSet.parse(domains)).domain_rules
    topics = topics or (topic(),)
    return Governance(domain_rules=(replace(rule, rtps_protection_kind=rtps, topic_rules=topics),))


def member(name, publish=(), subscribe=(), domains="0"):
    grant = Grant.least(
        subject_name=f"CN={name}",
        not_before=NOW,
        not_after=END,
        domains=DomainSet.parse(domains),
        publish=publish,
        subscribe=subscribe,
    )
    return DocumentOwner(name=name, subject=f"CN={name}", permissions=Permissions(grants=(grant,)))


CAMERA = member("/camera", publish=["image", "status"])
VIEWER = member("/viewer", subscribe=["image"])
OLD = member("/old", subscribe=["status"])
FLEET = [CAMERA, VIEWER, OLD]


def found(*stock, members=FLEET, rules=None, now=NOW):
    """(sender, topic) -> by which stock participants; none if it is stock itself."""
    answer = decryptable_later(rules or governance(), members, stock, now=now)
    assert answer.complete
    return {
        (sender, name): each.stock
        for each in answer.rows
        for sender in each.senders
        for name in each.topics
    }


def test_nothing_is_decrypted_later_if_nobody_is_stock():
    assert found() == {}
    assert found("/nobody") == {}


def test_a_stock_reader_opens_its_topic_and_no_other():
    assert found("/old") == {("/camera", "status"): ("/old",)}
    assert found("/viewer") == {("/camera", "image"): ("/viewer",)}


def test_one_stock_reader_opens_the_topic_for_all_its_readers():
    both = [*FLEET, member("/new", subscribe=["status"])]
    [row] = decryptable_later(governance(), both, ["/old"], now=NOW).rows
    assert (row.senders, row.receivers, row.stock) == (("/camera",), ("/old", "/new"), ("/old",))
    assert row.to_json() == {
        "from": ["/camera"],
        "to": ["/old", "/new"],
        "stock": ["/old"],
        "domains": "0",
        "partitions": "",
        "topics": ["status"],
    }


def test_a_stock_writer_opens_all_that_it_sends():
    assert found("/camera") == {
        ("/camera", "image"): (),
        ("/camera", "status"): (),
    }


@pytest.mark.parametrize("rtps", [SIGN, ENCRYPT])
@pytest.mark.parametrize("stock", ["/loop", "/old"])
def test_what_has_no_reader_but_its_writer_is_sent_to_nobody(rtps, stock):
    members = [*FLEET, member("/loop", publish=["x"], subscribe=["x"])]
    rules = governance(topic(data=NONE), rtps=rtps)
    assert ("/loop", "x") not in found(stock, members=members, rules=rules)


def test_stock_and_other_senders_of_one_topic_are_told_apart():
    members = [member(name, publish=["x"], subscribe=["x"]) for name in ("/new", "/other", "/old")]
    rows = decryptable_later(governance(), members, ["/old"], now=NOW).rows
    names = ("/new", "/other", "/old")
    assert [(each.senders, each.receivers, each.stock) for each in rows] == [
        (("/new", "/other"), names, ("/old",)),
        (("/old",), names, ()),
    ]


def test_a_large_fleet_has_one_row_for_all_that_are_alike():
    names = [f"/robot{number}" for number in range(600)]
    members = [member(name, publish=["x"], subscribe=["x"]) for name in names]
    rows = decryptable_later(governance(), members, names[:1], now=NOW).rows
    assert [(len(each.senders), len(each.receivers)) for each in rows] == [(1, 600), (599, 600)]


@pytest.mark.parametrize("data", [NONE, SIGN, ENCRYPT])
@pytest.mark.parametrize("metadata", [NONE, SIGN, ENCRYPT, ORIGIN])
def test_what_can_be_read_today_is_not_decrypted_later(data, metadata):
    rules = governance(topic(data=data, metadata=metadata))
    is_encrypted = data.encrypts or metadata.encrypts
    assert bool(found("/old", rules=rules)) is is_encrypted


@pytest.mark.parametrize("rtps", [ENCRYPT, ORIGIN])
def test_encrypted_messages_alone_are_opened_by_any_stock_participant_of_the_domain(rtps):
    rules = governance(topic(data=NONE, metadata=SIGN), rtps=rtps)
    assert found("/old", rules=rules) == {
        ("/camera", "image"): ("/old",),
        ("/camera", "status"): ("/old",),
    }


def test_encrypted_topics_in_encrypted_messages_need_a_stock_reader():
    assert found("/old", rules=governance(rtps=ENCRYPT)) == {("/camera", "status"): ("/old",)}


def test_a_stock_participant_on_another_domain_gets_no_key():
    elsewhere = [CAMERA, VIEWER, member("/old", subscribe=["status"], domains="7")]
    rules = governance(topic(data=NONE, metadata=NONE), rtps=ENCRYPT, domains="0-9")
    assert found("/old", members=elsewhere, rules=rules) == {}


def test_domains_are_told_together_and_apart():
    one, other = (
        governance(rtps=rtps, domains=domains).domain_rules[0]
        for rtps, domains in ((SIGN, "0-4"), (ENCRYPT, "5-9"))
    )
    every = Governance(domain_rules=(one, other))
    members = [
        member("/camera", publish=["image"], domains="0-9"),
        member("/old", subscribe=["image"], domains="3-6"),
    ]
    [row] = decryptable_later(every, members, ["/old"], now=NOW).rows
    assert str(row.domains) == "3-6"


def test_a_pattern_is_told_as_far_as_a_stock_reader_may():
    members = [
        member("/camera", publish=["rt/*"]),
        member("/viewer", subscribe=["*"]),
        member("/old", subscribe=["rt/a*"]),
        member("/other", publish=["somewhere/else/*"]),
    ]
    assert found("/old", members=members) == {("/camera", "rt/a*"): ("/old",)}


def test_a_pattern_is_told_as_far_as_the_governance_encrypts():
    rules = governance(topic("rt/secret*"), topic(data=NONE, metadata=NONE))
    members = [member("/camera", publish=["rt/*"]), member("/old", subscribe=["rt/*"])]
    assert found("/old", members=members, rules=rules) == {("/camera", "rt/secret*"): ("/old",)}


def test_the_first_rule_of_the_governance_that_covers_a_topic_decides():
    rules = governance(topic("image", data=NONE, metadata=NONE), topic())
    assert found("/viewer", rules=rules) == {}


def test_a_topic_that_is_open_to_all_is_open_to_stock_readers_of_another():
    rules = governance(topic("image", control=False), topic())
    assert found("/old", rules=rules)["/camera", "image"] == ("/old",)


def test_rights_that_have_ended_open_nothing():
    assert found("/old", now=datetime(2030, 1, 1, tzinfo=UTC)) == {}


@pytest.mark.parametrize("seed", range(40))
def test_it_is_what_the_engine_decides_one_by_one(seed):
    maker, now = Maker(seed), datetime.now(UTC)
    rules, names = maker.governance(), ("/a", "/b", "/c")
    members = [
        DocumentOwner(name=name, subject=f"CN={name}", permissions=maker.permissions(f"CN={name}"))
        for name in names
    ]
    stock = names[seed % 3 :][:1]
    known = {
        *topics_named(members),
        *(t.topic_expression for r in rules.domain_rules for t in r.topic_rules),
    }
    answer = decryptable_later(rules, members, stock, now=now)
    told = {
        (sender, name)
        for each in answer.rows
        for sender in each.senders
        for name in each.topics
        if 0 in each.domains and not each.where
    }
    plain = [each for each in TOPICS if each in known and not set(each) & set("*[?")]
    for name, sender in product(plain, members):
        decided = partial(engine, rules, now)
        assert ((sender.name, name) in told) is opened(decided, members, sender, name, stock)


def engine(rules, now, who, action, topic=None):
    question = Question(subject=who.subject, domain=0, action=action, topic=topic, now=now)
    return decide(rules, who.permissions, question)


def opened(decision, members, sender, name, stock):
    """By one question for each participant."""
    sending = decision(sender, Action.PUBLISH, name)
    if not sending.allowed:
        return False
    others = [each for each in members if each is not sender]
    readers = [each.name for each in others if decision(each, Action.SUBSCRIBE, name).allowed]
    joined = [each.name for each in others if decision(each, Action.JOIN).allowed]
    kinds = sending.protection
    layers = [readers] if kinds.data.encrypts or kinds.metadata.encrypts else []
    layers += [joined] if kinds.rtps.encrypts else []

    def known(getters):
        return bool(getters) and (sender.name in stock or bool({*getters} & {*stock}))

    return bool(readers) and bool(layers) and all(map(known, layers))
