"""Domain files with several profiles, and keystores with several sets of credentials."""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import certificate_request
from pqsec_pki.domain import PlanReview, apply, apply_plan, import_domain, read_domain
from pqsec_pki.enrolment import request
from pqsec_pki.errors import (
    InvalidDocumentError,
    KeystoreError,
    PassphraseError,
)
from pqsec_pki.keystore import (
    Keystore,
    SigningCa,
    audit,
    change,
    document_entry,
    load_certificate,
    stage_governance,
)
from pqsec_pki.lifecycle import (
    OverlapStep,
    Rollover,
    Scope,
    add_set,
    apply_rollover,
    plan_rollover,
    renew_list,
)
from tests.unit.approving import DOMAIN, GROWS, Council, refused
from tests.unit.domains import DAY, NAMES, NOW, Scene
from tests.unit.killing import copies
from tests.unit.test_domain_orders import BOTH, OrderedLine
from tests.unit.test_registration import ordered
from tests.unit.test_sets import ABOUT_THE_LEDGER, files_of, one_meaning_but_numbers

FILE = """
name: Lab
profile: classical
validity: 90d
renew_before: 30d
roles:
  robot: {publish: [rt$name/pose], subscribe: [rt/cmd]}
  monitor: {subscribe: ["rt/*"]}
participants:
  - {name: "/r{1..3}", role: robot}
  - {name: /monitor, role: monitor}
"""
ONE, TWO = "profile: classical", "profile: [classical, hybrid]"
THREE = "profile: [classical, hybrid, pq]"
ADDED = [("add-set", "hybrid")]


@pytest.fixture
def scene(tmp_path):
    """A classical keystore as its file describes it."""
    made = Scene(tmp_path, FILE)
    made.apply()
    return made


@pytest.fixture
def both(tmp_path):
    """A keystore with two sets, as its file describes it."""
    made = Scene(tmp_path, FILE.replace(ONE, TWO))
    made.apply()
    return made


def names(keystore):
    return [each.profile.name for each in keystore.sets]


# The list of profiles


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("[]", "line 1: profile: the list is empty"),
        ("[classical, classical]", "line 1: profile: classical is given twice"),
        ("[classical, hybrid, pq, hybrid]", "line 1: profile: hybrid is given twice"),
        (f"[{', '.join(['classical', 'hybrid'] * 10)}]", "classical is given twice"),
        (f"[{', '.join(f'p{number}' for number in range(20))}]", "'p0' is not allowed"),
        ("[classical, hybird]", "line 1: profile: 'hybird' is not allowed; did you mean hybrid?"),
        ("[classical, Hybrid]", "'Hybrid' is not allowed"),
        ("[classical, '']", "'' is not allowed"),
        ("[classical, ../pq]", "'../pq' is not allowed"),
        ("[classical, [hybrid]]", "is not allowed"),
        ("[classical, {hybrid: pq}]", "is not allowed"),
        ("{classical: hybrid}", "is not allowed"),
        ("'classical,hybrid'", "'classical,hybrid' is not allowed"),
        ("[transition, hybrid]", "transition is not one of several: write it alone"),
        ("[classical, transition]", "transition is not one of several: write it alone"),
        ("[transition]", "transition is not one of several: write it alone"),
        ("[classical, hybrid]\nmigrate_from: pq", "`migrate_from` needs a `profile`"),
        ("[classical, hybrid]\nmigrate_from: classical", "`migrate_from` needs a `profile`"),
    ],
)
def test_a_list_of_profiles_that_no_keystore_can_have_is_refused(tmp_path, written, told):
    scene = Scene(tmp_path, f"profile: {written}")
    with pytest.raises(InvalidDocumentError) as refusal:
        read_domain(scene.file)
    assert any(told in line for line in refusal.value.lines), refusal.value.lines


@pytest.mark.parametrize(
    ("written", "profiles"),
    [
        ("pq", ("pq",)),
        ("transition", ("transition",)),
        ("[pq]", ("pq",)),
        ("[classical, pq]", ("classical", "pq")),
        ("[hybrid, pq, classical, cnsa2]", ("hybrid", "pq", "classical", "cnsa2")),
    ],
)
def test_a_domain_has_one_profile_or_a_list(tmp_path, written, profiles):
    scene = Scene(tmp_path, f"profile: {written}")
    assert read_domain(scene.file).profiles == profiles


