"""Changes that several people must approve: what is enough, and what is refused."""

import json
import re
import subprocess
from dataclasses import replace
from datetime import timedelta
from functools import partial

import pytest

from pqsec_pki.access import Difference
from pqsec_pki.algorithms import SIGNATURES, load_public_key, pem, unpem
from pqsec_pki.approvals import (
    ApprovalPolicy,
    Covered,
    approval_in,
    approve,
    proposal_file,
    proposal_in,
)
from pqsec_pki.approvals._canonical import canonical
from pqsec_pki.approvals.approval import LABEL
from pqsec_pki.cli.approve import lines
from pqsec_pki.documents import Governance
from pqsec_pki.domain import apply as apply_domain
from pqsec_pki.domain import change_profile, import_domain, read_domain
from pqsec_pki.errors import (
    InvalidDocumentError,
    KeystoreError,
    MalformedError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import audit, policy_entry, signed_governance
from pqsec_pki.keystore.approving import policy_in
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Renewal,
    Rollover,
    apply_rollover,
    grows,
    issue,
    plan_rollover,
    renew,
    renew_list,
    revoke,
    sign_governance,
    sign_permissions,
    store_approvals,
    store_groups,
)
from tests.unit.approving import DOMAIN, GROWS, WEEK, Council, make_key, refused
from tests.unit.domains import DAY, NOW

SECOND = timedelta(seconds=1)


@pytest.fixture(scope="module")
def first_council(tmp_path_factory):
    """Made once, to be copied."""
    return Council(tmp_path_factory.mktemp("council"))


@pytest.fixture
def council(first_council, tmp_path):
    return first_council.copied(tmp_path)


@pytest.fixture
def grown(council):
    """The file gives more rights than the keystore."""
    council.change(*GROWS)
    return council


# Enough


def test_what_two_people_approved_is_done_and_the_ledger_says_who(grown):
    proposal, first = grown.proposed()
    second = grown.approval(proposal, "carol", NOW + DAY)
    assert grown.decide(proposal, first, second, now=NOW + 2 * DAY) == [
        ("sign-permissions", name) for name in ("/r1", "/r2", "/r3")
    ]
    assert grown.plan().in_order
    assert grown.allowed("/r1")[1] == ["rt/cmd", "rt/order"]
    lines = {entry.kind: entry for entry in grown.keystore.ledger()}
    assert lines["plan"].sha256 == proposal.digest
    assert lines["plan"].details["approved by"] == "alice, carol"
    named = [each.name for each in grown.keystore.ledger() if each.kind == "approval"]
    assert named == ["alice", "carol"]
    kept = approval_in(lines["approval"].details["statement"].encode())
    kept.verify(grown.keystore.approvals)
    audit(grown.keystore)


def test_the_policy_is_in_the_ledger(council):
    policy = council.keystore.approvals
    assert (policy.required, list(policy.approvers)) == (2, ["alice", "bob", "carol"])
    kinds = Covered.REVOKE, Covered.ROTATE, Covered.GROW, Covered.APPROVALS
    assert policy.covers == frozenset(kinds)
    assert policy == council.desired.approvals
    assert council.kinds()[-1] == "approvals"


@pytest.mark.parametrize("name", ["rsa-2048", "ml-dsa-65", "mldsa65-ecdsa-p256-sha512"])
def test_keys_of_any_algorithm_approve(tmp_path, name):
    found = next(row for row in SIGNATURES if name in {row.name, *row.aliases})
    key = found.generate()
    policy = ApprovalPolicy.of(1, [], {"dora": key.public_key})
    assert ApprovalPolicy.from_text(policy.text) == policy
    approve("0" * 64, "dora", key, now=NOW).verify(policy)


