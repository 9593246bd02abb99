"""Import: the file says exactly what the sources say, and then there is nothing to plan."""

import tempfile
from dataclasses import replace
from datetime import timedelta
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Reason
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Grant,
    PermissionRule,
    preset_named,
)
from pqsec_pki.domain import apply, import_domain, plan, read_domain
from pqsec_pki.domain._listing import names_of
from pqsec_pki.domain._name_patterns import patterns_of
from pqsec_pki.domain._shared_rules import FoundParticipant
from pqsec_pki.domain._sources import ImportSource
from pqsec_pki.domain.importing import imported
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    changed_permissions,
    issue,
    revoke,
    sign_changed,
    sign_governance,
)
from tests.longer import LONG, examples
from tests.property.test_documents import GOVERNANCES, RULES
from tests.unit.domains import DAY, NOW

ZERO = DomainSet.of(0)
PARTS = st.sampled_from(
    ["fleet", "r1", "r2", "r3", "r01", "r02", "r09", "r10", "arm-1", "arm_2", "0", "rt", "x9y9"]
)
NAMES = st.lists(PARTS, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
MENTIONS = st.sampled_from(
    ["rt{name}/pose", "{base}", "rt/{base}_x", "rt{parent}/map", "$", "$$name", "{name}", "rt/cmd"]
)


@settings(max_examples=examples(200), deadline=None)
@given(st.sets(NAMES, max_size=30))
def test_patterns_give_exactly_the_names(names):
    patterns = patterns_of(names)
    given_names = [each.name for pattern in patterns for each in names_of(pattern, 1)]
    assert sorted(given_names) == sorted(names)
    assert patterns_of(sorted(names, reverse=True)) == patterns


def mentioning(name, topics):
    parent, _, base = name.rpartition("/")
    return tuple(topic.format(name=name, base=base, parent=parent) for topic in topics)


def speaking_of_itself(participant, topics):
    if not topics:
        return participant
    criteria = Criteria(topics=mentioning(participant.name, topics))
    rule = PermissionRule(allow=True, domains=ZERO, publish=(criteria,))
    return replace(participant, rules=(rule, *participant.rules))


PARTICIPANTS = st.lists(
    st.builds(
        speaking_of_itself,
        st.builds(
            FoundParticipant,
            name=NAMES,
            rules=st.lists(RULES, min_size=1, max_size=2).map(tuple),
            default=st.sampled_from(DefaultAction),
            validity=st.sampled_from([timedelta(hours=5), 90 * DAY, 365 * DAY]),
            source=st.just("k"),
            key_elsewhere=st.booleans(),
        ),
        st.lists(MENTIONS, max_size=3),
    ),
    unique_by=lambda each: each.name,
    max_size=6,
)


@pytest.mark.slow
@settings(max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(PARTICIPANTS, st.none() | GOVERNANCES)
def test_the_file_gives_each_participant_the_rules_it_had(participants, governance):
    found = imported([ImportSource(Path("k"), participants, governance=governance)])
    assert sorted(found.participants) == sorted(each.name for each in participants)
    other_order = imported([ImportSource(Path("k"), participants[::-1], governance=governance)])
    assert other_order.document == found.document
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "domain.yaml")
        file.write_bytes(found.document)
        desired = read_domain(file)
    assert desired.members.keys() == {each.name for each in participants}
    assert governance in {None, desired.governance}
    for each in participants:
        member = desired.members[each.name]
        [grant] = member.spec().grants
        assert (grant.rules, grant.default, member.validity) == (
            *(each.rules, each.default),
            each.validity,
        )


# Keystores

FEW = ["/fleet/r1", "/fleet/r2", "/fleet/r3", "/arm", "/watch"]
DOMAIN_FILE = """
name: Lab
profile: classical
validity: 30d
governance: {governance}
roles:
  robot: {{publish: [rt$name/pose], nodes: [{{node: $name, clients: ~/y}}], domains: 0-3}}
  other: {{subscribe: [$what, b$$c], default: ALLOW}}
participants:
  - {{name: {robots}, role: robot}}
  - {{name: /watch, role: other, values: {{what: "rt/*"}}}}
groups: {{robots: {robots}, all: "/**", one: /watch}}
"""
HOWS = st.fixed_dictionaries(
    {name: st.sampled_from(["plain", "policy", "none"]) for name in FEW[:4]}
)


def issued(keystore, how, rules):
    """The participants of `how`, with options or with a policy."""
    until = NOW + 400 * DAY
    specs = []
    for name, kind in how.items():
        grant = Grant(
            name="any name", subject_name="CN=x", not_before=NOW, not_after=until, rules=rules
        )
        topics = mentioning(name, ("rt{name}/pose", "rt/$x"))
        if kind == "plain":
            topics = {"publish": topics, "subscribe": ("rt/cmd",)}
            specs.append(ParticipantSpec(name=name, domains=ZERO, validity=90 * DAY, **topics))
        elif kind == "policy":
            specs.append(
                ParticipantSpec(name=name, domains=ZERO, validity=7 * DAY, grants=(grant,))
            )
    issue(keystore, keystore.unlock(None), specs, now=NOW)


def permitted(keystore, names):
    """One more rule for each."""
    more = PermissionRule(allow=True, domains=ZERO, relay=(Criteria(topics=("new",)),))

    def edit(_, grant):
        return replace(grant, rules=(*grant.rules, more))

    changes = changed_permissions(keystore, names, edit, now=NOW)
    sign_changed(keystore, keystore.unlock(None), changes, now=NOW)


def text_of(root):
    return import_domain([root], now=NOW, domains=ZERO).document


@pytest.mark.slow
@settings(
    max_examples=60 if LONG else 6, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
@given(
    HOWS,
    st.lists(RULES, min_size=1, max_size=2).map(tuple),
    st.sampled_from(["strict", "migration", "{domains: 0-3, topics: [a, b]}"]),
    st.sets(st.sampled_from(FEW)),
    st.sets(st.sampled_from(FEW)),
)
def test_a_plan_of_what_was_imported_has_no_change(how, rules, governance, permits, revoked):
    with tempfile.TemporaryDirectory() as folder:
        root, file = Path(folder, "k"), Path(folder, "domain.yaml")
        robots = [name for name, kind in how.items() if kind == "none"] or ["/other"]
        file.write_text(DOMAIN_FILE.format(governance=governance, robots=robots))
        apply(read_domain(file), root, passphrase=None, now=NOW)
        keystore = Keystore.open(root, to_change=True)
        issued(keystore, how, rules)
        there = set(keystore.names())
        if chosen := sorted(permits & there):
            permitted(keystore, chosen)
        if chosen := sorted(revoked & there):
            at = (keystore, keystore.unlock(None))
            revoke(*at, chosen, reason=Reason.SUPERSEDED, now=NOW)

        text = text_of(root)
        file.write_bytes(text)
        found = plan(read_domain(file), keystore, now=NOW)
        assert found.in_order, found
        assert found.unchanged == len(there - revoked)
        assert text_of(root) == text
        copy = Path(folder, "copy")  # applied elsewhere, it says the same again
        apply(read_domain(file), copy, passphrase=None, now=NOW)
        assert text_of(copy).partition(b"\n")[2] == text.partition(b"\n")[2]


@pytest.mark.parametrize(
    "foreign", [DomainRange(first=0), DomainRange(first=0, last=231), DomainRange(first=9, last=0)]
)
def test_domains_that_stacks_read_differently_are_no_default_of_a_keystore(tmp_path, foreign):
    domains = DomainSet(parts=(foreign,))
    create = partial(
        *(Keystore.create, tmp_path / "k", profile_named("classical")),
        name="Lab",
        validity=4000 * DAY,
        passphrase=None,
        now=NOW,
    )
    with pytest.raises(UsageError):
        create(domains=domains)
    assert not (tmp_path / "k").exists()
    keystore = create(domains=ZERO)
    issued(keystore, {"/arm": "policy"}, (PermissionRule(allow=False, domains=domains),))
    text = text_of(keystore.root)
    (tmp_path / "domain.yaml").write_bytes(text)
    apply(read_domain(tmp_path / "domain.yaml"), tmp_path / "copy", passphrase=None, now=NOW)
    assert text_of(tmp_path / "copy").partition(b"\n")[2] == text.partition(b"\n")[2]


def test_a_governance_signed_by_hand_is_imported(tmp_path):
    keystore = Keystore.create(
        *(tmp_path / "k", profile_named("classical")),
        name="Lab",
        domains=ZERO,
        validity=4000 * DAY,
        passphrase=None,
        now=NOW,
    )
    governance = preset_named("authenticated").governance(DomainSet.parse("7,9"))
    sign_governance(keystore, keystore.unlock(None), governance, now=NOW)
    text = text_of(keystore.root)
    (tmp_path / "domain.yaml").write_bytes(text)
    assert plan(read_domain(tmp_path / "domain.yaml"), keystore, now=NOW).in_order
    assert b"governance: authenticated" in text
    assert b"ca_validity: 4000d" in text