# Made at once, and added


@pytest.mark.parametrize("written", [TWO, "profile: [classical, pq]", "profile: [hybrid, pq]"])
def test_a_new_keystore_has_all_sets_of_its_file(tmp_path, written):
    scene = Scene(tmp_path, FILE.replace(ONE, written))
    scene.apply()
    assert names(scene.keystore) == [*read_domain(scene.file).profiles]
    one_meaning_but_numbers(scene.keystore, *NAMES)
    before = scene.keystore.head
    assert scene.plan().in_order
    scene.apply()
    assert scene.keystore.head == before


def test_a_set_that_is_missing_is_added_before_all_other_steps(scene):
    scene.change(ONE, TWO)
    scene.change("1..3", "1..4")
    scene.change("rt/cmd", "rt/order")
    steps = scene.steps()
    assert steps[:2] == [*ADDED, ("issue", "/r4")]
    [step] = [each for each in scene.plan().steps if each.action == "add-set"]
    assert step.why == "beside classical: new CAs, and certificates for /monitor, /r1, /r2, /r3"
    scene.apply()
    assert scene.plan().in_order
    one_meaning_but_numbers(scene.keystore, *NAMES, "/r4")
    assert scene.allowed("/r1")[1] == ["rt/order"]


def test_no_octet_of_the_first_set_changes(scene):
    renew_list(scene.keystore, scene.keystore.unlock(None), now=NOW)
    assert scene.plan().in_order
    before = files_of(scene.root)
    scene.change(ONE, TWO)
    scene.apply()
    after = files_of(scene.root)
    assert before.keys() == after.keys()
    assert {each for each in before if before[each] != after[each]} <= ABOUT_THE_LEDGER


def test_two_sets_are_two_steps_in_the_order_of_the_file(scene):
    scene.change(ONE, THREE)
    assert scene.steps() == [*ADDED, ("add-set", "pq")]
    scene.apply()
    assert names(scene.keystore) == ["classical", "hybrid", "pq"]
    assert scene.plan().in_order
    one_meaning_but_numbers(scene.keystore, *NAMES)


def test_the_new_ca_keys_have_the_passphrase_of_the_others(tmp_path):
    scene, secret = Scene(tmp_path, FILE), b"some secret words"
    apply(read_domain(scene.file), scene.root, passphrase=secret, now=NOW)
    scene.change(ONE, TWO)
    desired = read_domain(scene.file)
    found = scene.plan()
    apply(desired, scene.root, passphrase=secret, now=NOW)
    keystore = scene.keystore
    keystore.unlock(secret)
    for path in (keystore.sets[1].folder / "private").glob("*.key.pem"):
        assert b"BEGIN ENCRYPTED PRIVATE KEY" in path.read_bytes()
    assert [each.action for each in found.steps] == ["add-set"]


def test_a_set_is_not_added_with_open_keys_beside_encrypted_ones(tmp_path):
    scene, secret = Scene(tmp_path, FILE), b"some secret words"
    apply(read_domain(scene.file), scene.root, passphrase=secret, now=NOW)
    keystore = scene.keystore
    with pytest.raises(PassphraseError, match="would not be encrypted"):
        add_set(
            keystore,
            keystore.unlock(secret),
            profile_named("hybrid"),
            validity=DAY,
            passphrase=None,
            now=NOW,
        )
    assert names(scene.keystore) == ["classical"]


def test_whose_key_is_elsewhere_is_told_to_ask_and_keeps_what_it_has(scene):
    scene.file_of("/r2", "key.pem").unlink()
    scene.change(ONE, TWO)
    scene.change("rt/cmd", "rt/order")
    found = scene.plan()
    assert found.steps[0].why.endswith(
        "certificates for /monitor, /r1, /r3; not for /r2, whose keys are elsewhere"
    )
    [blocked] = found.blocked
    assert blocked.name == "/r2"
    assert "it has no certificate of set hybrid" in blocked.why
    assert "pqsec request" in blocked.way_out
    assert ("sign-permissions", "/r2") in scene.steps()
    scene.apply()
    assert [each.name for each in scene.plan().blocked] == ["/r2"]
    assert scene.steps() == []
    assert scene.allowed("/r2")[1] == ["rt/order"]
    assert ("renew", "/r2") in scene.steps(NOW + 70 * DAY)