def test_changes_that_need_no_approvals_are_made_as_before(council):
    council.change("rt/cmd", "rt/order")  # taken and granted: needs them
    with pytest.raises(KeystoreError, match="rights that grow"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    council.change("subscribe: [rt/order]", "subscribe: []")
    council.change("validity: 90d", "validity: 90d\ngroups: {all: '/*'}")
    apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    assert council.plan().in_order
    later = NOW + 80 * DAY
    apply_domain(council.desired, council.root, passphrase=None, now=later)
    assert "plan" not in council.kinds()


def test_a_plan_of_such_changes_needs_its_proposer_only(council):
    council.change("subscribe: [rt/cmd]", "subscribe: []")
    proposal, first = council.proposed()
    assert proposal.needs == ()
    assert len(council.decide(proposal, first)) == 3


def test_governance_that_protects_less_needs_them_and_one_that_protects_more_does_not(council):
    council.change("name: Lab", "name: Lab\ngovernance: authenticated")
    assert council.steps() == [("sign-governance", "")]
    with pytest.raises(KeystoreError, match="rights that grow"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    proposal, first = council.proposed()
    [change] = proposal.rights
    assert change.names == ()
    assert any(each.startswith("weaker: ") for each in change.changes)
    given = first, council.approval(proposal, "bob")
    assert council.decide(proposal, *given) == [("sign-governance", "")]
    refused(council, proposal, *given, words="was applied already")
    council.change("authenticated", "strict")
    apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    assert council.plan().in_order


def test_new_participants_new_keys_and_another_profile_need_them(tmp_path):
    council = Council(tmp_path)
    council.change("1..3", "1..4")
    proposal, first = council.proposed()
    assert (proposal.needs, proposal.rights[0].names) == ((Covered.GROW,), ("/r4",))
    assert "granted: join on domain 0" in proposal.rights[0].changes
    council.decide(proposal, first, council.approval(proposal, "bob"))
    council.file_of("/r2", "cert.pem").unlink()
    proposal, _ = council.proposed()
    assert [step.action for step in proposal.steps] == ["replace"]
    assert proposal.needs == (Covered.GROW,)
    council.change("profile: classical", "profile: transition\nmigrate_from: classical")
    proposal, first = council.proposed()
    assert [step.action for step in proposal.steps] == ["change-profile"]
    assert proposal.needs == (Covered.ROTATE,)
    given = first, council.approval(proposal, "bob")
    begun = council.approved(proposal, *given).begin(NOW)
    change_profile(council.desired, begun.keystore, begun.plan, passphrase=None, now=NOW)
    assert council.keystore.profile.name == "transition"
    assert council.keystore.approvals == council.desired.approvals
    refused(council, proposal, *given, words="was applied already|another")


def test_with_all_every_change_needs_them(tmp_path):
    council = Council(tmp_path, DOMAIN.replace("{required", "{for: all, required"))
    assert council.keystore.approvals.covers == frozenset(Covered)
    council.change("subscribe: [rt/cmd]", "subscribe: []")
    with pytest.raises(KeystoreError, match="every change"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    cas = council.keystore.unlock(None)
    with pytest.raises(KeystoreError, match="every change"):
        renew(council.keystore, cas, ["/r1"], Renewal(), now=NOW)
    with pytest.raises(KeystoreError, match="every change"):
        renew_list(council.keystore, cas, now=NOW)
    with pytest.raises(KeystoreError, match="every change"):
        store_groups(council.keystore, {"all": ("/r1",)})
    proposal, first = council.proposed()
    assert len(council.decide(proposal, first, council.approval(proposal, "bob"))) == 3
    council.change("validity: 90d", "validity: 90d\ngroups: {all: '/*'}")
    later = NOW + 80 * DAY
    proposal, first = council.proposed(now=later)
    given = first, council.approval(proposal, "bob")
    made = council.decide(proposal, *given, now=later)
    assert {action for action, _ in made} == {"store-groups", "renew"}
    assert council.keystore.groups == {"all": ("/r1", "/r2", "/r3")}


def test_groups_alone_are_stored_once(tmp_path):
    """They leave no line in the ledger: the plan itself is the line."""
    council = Council(tmp_path, DOMAIN.replace("{required", "{for: all, required"))
    council.change("validity: 90d", "validity: 90d\ngroups: {all: '/*'}")
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    assert council.decide(proposal, *given) == [("store-groups", "")]
    refused(council, proposal, *given, words="was applied already")


# What is covered


def test_no_operation_goes_around_the_policy(council):
    keystore = council.keystore
    cas, governance = keystore.unlock(None), Governance.protected(keystore.domains)
    more = council.desired.members["/r1"].spec()
    spec = ParticipantSpec(name="/new", domains=keystore.domains, validity=DAY)
    weaker = replace(
        governance,
        domain_rules=tuple(
            replace(each, allow_unauthenticated_participants=True)
            for each in governance.domain_rules
        ),
    )
    council.change(*GROWS)
    wider = council.desired.members["/r1"].spec()
    rollover = plan_rollover(keystore, Rollover(profile=keystore.profile), now=NOW)
    ways = {
        "revocation": lambda: revoke(keystore, cas, ["/r1"], now=NOW),
        "rights that grow": lambda: issue(keystore, cas, [spec], now=NOW),
        "rights that grow ": lambda: sign_permissions(keystore, cas, [wider], now=NOW),
        "rights that grow   ": lambda: renew(keystore, cas, ["/r1"], Renewal(rekey=True), now=NOW),
        "rights that grow  ": lambda: sign_governance(keystore, cas, weaker, now=NOW),
        "the replacement of CAs": lambda: apply_rollover(keystore, rollover, now=NOW),
        "a change of `approvals`": lambda: store_approvals(keystore, cas, None, now=NOW),
    }
    before = council.kinds()
    for words, way in ways.items():
        with pytest.raises(KeystoreError, match=f"approvals are needed for {words.strip()}"):
            way()
    assert council.kinds() == before
    sign_permissions(keystore, cas, [more], now=NOW)  # the same rights
    renewed = partial(renew, keystore, cas, ["/r1"], now=NOW + DAY)
    key = council.file_of("/r1", "key.pem").read_bytes()
    renewed()  # a timer may, for the same key
    assert council.file_of("/r1", "key.pem").read_bytes() == key
    sign_governance(keystore, cas, governance, now=NOW)


def test_nothing_of_a_domain_file_is_applied_if_a_part_needs_approvals(council):
    """Rights that shrink come before the revocation, and need none."""
    council.change("subscribe: [rt/cmd]", "subscribe: []")
    council.change("1..3", "1..2")
    council.change("validity", "prune: true\nvalidity")
    before = council.kinds()
    with pytest.raises(KeystoreError, match="revocation"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    assert council.kinds() == before


def test_rights_whose_old_files_are_damaged_count_as_grown(council):
    path = council.file_of("/r1", "permissions.p7s")
    path.write_bytes(path.read_bytes().replace(b"rt/cmd", b"rt/cmx"))
    with pytest.raises(KeystoreError, match="rights that grow"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)


def test_permissions_widened_by_hand_do_not_hide_growth(council):
    """The comparison is with what was signed last, not with what somebody put there."""
    wide = council.file_of("/r2", "permissions.p7s").read_bytes().replace(b"rt/cmd", b"rt/*")
    council.file_of("/r1", "permissions.p7s").write_bytes(wide.replace(b"/r2", b"/r1"))
    council.change("subscribe: [rt/cmd]", "subscribe: ['rt/*']")
    with pytest.raises(KeystoreError, match="rights that grow"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)


def test_governance_weakened_by_hand_does_not_hide_growth(council):
    """The comparison is with what was signed last, not with what somebody put there."""
    path = council.root / "enclaves/governance.p7s"
    weak = path.read_bytes().replace(b">ENCRYPT<", b">NONE<").replace(b">SIGN<", b">NONE<")
    assert weak != path.read_bytes()
    path.write_bytes(weak)
    text = signed_governance(council.keystore)
    cas = council.keystore.unlock(None)
    with pytest.raises(KeystoreError, match="rights that grow"):
        sign_governance(council.keystore, cas, text, now=NOW)


def test_what_cannot_be_compared_wholly_counts_as_grown():
    assert grows(Difference((), complete=False))
    assert not grows(Difference((), complete=True))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("required: 2", "required: 1"),
        ("required: 2", "for: [rotate], required: 2"),
        (", carol: carol.pub.pem", ""),
        ("carol: carol.pub.pem", "carol: mallory.pub.pem"),
        (DOMAIN.splitlines()[-1], ""),
    ],
)
def test_the_policy_changes_by_its_own_rule_only(council, old, new):
    council.change(old, new)
    assert council.steps() == [("store-approvals", "")]
    with pytest.raises(KeystoreError, match="a change of `approvals`"):
        apply_domain(council.desired, council.root, passphrase=None, now=NOW)
    proposal, first = council.proposed()
    refused(council, proposal, first, words="1 of 2 approvals")
    council.decide(proposal, first, council.approval(proposal, "carol"))
    assert council.keystore.approvals == council.desired.approvals
    assert council.plan().in_order
    refused(council, proposal, first, words="was applied already")


def test_an_approver_whose_key_is_exchanged_is_named(council):
    """The names and the number are as before: the plan must say what is not."""
    council.change("carol: carol.pub.pem", "carol: mallory.pub.pem")
    proposal, _ = council.proposed()
    [step] = proposal.steps
    assert "another key of carol" in step.why
    council.change("of: {alice: alice.pub.pem", "of: {dora: alice.pub.pem")
    assert "another key of carol" in council.whys()[""]
    council.change("carol: mallory.pub.pem", "carol: carol.pub.pem")
    assert "another key" not in council.whys()[""]


def test_a_signed_head_has_the_policy(council):
    """Else its line, the last, could be cut off, and no head that was kept elsewhere shows it."""
    assert council.kinds()[-1] == "approvals"
    assert read_head(council.root).head.size == len(council.kinds())


def test_an_approver_sees_how_long_certificates_last(council):
    """New ones, and those that are renewed: `renew` needs no approvals, but a plan says it."""
    council.change("validity: 90d", "validity: 70000d")
    council.change("{1..3}", "{1..4}")
    later = NOW + 80 * DAY
    proposal, first = council.proposed(now=later)
    actions = {step.name: step.action for step in proposal.steps}
    assert actions == {"/r1": "renew", "/r2": "renew", "/r3": "renew", "/r4": "issue"}
    *_, lasting = proposal.rights
    assert sorted(lasting.names) == sorted(actions)
    assert lasting.changes == ("a certificate that is valid for 70000 days",)
    assert len(council.decide(proposal, first, council.approval(proposal, "bob"), now=later)) == 4


def test_an_approver_sees_all_names(council):
    council.change("{1..3}", "{1..60}")
    proposal, _ = council.proposed()
    shown = "\n".join(lines(proposal, council.folder / "plan.json"))
    names = {step.name for step in proposal.steps}
    assert len(names) == 57
    issued = next(line for line in shown.splitlines() if line.startswith("issue:"))
    assert names == set(re.findall(r"/r[0-9]+", issued))


def test_a_policy_that_was_there_before_can_come_back(council):
    """Its line is another one each time: else the ledger would leave it out."""
    for required in (1, 2, 1):
        text = council.file.read_text()
        council.write(re.sub("required: .", f"required: {required}", text))
        if council.plan().steps:
            proposal, first = council.proposed()
            council.decide(proposal, first, council.approval(proposal, "bob"))
        assert council.keystore.approvals.required == required


def test_who_takes_a_line_out_of_the_ledger_is_found(council):
    """The policy is a line as others: the chain, and a head that was noted, protect it."""
    head = council.keystore.head
    with council.keystore.open_ledger() as ledger:
        ledger._database.execute("DROP TRIGGER ledger_remains")
        ledger._database.execute("DELETE FROM ledger WHERE kind = 'approvals'")
        data = ledger._database.serialize()
    (council.root / "private/ledger.sqlite3").write_bytes(data)
    with pytest.raises(VerificationError, match="the head is not in the ledger"):
        audit(council.keystore, head)


# Refused


def test_one_approval_is_too_few(grown):
    proposal, first = grown.proposed()
    refused(grown, proposal, first, words="1 of 2 approvals: alice")


def test_an_approval_of_another_plan_is_refused(grown):
    other, _ = grown.proposed(now=NOW - DAY)
    proposal, first = grown.proposed()
    replayed = grown.approval(other, "bob")
    refused(grown, proposal, first, replayed, words="by bob is of another plan")
    forged = replace(replayed, proposal=proposal.digest)
    refused(grown, proposal, first, forged, words="bad ecdsa-p256 signature")


def test_a_plan_is_applied_once(grown):
    proposal, first = grown.proposed()
    given = first, grown.approval(proposal, "bob")
    new = grown.file.read_text()
    grown.decide(proposal, *given)
    refused(grown, proposal, *given, words="was applied already")
    grown.change(GROWS[1], GROWS[0])  # what takes rights away needs no approval
    apply_domain(grown.desired, grown.root, passphrase=None, now=NOW + DAY)
    grown.write(new)
    refused(grown, proposal, *given, words="was applied already", now=NOW + 2 * DAY)


def test_an_expired_plan_is_refused(grown):
    proposal, first = grown.proposed()
    second = grown.approval(proposal, "bob")
    refused(grown, proposal, first, second, words="expired on 2026-11-28", now=NOW + WEEK)
    assert grown.decide(proposal, first, second, now=NOW + WEEK - SECOND)


def test_a_renewal_for_longer_than_before_is_growth(tmp_path):
    council = Council(tmp_path, DOMAIN.replace("{required", "{for: [grow], required"))
    cas = council.keystore.unlock(None)
    renew(council.keystore, cas, ["/r1"], Renewal(validity=90 * DAY), now=NOW)
    with pytest.raises(KeystoreError, match="rights that grow"):
        renew(council.keystore, cas, ["/r1"], Renewal(validity=91 * DAY), now=NOW)
    later = NOW + 80 * DAY
    proposal, _ = council.proposed(now=later)
    assert proposal.needs == ()
    council.change("validity: 90d", "validity: 10y")
    proposal, _ = council.proposed(now=later)
    assert proposal.needs == (Covered.GROW,)
    with pytest.raises(KeystoreError, match="rights that grow"):
        apply_domain(council.desired, council.root, passphrase=None, now=later)


def test_a_plan_for_another_state_of_the_keystore_is_refused(grown):
    proposal, first = grown.proposed()
    second = grown.approval(proposal, "bob")
    renew(grown.keystore, grown.keystore.unlock(None), ["/r1"], Renewal(), now=NOW)
    refused(grown, proposal, first, second, words="the keystore was changed since")


def test_a_change_between_the_check_and_the_first_step_is_seen(grown):
    proposal, first = grown.proposed()
    found = grown.approved(proposal, first, grown.approval(proposal, "bob"))
    renew(grown.keystore, grown.keystore.unlock(None), ["/r1"], Renewal(), now=NOW)
    with pytest.raises(VerificationError, match="the keystore was changed since"):
        found.begin(NOW)


def test_a_plan_of_another_keystore_is_refused(grown, tmp_path):
    (tmp_path / "other").mkdir()
    other = Council(tmp_path / "other")
    other.change(*GROWS)
    proposal, first = other.proposed()
    refused(grown, proposal, first, words="made for other approvals")


def test_a_plan_of_another_domain_file_is_refused(grown):
    proposal, first = grown.proposed()
    second = grown.approval(proposal, "bob")
    grown.change("rt/order", "rt/orders")
    refused(grown, proposal, first, second, words="is not the file that the plan was made of")


def test_a_file_that_the_domain_file_names_must_be_the_same(tmp_path):
    """The digest of the domain file does not cover it, that of the steps does."""
    (tmp_path / "robots.csv").write_text("name,topic\n/r1,rt/cmd\n")
    text = DOMAIN.replace("[rt/cmd]", "[$topic]").replace(
        '{name: "/r{1..3}", role: robot}', "{csv: robots.csv, role: robot}"
    )
    council = Council(tmp_path, text)
    (tmp_path / "robots.csv").write_text("name,topic\n/r1,rt/order\n")
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    (tmp_path / "robots.csv").write_text("name,topic\n/r1,rt/secret\n")
    refused(council, proposal, *given, words="'sign-permissions /r1' is another step now")
    (tmp_path / "robots.csv").write_text("name,topic\n/r1,rt/order\n")
    assert council.decide(proposal, *given)


def test_a_proposer_cannot_tell_other_rights_than_there_will_be(grown):
    honest, _ = grown.proposed()
    harmless = replace(honest.rights[0], changes=("taken away: all",))
    lie = replace(honest, rights=(harmless,))
    given = [grown.approval(lie, name) for name in ("alice", "bob")]
    refused(grown, lie, *given, words="the rights that change are not those in the plan")
    lie = replace(honest, needs=())
    refused(grown, lie, grown.approval(lie, "alice"), words="the rights that change are not")


def test_a_proposer_cannot_leave_a_step_out_or_add_one(grown):
    honest, _ = grown.proposed()
    more = replace(honest.steps[0], action="issue", name="/evil")
    for steps in ((*honest.steps, more), (replace(honest.steps[0], content="0" * 64),)):
        lie = replace(honest, steps=steps)
        given = [grown.approval(lie, name) for name in ("alice", "bob")]
        refused(grown, lie, *given, words="is another step now")
    rights = (replace(honest.rights[0], names=("/r1",)),)
    fewer = replace(honest, steps=honest.steps[:1], rights=rights)
    given = [grown.approval(fewer, name) for name in ("alice", "bob")]
    assert grown.decide(fewer, *given) == [("sign-permissions", "/r1")]  # what was approved


def test_two_approvals_of_one_person_are_one(grown):
    proposal, first = grown.proposed()
    refused(grown, proposal, first, first, words="two approvals by alice")
    later = grown.approval(proposal, "alice", NOW + SECOND)
    refused(grown, proposal, first, later, words="two approvals by alice")


def test_the_proposer_cannot_approve_with_another_name(grown):
    proposal, first = grown.proposed()
    forged = grown.approval(proposal, "bob", key="alice")
    refused(grown, proposal, first, forged, words="bad ecdsa-p256 signature")


def test_a_stranger_cannot_approve(grown):
    proposal, first = grown.proposed()
    stranger = grown.approval(proposal, "mallory")
    refused(grown, proposal, first, stranger, words="mallory is not one of the approvers: alice")


def test_a_bad_approval_is_refused_even_beside_enough(grown):
    proposal, first = grown.proposed()
    forged = grown.approval(proposal, "carol", key="mallory")
    second = grown.approval(proposal, "bob")
    refused(grown, proposal, first, second, forged, words="bad ecdsa-p256 signature")


def test_a_signature_for_another_purpose_is_no_approval(grown):
    """The key may sign other things: they do not begin with the label."""
    proposal, first = grown.proposed()
    at = NOW.isoformat()
    statement = canonical({"approver": "bob", "at": at, "proposal": proposal.digest})
    key = grown.keys["bob"]
    bare = replace(first, approver="bob", signature=key.sign(statement))
    refused(grown, proposal, first, bare, words="bad ecdsa-p256 signature")
    labelled = replace(bare, signature=key.sign(LABEL + statement))
    assert grown.decide(proposal, first, labelled)


def test_what_is_signed_is_the_time_and_the_name_too(grown):
    proposal, first = grown.proposed()
    second = grown.approval(proposal, "bob")
    refused(grown, proposal, first, replace(second, at=NOW - DAY), words="bad ecdsa-p256")
    refused(grown, proposal, first, replace(second, approver="carol"), words="bad ecdsa-p256")


# The file


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    council = Council(tmp_path_factory.mktemp("written"))
    council.change(*GROWS)
    return proposal_file(*council.proposed())


def test_blanks_and_line_ends_may_change_on_the_way(written):
    value = json.loads(written)
    again = json.dumps(value, indent=4).replace("\n", "\r\n").encode()
    assert proposal_in(again)[0].digest == proposal_in(written)[0].digest


def leaves(value, path=()):
    """Each path to a value that holds no others."""
    inside = value.items() if isinstance(value, dict) else enumerate(value)
    for key, each in inside:
        if isinstance(each, dict | list):
            yield from leaves(each, (*path, key))
        else:
            yield (*path, key)


def test_no_value_of_the_file_can_be_edited(written):
    paths = [*leaves(json.loads(written))]
    assert len(paths) > 30
    for path in paths:
        value = json.loads(written)
        place = value
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = edited(place[path[-1]])
        with pytest.raises((VerificationError, MalformedError)):
            proposal_in(json.dumps(value).encode())


def edited(text):
    """The same with one digit, letter or sign more or another."""
    if isinstance(text, int):
        return not text if isinstance(text, bool) else text + 1
    if re.fullmatch("[0-9a-f]{64}", text):
        return f"{text[:-1]}{int(text[-1], 16) ^ 1:x}"
    return text.replace("2026", "2027") if text.startswith("2026") else f"{text}x"


def test_the_proposer_must_have_signed_it(written):
    value = json.loads(written)
    value["proposal"]["proposer"] = "bob"
    with pytest.raises(VerificationError, match="alice signed the plan of bob"):
        proposal_in(json.dumps(value).encode())


HOSTILE = {
    "nothing": b"",
    "no UTF-8": b"\xff{}",
    "a list": b"[]",
    "null": b"null",
    "deep": b"[" * 1_000_000,
    "deep objects": b'{"approval":' * 200_000,
    "a long number": b'{"proposal": ' + b"9" * 100_000 + b', "approval": 1}',
    "a surrogate": rb'{"proposal": "\ud800", "approval": {"approver": "\ud800"}}',
    "NaN": b'{"proposal": NaN, "approval": Infinity}',
    "two documents": b"{} {}",
}


@pytest.mark.parametrize("data", HOSTILE.values(), ids=HOSTILE)
def test_what_is_no_plan_is_refused(data):
    for reader in (proposal_in, approval_in):
        with pytest.raises(MalformedError):
            reader(data)


def test_a_name_twice_in_an_object_is_refused(written):
    twice = written.replace(b'"proposer"', b'"proposer": "bob", "proposer"')
    with pytest.raises(MalformedError, match="appears twice"):
        proposal_in(twice)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"format": 1', b'"format": 2'),
        (b'"format": 1', b'"format": 1.0'),
        (b'"format": 1', b'"format": true'),
        (b'"prune": false', b'"prune": 0'),
        (b'"prune": false', b'"prune": false, "more": 1'),
        (b'"required": 2', b'"required": 4'),
        (b'"required": 2', b'"required": 0'),
        (b'"required": 2', b'"required": "2"'),
        (b'"bob": "M', b'"alice ": "M'),
        (b'"proposer": "alice"', b'"proposer": "\\u001b[2J"'),
        (b"+00:00", b"+01:00"),
        (b"+00:00", b""),
        (b'"steps": [', b'"steps": [3,'),
        (b'"grow",', b'"grow", "sing",'),
    ],
)
def test_a_value_of_another_kind_is_refused(written, old, new):
    assert old in written
    with pytest.raises(MalformedError):
        proposal_in(written.replace(old, new, 1))