def test_whose_certificate_had_ended_is_issued_in_all_sets(scene):
    scene.change(ONE, TWO)
    later = NOW + 91 * DAY
    assert [each for each in scene.steps(later) if each[0] == "replace"] == [
        ("replace", name) for name in ("/r1", "/r2", "/r3", "/monitor")
    ]
    scene.apply(later)
    assert scene.plan(later).in_order
    one_meaning_but_numbers(scene.keystore, *NAMES, now=later)


@pytest.mark.parametrize(
    ("written", "told", "way_out"),
    [
        (
            ONE,
            "has profile classical, but .* has profiles classical, hybrid: .*not removed",
            "-k N",
        ),
        ("profile: [hybrid]", "has profile hybrid, but .* not removed", "[classical, hybrid]"),
        ("profile: [classical, pq]", "not removed", "`profile: [classical, hybrid]`"),
        ("profile: [hybrid, classical]", "in this order", "`profile: [classical, hybrid]`"),
        ("profile: [hybrid, pq, classical]", "in this order", "`profile: [classical, hybrid, pq]`"),
        ("profile: pq", "has profile pq, but", "[classical, hybrid]"),
        ("profile: pq\nmigrate_from: classical", "has profile pq, but", "[classical, hybrid]"),
    ],
)
def test_a_file_that_would_take_a_set_away_is_refused(both, written, told, way_out):
    both.change(TWO, written)
    with pytest.raises(KeystoreError, match=told) as error:
        both.plan()
    assert way_out in error.value.hint


def test_another_first_set_is_a_change_of_the_profile(scene):
    scene.change(ONE, "profile: [hybrid, pq]")
    with pytest.raises(KeystoreError, match="has profiles hybrid, pq, but") as error:
        scene.plan()
    assert "`migrate_from: classical`, and one profile" in error.value.hint


def test_without_a_profile_the_file_takes_what_the_keystore_has(both):
    both.change(TWO, "")
    assert both.plan().in_order


def test_a_set_that_another_command_added_is_not_added_again(scene):
    scene.change(ONE, TWO)
    found = scene.plan()
    keystore = scene.keystore
    hybrid, choices = profile_named("hybrid"), {"validity": 90 * DAY, "passphrase": None}
    before = scene.keystore
    add_set(keystore, keystore.unlock(None), hybrid, now=NOW, **choices)
    batches = apply_plan(read_domain(scene.file), before, before.unlock(None), found, now=NOW)
    with pytest.raises(KeystoreError, match="other sets of credentials"):
        list(batches)
    assert scene.plan().in_order


# What one set lacks


@pytest.mark.parametrize(
    ("file", "steps"),
    [
        ("enclaves/r1/cert.pem", [("replace", "/r1")]),
        ("enclaves/r1/permissions.p7s", [("sign-permissions", "/r1")]),
        ("enclaves/governance.p7s", [("sign-governance", "")]),
        ("public/identity_ca.crl.pem", [("renew-crl", "")]),
    ],
)
def test_a_file_that_a_further_set_lacks_is_made_again(both, file, steps):
    renew_list(both.keystore, both.keystore.unlock(None), now=NOW)
    (both.keystore.sets[1].folder / file).unlink()
    assert both.steps() == steps
    both.apply()
    assert both.plan().in_order
    audit(both.keystore)


@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s"])
def test_a_file_of_another_that_lies_in_one_set_is_replaced(both, file):
    enclaves = both.keystore.sets[1].folder / "enclaves"
    shutil.copyfile(enclaves / "r2" / file, enclaves / "r1" / file)
    assert [name for _, name in both.steps()] == ["/r1"]
    both.apply()
    assert both.plan().in_order
    one_meaning_but_numbers(both.keystore, "/r1", "/r2")


def test_rights_that_differ_in_one_set_are_signed_again(both):
    keystore = both.keystore
    second, folder = keystore.sets[1], keystore.sets[1].folder / "enclaves/r1"
    document = (folder / "permissions.xml").read_bytes().replace(b"rt/cmd", b"rt/all")
    authorities = keystore.unlock(None)
    with change(keystore.root, authorities) as transaction:
        part = transaction.of(second.set_name)
        signed = authorities.sets[1].sign(document, number=part.number, now=NOW)
        staged = part.folder("enclaves/r1", private=False)
        staged.public("permissions.xml", document)
        staged.public("permissions.p7s", signed)
        entry = document_entry("permissions", "/r1", signed, NOW)
        part.record(replace(entry, details={"mark": "of another file"}))
    assert both.steps() == [("sign-permissions", "/r1")]
    both.apply()
    one_meaning_but_numbers(keystore, "/r1")


def test_a_participant_that_is_pruned_is_revoked_in_all_sets(both):
    both.change("1..3", "1..2")
    both.apply(prune=True)
    for each in both.keystore.sets:
        assert len(each.revocation_list.revoked) == 1


# What is in the way of a set


def other_form(keystore):
    """The governance has another form than pqsec writes."""
    authorities = keystore.unlock(None)
    document = (keystore.root / "enclaves/governance.xml").read_bytes()
    document = document.replace(b"<domain_access_rules>", b"<domain_access_rules >")
    with change(keystore.root, authorities) as transaction:
        stage_governance(transaction.of(""), authorities, document, now=NOW)


def test_what_is_in_the_way_of_a_set_is_told_by_the_plan(scene):
    other_form(scene.keystore)
    scene.change(ONE, TWO)
    found = scene.plan()
    assert [each.action for each in found.steps] == []
    [blocked] = found.blocked
    assert blocked.name == "the keystore"
    assert "has another form than pqsec writes" in blocked.why
    assert "sign-governance" in blocked.way_out
    scene.apply()
    assert names(scene.keystore) == ["classical"]


def test_no_set_is_added_while_two_identity_cas_are_trusted(scene):
    keystore = scene.keystore
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY, overlap=OverlapStep.BEGIN)
    kept = keystore.unlock(None)
    apply_rollover(keystore, plan_rollover(keystore, terms, now=NOW), kept=kept, now=NOW)
    scene.change(ONE, TWO)
    found = scene.plan()
    assert "add-set" not in {each.action for each in found.steps}
    assert [each.name for each in found.blocked] == ["the keystore"]


def test_after_a_set_that_failed_nothing_is_issued(scene):
    """Else the new participants would lack it."""
    scene.change(ONE, TWO)
    scene.change("1..3", "1..4")
    found = scene.plan()
    (scene.root / "sets").write_text("in its place")
    with pytest.raises(KeystoreError):
        scene.take(found)
    assert "/r4" not in scene.keystore.names()


# Import


@pytest.mark.parametrize("written", [TWO, THREE])
def test_the_file_of_a_keystore_with_sets_names_all(both, written):
    both.change(TWO, written)
    both.apply()
    found = import_domain([both.root], now=NOW, domains=both.keystore.domains)
    both.write(found.document.decode())
    assert read_domain(both.file).profiles == tuple(names(both.keystore))
    assert both.plan().in_order


# Who may be met with the first set


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ("/r4", "no participant of the file is /r4"),
        ("r5", "no participant of the file is r5"),
        ("[/r1, /rr*]", "no participant of the file is /rr*"),
        ("'/r{1-3}'", "write {001..100}"),
        ("'@all'", "cannot be a participant's name"),
        ("''", ""),
        ("' '", ""),
        ("[[/r1]]", "expected a text"),
        ("{name: /r1}", "expected a text"),
        ("true", "YAML reads true as"),
        ("'/r1\\n/r2'", ""),
        ('"/r1\\x00"', ""),
        ("'/r1\" ]'", ""),
        ("'/r*\" ]'", ""),
        ("'CN=/r1'", ""),
    ],
)
def test_a_stock_name_that_stands_for_nobody_is_refused(tmp_path, written, told):
    scene = Scene(tmp_path, f"{FILE}stock: {written}\n")
    with pytest.raises(InvalidDocumentError) as refusal:
        read_domain(scene.file)
    assert any("line 12: " in line and told in line for line in refusal.value.lines)


def test_stock_names_are_kept_as_names_and_patterns(tmp_path):
    text = FILE.replace("1..3", "1..2000")
    scene = Scene(tmp_path, f"{text}stock: [monitor, '/r{{1..2}}', 'r1*', '/**', monitor]\n")
    assert read_domain(scene.file).stock == ("/**", "/monitor", "/r1", "/r1*", "/r2")
    scene.write(f"{text}stock: []\n")
    assert read_domain(scene.file).stock == ()
    scene.write(f"{text}stock: '/r{{1..1001}}'\n")
    with pytest.raises(InvalidDocumentError, match="more than 1000 names"):
        read_domain(scene.file)