def test_an_unknown_step_is_refused(grown):
    honest, _ = grown.proposed()
    lie = replace(honest, steps=(replace(honest.steps[0], action="sing"),))
    given = [grown.approval(lie, name) for name in ("alice", "bob")]
    refused(grown, lie, *given, words="is another step now")


# The policy

X25519 = bytes.fromhex("302a300506032b656e032100") + b"\x09" + bytes(31)


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    for name in ("alice", "bob"):
        make_key(folder, name)
    (folder / "x25519.pem").write_bytes(pem("PUBLIC KEY", X25519))
    (folder / "two.pem").write_bytes(2 * (folder / "bob.pub.pem").read_bytes())
    return folder


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            "{required: 2, of: {alice: alice.pub.pem}}",
            "2 approvals of 1 approvers are not possible",
        ),
        ("{required: 0, of: {alice: alice.pub.pem}}", "0 approvals of 1"),
        ("{required: 1, of: {}}", "there must be 1 to 100 approvers"),
        (
            "{required: 2, of: {alice: alice.pub.pem, bob: alice.pub.pem}}",
            "bob have the same key",
        ),
        ("{required: 2, of: {bob: alice.pub.pem, Bob: bob.pub.pem}}", "Bob have the same name"),
        ("{required: 1, of: {../bob: bob.pub.pem}}", "cannot be an approver's name"),
        (
            "{required: 1, of: {bob: bob.pem}}",
            "a private key, where the public one belongs; `openssl",
        ),
        ("{required: 1, of: {bob: two.pem}}", "it must be one PEM block, PUBLIC KEY"),
        ("{required: 1, of: {bob: x25519.pem}}", "keys of algorithm 1.3.101.110 are not known"),
        ("{required: 1, of: {bob: none.pem}}", "none.pem"),
        ("{required: 1, of: {bob: bob.pub.pem}, for: sing}", "'sing' is not allowed"),
        ("{required: 1}", "of"),
        ("{of: {bob: bob.pub.pem}}", "required"),
        ("[alice, bob]", "expected `key: value`"),
    ],
)
def test_a_policy_that_would_not_need_these_people_is_refused(keys, given, words):
    (keys / "domain.yaml").write_text(f"participants: []\napprovals: {given}\n")
    with pytest.raises(InvalidDocumentError) as error:
        read_domain(keys / "domain.yaml")
    found = str(error.value)
    assert words in found
    assert "line 2" in found
    assert "PRIVATE" not in found