def test_stock_names_are_stored_where_exports_read_them(both):
    assert both.keystore.stock == ()
    both.write(f"{both.file.read_text()}stock: ['/r*', /monitor]\n")
    assert both.steps() == [("store-stock", "")]
    assert both.whys() == {"": "/monitor, /r*"}
    both.apply()
    assert both.keystore.stock == ("/monitor", "/r*")
    assert [each.stock for each in both.keystore.sets] == [("/monitor", "/r*")] * 2
    assert both.plan().in_order
    found = import_domain([both.root], now=NOW, domains=both.keystore.domains)
    both.write(found.document.decode())
    assert read_domain(both.file).stock == ("/monitor", "/r*")
    assert both.plan().in_order
    both.write(both.file.read_text().partition("stock:")[0])
    assert both.whys() == {"": "nobody"}
    both.apply()
    assert both.keystore.stock == ()
    audit(both.keystore)


def test_a_new_keystore_has_the_stock_names_of_its_file(tmp_path):
    scene = Scene(tmp_path, FILE.replace(ONE, f"{TWO}\nstock: /r1"))
    assert ("store-stock", "") in scene.steps()
    scene.apply()
    assert scene.keystore.stock == ("/r1",)
    assert scene.plan().in_order


def test_stock_names_cannot_be_edited_in_a_file_of_the_keystore(both):
    """They are in the ledger: an older copy, without the line, is refused."""
    both.write(f"{both.file.read_text()}stock: ['/r*']\n")
    place = both.root / "private/ledger.sqlite3"
    old = place.read_bytes()
    both.apply()
    place.write_bytes(old)
    with pytest.raises(KeystoreError, match="rolled back"):
        _ = both.keystore.stock


# Approvals


@pytest.fixture
def council(tmp_path):
    return Council(tmp_path / "council", DOMAIN.replace("roles:", "stock: [/r1]\nroles:"))


def test_one_approval_is_of_the_set_and_all_other_steps(council):
    council.change(*GROWS)
    council.change("profile: classical", "profile: [classical, hybrid]\nprune: true")
    council.change("1..3", "2..4")
    council.change("stock: [/r1]", "stock: [/r2]")
    proposal, first = council.proposed()
    assert {Covered.ROTATE, Covered.REVOKE, Covered.GROW} <= {*proposal.needs}
    assert [each.name for each in proposal.steps if each.action == "add-set"] == ["hybrid"]
    words = "certificates of all sets (classical, hybrid) that are valid for 90 days"
    told = {change: each.names for each in proposal.rights for change in each.changes}
    assert words in told
    assert told["a certificate of set hybrid, as long as that of the first"] == (
        "/r1",
        "/r2",
        "/r3",
    )
    assert told["may be met with the first set of credentials"] == ("/r2",)
    assert told["may no longer be met with the first set of credentials"] == ("/r1",)
    refused(council, proposal, first, words="needs 2 approvals|1 of 2|approv")
    council.decide(proposal, first, council.approval(proposal, "bob"))
    assert council.plan().in_order
    assert len([each for each in council.kinds() if each == "plan"]) == 1
    one_meaning_but_numbers(council.keystore, "/r2", "/r3", "/r4")


def test_an_approved_set_that_was_interrupted_goes_on_and_makes_each_step_once(council):
    """The lines with which a set begins are not taken for those of other steps."""
    council.change(*GROWS)
    council.change("profile: classical", "profile: [classical, hybrid, pq]\nprune: true")
    council.change("1..3", "2..4")
    council.change("stock: [/r1]", "stock: [/r2]")
    later = NOW + 70 * DAY  # all are due
    proposal, first = council.proposed(now=later)
    given = first, council.approval(proposal, "bob", later)
    wanted = [(each.action, each.name) for each in proposal.steps]
    assert {action for action, _ in wanted} == {
        *("add-set", "issue", "sign-permissions", "renew", "revoke", "store-stock"),
    }
    made = []
    for _ in range(len(wanted) + 1):
        begun = council.approved(proposal, *given, now=later).begin(later)
        batches = apply_plan(
            council.desired, begun.keystore, begun.keystore.unlock(None), begun.plan, now=later
        )
        made += [(each.action, each.name) for each in next(batches)]
        batches.close()
        if council.plan(later).in_order:
            break
    assert sorted(made) == sorted(wanted)
    refused(council, proposal, *given, words="was applied already", now=later)
    one_meaning_but_numbers(council.keystore, "/r2", "/r3", "/r4", now=later)


def test_a_set_alone_needs_the_approvals_of_new_cas(council):
    council.change("profile: classical", "profile: [classical, hybrid]")
    review = PlanReview(council.desired, council.keystore, council.plan(), NOW)
    assert review.kinds == {Covered.ROTATE}
    with pytest.raises(KeystoreError, match="approv"):
        apply(council.desired, council.root, passphrase=None, now=NOW)
    assert names(council.keystore) == ["classical"]


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        ("[/r1, /r2]", Covered.GROW),
        ("[/r2]", Covered.GROW),
        ("['/r*']", Covered.GROW),
        ("[]", Covered.OTHER),
    ],
)
def test_only_a_stock_name_more_is_as_a_right_that_is_given(council, written, kind):
    council.change("stock: [/r1]", f"stock: {written}")
    review = PlanReview(council.desired, council.keystore, council.plan(), NOW)
    assert kind in review.kinds
    assert (Covered.GROW in review.kinds) is (kind is Covered.GROW)


def test_an_approval_is_not_of_other_stock_names(council):
    council.change("stock: [/r1]", "stock: [/r2]")
    proposal, first = council.proposed()
    given = first, council.approval(proposal, "bob")
    council.change("stock: [/r2]", "stock: ['/**']")
    refused(council, proposal, *given, words="is not the file that the plan was made of")


# All or none, wherever the process dies


def test_an_apply_with_a_set_is_ended_by_the_next_whenever_the_kill_comes(place):
    (place / "original").mkdir()
    original = Scene(place / "original", FILE)
    original.apply()
    original.change(ONE, f"{TWO}\nstock: /r1")
    original.change("1..3", "1..4")
    lefts = set()
    for folder, _ in copies(place, original.file.parent, lambda at: Scene.at(at).apply(), every=53):
        scene = Scene.at(folder)
        Keystore.recover(scene.root)
        audit(scene.keystore)
        left = tuple(scene.steps())
        if left in lefts:
            continue
        lefts.add(left)
        scene.apply()
        assert scene.plan().in_order
        one_meaning_but_numbers(scene.keystore, *NAMES, "/r4")
    every = original.steps()
    assert lefts <= {tuple(every[number:]) for number in range(len(every) + 1)}
    assert len(lefts) > len(every) - 1  # one of them may be passed over


# Requests, orders, and machines with one CA each


@pytest.mark.parametrize("start", ["nothing", "one set", "two sets"])
def test_a_request_for_one_set_is_not_answered_where_there_are_several(tmp_path, start):
    scene = Scene(tmp_path, FILE.replace(ONE, TWO if start == "two sets" else ONE))
    if start != "nothing":
        scene.apply()
    asked = request("/arm", profile_named("classical"), tmp_path / "robot")
    written = scene.file.read_text().replace(ONE, TWO)
    scene.write(f"{written}  - {{name: /arm, role: robot, request: {asked.path}}}\n")
    found = scene.plan()
    assert "/arm" not in {each.name for each in found.steps}
    [blocked] = found.blocked
    assert blocked.name == "/arm"
    assert "its request is refused" in blocked.why
    scene.apply()
    assert "/arm" not in scene.keystore.names()
    assert [each.name for each in scene.plan().blocked] == ["/arm"]


def test_who_was_enrolled_by_a_request_must_send_one_for_the_new_set(tmp_path):
    asked = request("/arm", profile_named("classical"), tmp_path / "robot")
    item = f"  - {{name: /arm, role: robot, request: {asked.path}}}\n"
    scene = Scene(tmp_path, f"{FILE}{item}")
    scene.apply()
    before = files_of(scene.root)["enclaves/arm/cert.pem"]
    scene.change(ONE, TWO)
    assert scene.plan().steps[0].why.endswith("not for /arm, whose keys are elsewhere")
    [blocked] = scene.plan().blocked
    assert blocked.name == "/arm"
    scene.apply()
    [blocked] = scene.plan().blocked
    assert blocked.name == "/arm"
    assert files_of(scene.root)["enclaves/arm/cert.pem"] == before
    scene.change("rt/cmd", "rt/order")
    scene.apply()
    assert scene.allowed("/arm")[1] == ["rt/order"]