def test_a_key_may_stand_in_the_file(keys, tmp_path):
    text = (keys / "alice.pub.pem").read_text().replace("\n", "\n      ")
    file = tmp_path / "domain.yaml"
    file.write_text(f"approvals:\n  required: 1\n  of:\n    alice: |\n      {text}\n")
    assert read_domain(file).approvals.name_of(load(keys / "alice.pub.pem")) == "alice"


def load(path):
    return load_public_key(unpem(path.read_bytes(), "key")[0][1])


def test_one_key_in_two_encodings_is_one(keys):
    """A point can be compressed, which makes another SubjectPublicKeyInfo of the same key."""
    key = load(keys / "alice.pub.pem")
    form = "openssl pkey -pubin -in alice.pub.pem -ec_conv_form compressed -outform DER"
    done = subprocess.run(form.split(), cwd=keys, check=True, capture_output=True)
    other = load_public_key(done.stdout)
    assert other.spki != key.spki
    with pytest.raises(UsageError, match="have the same key"):
        ApprovalPolicy.of(2, [], {"alice": key, "bob": other})


@pytest.mark.parametrize("details", [{}, {"statement": "{"}, {"statement": '{"required": 0}'}])
def test_a_damaged_policy_in_the_ledger_opens_nothing(details):
    entry = policy_entry(None, "0" * 64, NOW)
    assert policy_in(entry) is None
    with pytest.raises(KeystoreError, match="the ledger's line on approvals is damaged"):
        policy_in(replace(entry, details=details))


@pytest.mark.parametrize("kinds", ["", "for: all, ", "for: [rotate], "])
def test_a_domain_file_made_of_the_keystore_demands_the_same(tmp_path, kinds):
    council = Council(tmp_path, DOMAIN.replace("{required", f"{{{kinds}required"))
    made = import_domain([council.root], now=NOW, domains=council.keystore.domains)
    council.file.write_bytes(made.document)
    assert council.desired.approvals == council.keystore.approvals
    assert council.plan().in_order


def test_two_keystores_with_different_rules_make_no_domain_file(tmp_path):
    councils = [Council(tmp_path / "one"), Council(tmp_path / "two", DOMAIN.replace("/r{", "/s{"))]
    roots = [each.root for each in councils]
    with pytest.raises(UsageError, match="the keystores demand different approvals"):
        import_domain(roots, now=NOW, domains=councils[0].keystore.domains)