def test_an_order_for_one_set_enrols_nobody_where_there_are_several(tmp_path):
    line = OrderedLine(tmp_path / "line")
    line.bring(line.order(line.add(), *BOTH))
    line.change("profile: classical", "profile: [classical, hybrid]")
    found = line.plan()
    assert {each.action for each in found.steps} == {"add-set"}
    assert {each.name for each in found.blocked} == {*BOTH}
    line.apply()
    assert not {*BOTH} & {*line.keystore.names()}


def test_machines_with_one_ca_each_make_their_part_in_all_sets(both):
    both.change("1..3", "1..4")
    both.change("rt/cmd", "rt/order")
    for only in SigningCa:
        both.apply(only=only)
    assert both.plan().in_order
    one_meaning_but_numbers(both.keystore, *NAMES, "/r4")


def test_a_set_is_added_where_the_keys_of_both_cas_are(scene):
    scene.change(ONE, TWO)
    for only in SigningCa:
        found = scene.plan(only=only)
        assert [each.action for each in found.left if each.action == "add-set"] == ["add-set"]
        assert "add-set" not in {each.action for each in found.steps}


def certified(view, name):
    """The certificate of who has its key elsewhere."""
    return load_certificate(view.folder / f"enclaves{name}/cert.pem")


def test_a_request_for_all_sets_is_answered_in_all(both):
    classical, hybrid = map(profile_named, ("classical", "hybrid"))
    place = both.root.parent / "robot"
    asked = request("/arm", classical, place, further=[hybrid])
    both.write(f"{both.file.read_text()}  - {{name: /arm, role: robot, request: {asked.path}}}\n")
    [step] = both.plan().steps
    assert (step.action, step.name, len(step.keys.split())) == ("issue", "/arm", 2)
    both.apply()
    assert both.plan().in_order
    found = [certified(each, "/arm").spki for each in both.keystore.sets]
    assert len({*found}) == 2
    request("/arm", classical, place, further=[hybrid], force=True)
    [blocked] = both.plan().blocked
    assert "its request is for another key" in blocked.why
    assert [each.action for each in both.plan(new_keys=True).steps] == ["replace"]


@pytest.mark.parametrize("is_own", [True, False])
def test_who_has_its_key_gets_an_added_set_by_a_request_that_proves_it(tmp_path, is_own):
    classical, hybrid = map(profile_named, ("classical", "hybrid"))
    own, other = (classical.participant_key.generate() for _ in range(2))
    file = tmp_path / "arm.csr"
    file.write_bytes(certificate_request("/arm", own).pem)
    scene = Scene(tmp_path, f"{FILE}  - {{name: /arm, role: robot, request: arm.csr}}\n")
    scene.apply()
    scene.change(ONE, TWO)
    scene.apply()
    [blocked] = scene.plan().blocked
    assert "it lacks keys of profile hybrid" in blocked.why
    new = hybrid.participant_key.generate()
    first = own if is_own else other
    file.write_bytes(certificate_request("/arm", first, further=[(new, None)]).pem)
    if not is_own:
        [blocked] = scene.plan().blocked
        assert "--new-keys" in blocked.way_out
        return
    assert scene.steps() == [("replace", "/arm")]
    scene.apply()
    assert scene.plan().in_order
    found = [certified(each, "/arm").spki for each in scene.keystore.sets]
    assert found == [own.public_key.spki, new.public_key.spki]


def test_an_order_for_all_sets_enrols_in_all(tmp_path):
    line = OrderedLine(tmp_path / "line")
    line.change("profile: classical", "profile: [classical, hybrid]")
    line.apply()
    hybrid = profile_named("hybrid")
    asked = [
        request(name, line.profile, tmp_path / "robots", further=[hybrid]).request for name in BOTH
    ]
    grant = line.add()
    line.bring(ordered(asked, grant, line.key, "robot", validity=90 * DAY, now=NOW))
    assert {each.action for each in line.plan().steps} == {"enrol"}
    line.apply()
    assert line.plan().in_order
    for name in BOTH:
        found = [certified(each, name) for each in line.keystore.sets]
        assert len({each.spki for each in found}) == 2
        assert len({each.subject_der for each in found}) == 1
    audit(line.keystore)
