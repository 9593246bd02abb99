"""What shows or checks a keystore with several sets of credentials: of all sets, by their names."""

import hashlib
import json
import re

import pytest

from pqsec_pki.access import SPEC
from pqsec_pki.algorithms import profile_named
from pqsec_pki.cbom import bill_of
from pqsec_pki.cli._printing import as_json
from pqsec_pki.documents import DomainSet, Kind
from pqsec_pki.errors import KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import (
    Keystore,
    faults_of_ledger,
    signed_governance,
    superseded_certificates,
)
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    add_set,
    changed_permissions,
    issue,
    renew,
    renew_list,
    revoke,
    sign_document,
    sign_head,
)
from pqsec_pki.lifecycle.growing import changed_protection, changed_rights, grows
from pqsec_pki.lint import check, largest_messages
from pqsec_pki.policy import differences_between, fleet_in, policy_input_of
from pqsec_pki.report import changes_since, csv_of, html_of, read_earlier, report_of
from tests.unit.keystores import DAY, NOW

LATER = NOW + 3 * DAY
SETS = {
    "hybrid": ("classical", "hybrid"),
    "pq": ("classical", "pq"),
    "three": ("classical", "hybrid", "pq"),
}


def create(root, *names):
    keystore = Keystore.create(
        root,
        *map(profile_named, names),
        name="Lab",
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    domains = DomainSet.of(0)
    rights = {"/talker": {"publish": ("chatter",)}, "/listener": {"subscribe": ("chatter",)}}
    specs = [
        ParticipantSpec(name=name, domains=domains, validity=300 * DAY, **topics)
        for name, topics in rights.items()
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    return keystore


@pytest.fixture(params=SETS)
def keystore(request, tmp_path):
    """A keystore with several sets, and a participant in all that was renewed."""
    keystore = create(tmp_path / "k", *SETS[request.param])
    renew(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    renew_list(keystore, keystore.unlock(None), now=LATER)
    return keystore


@pytest.fixture
def two(tmp_path):
    return create(tmp_path / "k", "classical", "hybrid")


def names_of(keystore):
    return [each.set_name for each in keystore.sets]


# The report


def test_a_report_has_the_certificates_of_every_set(keystore):
    found = report_of(keystore, now=LATER)
    assert found.gaps == ()
    assert found.profiles == tuple(each.name for each in keystore.profiles)
    for row in found.participants:
        own = [each.participant(row.name).certificate for each in keystore.sets]
        rows = (row, *row.further)
        assert [each.serial for each in rows] == [f"{each.serial_number:x}" for each in own]
        assert [each.profile for each in rows] == list(found.profiles)
        assert [len(each.superseded) for each in rows] == [row.name == "/talker"] * len(own)


def test_a_report_has_the_cas_and_lists_of_every_set(keystore):
    found = report_of(keystore, now=LATER).authorities
    for each in keystore.sets:
        own = {row.fingerprint for row in found if row.set_name == each.set_name}
        crl = hashlib.sha256(each.revocation_list_path.read_bytes()).hexdigest()
        assert own == {each.identity_ca.fingerprint, each.permissions_ca.fingerprint, crl}
    assert len(found) == 3 * len(keystore.sets)


def test_a_report_has_what_ends_in_every_set(keystore):
    kinds = {each.kind: each for each in report_of(keystore, now=LATER).endings}
    for name in names_of(keystore):
        of_set = f", set {name}" if name else ""
        for kind in (
            "identity CA",
            "permissions CA",
            "revocation list",
            "participant's certificate",
        ):
            assert f"{kind}{of_set}" in kinds


def test_a_report_says_what_a_quantum_computer_breaks_in_each_set(keystore):
    found = report_of(keystore, now=LATER).exposures
    for each in keystore.sets:
        own = {row.use: row for row in found if row.profile == each.profile.name}
        for use in ("signatures of the identity CA", "participants' signatures in handshakes"):
            assert own[use].algorithm == each.identity_ca.public_key.algorithm.name
            assert own[use].strength == ("holds" if each.set_name else "broken")
        people = own["participants' signatures in handshakes"]
        assert set(people.names) == {"/talker", "/listener"}
        assert own["traffic recorded today"].strength == ("holds" if each.set_name else "broken")


def test_handshakes_are_measured_with_the_profile_of_their_set(keystore, tmp_path):
    """As in a keystore with that profile alone."""
    found = report_of(keystore, now=LATER).sizes
    for each in keystore.sets:
        name = each.profile.name
        other = create(tmp_path / name, name)
        renew(other, other.unlock(None), ["/talker"], now=LATER)
        [alone] = {
            max(size.message for size in largest_messages(check([other.root], now=LATER).inventory))
        }
        largest = max(size.message for size in found if size.profile == name)
        assert abs(largest - alone) < 200  # signatures and names differ by some octets


def test_a_report_shows_every_set_in_each_format(two):
    found = report_of(two, now=LATER)
    page, table = html_of(found), csv_of(found)
    assert "profile classical, hybrid" in page
    for each in two.sets:
        certificate = each.participant("/talker").certificate
        for text in (page, table):
            assert f"{certificate.serial_number:x}" in text
            assert each.identity_ca.fingerprint in text
    second = hashlib.sha256(two.sets[1].governance).hexdigest()
    assert second in page


def test_a_comparison_finds_what_changed_in_a_further_set(two, tmp_path):
    renew_list(two, two.unlock(None), now=NOW)
    before = report_of(two, now=LATER)
    path = tmp_path / "before.json"
    path.write_text(as_json(before.to_json()))
    earlier = read_earlier(path)
    assert changes_since(earlier, before, two).count == 0
    renew(two, two.unlock(None), ["/talker"], now=LATER)
    later = report_of(two, now=LATER)
    [line] = changes_since(earlier, later, two).changed
    assert f"{two.sets[1].participant('/talker').certificate.serial_number:x}" in line
    crl = two.sets[1].revocation_list_path.read_bytes()
    renew_list(two, two.unlock(None), now=LATER)
    lines = changes_since(earlier, report_of(two, now=LATER), two).authorities
    assert f"no longer: revocation list, set hybrid, {hashlib.sha256(crl).hexdigest()}" in lines


def test_what_is_issued_first_in_a_further_set_is_not_renewed(two):
    events = {each.what for each in report_of(two, now=LATER).events}
    assert "issued" in events
    assert "renewed" not in events


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("file", ["public/identity_ca.cert.pem", "public/identity_ca.crl.pem"])
def test_a_report_has_a_gap_or_a_state_for_what_one_set_lacks(two, number, file):
    renew_list(two, two.unlock(None), now=LATER)
    (two.sets[number].folder / file).unlink()
    found = report_of(two, now=LATER)
    assert found.gaps or any(each.state == "gone" for each in found.authorities)
    assert any(group.rule == "PQS010" for group in found.findings.groups)


# Bills of materials


def test_a_bill_has_the_suites_of_each_set(keystore):
    bill = json.loads(bill_of([keystore.root], now=LATER).document)
    [protocol] = [each for each in bill["components"] if each["name"] == "DDS:Auth:PKI-DH"]
    suites = protocol["cryptoProperties"]["protocolProperties"]["cipherSuites"]
    found = {each["name"] for each in suites}
    for each in keystore.sets[1:]:
        key, agreement = each.profile.participant_key, each.profile.key_agreement
        assert f"{key.wire_name} with {agreement.wire_name}" in found
        assert not any(
            name.startswith(f"{key.wire_name} with") and agreement.wire_name not in name
            for name in found
        )
    places = json.dumps(bill)
    for each in keystore.profiles[1:]:
        assert f"sets/{each.name}/public/identity_ca.cert.pem" in places


# Findings


def findings(keystore, **others):
    found = check([keystore.root], now=LATER, **others).findings
    return {(each.rule.id, str(each.path.relative_to(keystore.root))) for each in found}


def test_a_certificate_that_was_replaced_is_found_in_each_set(keystore):
    wanted = {f"{f'sets/{name}/' if name else ''}enclaves/talker" for name in names_of(keystore)}
    assert {path for rule, path in findings(keystore) if rule == "PQS353"} == wanted
    entries = superseded_certificates(keystore, now=LATER)["/talker"]
    assert [each.set_name for each in entries] == names_of(keystore)


@pytest.mark.parametrize("revoked", [True, False])
def test_robots_without_the_lists_of_all_sets_are_found(keystore, revoked):
    if revoked:
        revoke(keystore, keystore.unlock(None), ["/listener"], now=LATER)
    rule = "PQS351" if revoked else "PQS352"
    wanted = [str(keystore.revocation_list_path.relative_to(keystore.root))]  # one for all sets
    assert [path for each, path in findings(keystore) if each == rule] == wanted


@pytest.mark.parametrize("number", [0, 1])
def test_a_key_is_compared_with_the_profile_of_its_set(two, number, tmp_path):
    """The identity CA of a set of classical keys, in each set."""
    other = create(tmp_path / "weak", "classical")
    weak = (other.root / "public/identity_ca.cert.pem").read_bytes()
    path = two.sets[number].folder / "public/identity_ca.cert.pem"
    path.write_bytes(weak)
    found = ("PQS609", str(path.relative_to(two.root)))
    assert (found in findings(two)) is (number == 1)


@pytest.mark.parametrize("target", ["cyclonedds", "fastdds", "opendds"])
def test_keys_for_the_plugin_are_no_fault_for_a_stock_stack(keystore, target):
    """It loads the first set only."""
    found = {rule for rule, _ in findings(keystore, targets=[target])}
    assert not found & {"PQS601", "PQS602"}


# Questions to policies


def other_document(keystore, number, place):
    """Sign a document of one set again, with other content, as no command does."""
    view = keystore.sets[number]
    path = view.folder / place
    document = path.with_suffix(".xml").read_bytes()
    changed = document.replace(b"chatter", b"other").replace(b"ENCRYPT", b"NONE")
    assert changed != document
    path.write_bytes(keystore.unlock(None).sets[number].sign(changed, number=99, now=NOW))


@pytest.mark.parametrize("lost", [True, False])
def test_questions_about_rights_refuse_sets_with_another_governance(two, lost):
    if lost:
        (two.sets[1].folder / "enclaves/governance.p7s").unlink()
    else:
        other_document(two, 1, "enclaves/governance.p7s")
    for ask in (
        lambda: policy_input_of(two, "/talker", LATER),
        lambda: fleet_in(two, LATER, SPEC),
        lambda: differences_between(two.root, two.root, LATER),
    ):
        with pytest.raises(VerificationError, match=r"sets/hybrid/enclaves/governance\.p7s"):
            ask()
    [gap] = [each for each in report_of(two, now=LATER).gaps if each.section.startswith("Who may")]
    assert "give different rights" in gap.reason


@pytest.mark.parametrize("lost", [True, False])
def test_questions_about_rights_refuse_sets_with_other_permissions(two, lost):
    if lost:
        (two.sets[1].folder / "enclaves/talker/permissions.p7s").unlink()
    else:
        other_document(two, 1, "enclaves/talker/permissions.p7s")
    for ask in (
        lambda: policy_input_of(two, "/talker", LATER),
        lambda: differences_between(two.root, two.root, LATER),
        lambda: changed_permissions(two, ["/talker"], lambda _, grant: grant, now=LATER),
    ):
        with pytest.raises(VerificationError, match="give different rights"):
            ask()
    fleet = fleet_in(two, LATER, SPEC)
    assert "give different rights" in fleet.refused["/talker"]
    assert [each.name for each in fleet.members] == ["/listener"]
    assert policy_input_of(two, "/listener", LATER)


def test_a_participant_that_waits_for_a_further_set_has_the_rights_of_the_first(tmp_path):
    keystore = create(tmp_path / "k", "classical")
    (keystore.root / "enclaves/talker/key.pem").unlink()
    hybrid = profile_named("hybrid")
    choices = {"validity": 900 * DAY, "passphrase": None, "now": NOW}
    assert add_set(keystore, keystore.unlock(None), hybrid, **choices).left == ("/talker",)
    keystore = Keystore.open(tmp_path / "k")
    assert {each.name for each in fleet_in(keystore, LATER, SPEC).members} == {
        "/talker",
        "/listener",
    }
    rows = {each.name: each for each in report_of(keystore, now=LATER).participants}
    assert (rows["/talker"].state, rows["/talker"].further) == ("incomplete", ())


# Files that are signed elsewhere


@pytest.mark.parametrize("profile", ["classical", "hybrid"])
def test_a_file_elsewhere_is_signed_by_the_ca_of_one_set(two, tmp_path, profile):
    document = (two.root / "enclaves/governance.xml").read_bytes()
    goal, cas, before = tmp_path / "x.p7s", two.unlock(None), len(two.lines())
    sign_document(two, Kind.GOVERNANCE, document, goal, cas, now=LATER, profile=profile)
    chosen = two.of_profile(profile)
    assert chosen.anchors.signed(goal.read_bytes()).document.replace(b"\r\n", b"\n") == document
    [line] = two.ledger()[before:]
    assert line.set_name == chosen.set_name


def test_a_file_elsewhere_needs_the_name_of_a_set(two, tmp_path):
    document = (two.root / "enclaves/governance.xml").read_bytes()
    goal, cas, before = tmp_path / "x.p7s", two.unlock(None), two.head
    with pytest.raises(UsageError, match="name one with --set: classical, hybrid"):
        sign_document(two, Kind.GOVERNANCE, document, goal, cas, now=LATER)
    with pytest.raises(KeystoreError, match="it has classical, hybrid"):
        sign_document(two, Kind.GOVERNANCE, document, goal, cas, now=LATER, profile="pq")
    place = two.root / "enclaves/governance.p7s"
    choices = {"now": LATER, "profile": "hybrid", "force": True}
    with pytest.raises(UsageError, match="is signed in all sets"):
        sign_document(two, Kind.GOVERNANCE, document, place, cas, **choices)
    assert two.head == before
    assert not goal.exists()


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    ("kind", "place"),
    [(Kind.GOVERNANCE, "enclaves"), (Kind.PERMISSIONS, "enclaves/talker")],
)
def test_a_document_in_the_place_of_any_set_is_signed_in_all(two, kind, place, number):
    path = two.sets[number].folder / place / f"{kind.value}.xml"
    old = path.read_bytes()
    document = old.replace(b"chatter", b"other").replace(b"ENCRYPT", b"SIGN")
    cas, goal = two.unlock(None), path.with_suffix(".p7s")
    sign_document(two, kind, document, goal, cas, now=LATER, force=True)
    texts = {(each.folder / place / path.name).read_bytes() for each in two.sets}
    assert texts not in ({old}, set())
    assert len(texts) == 1
    assert policy_input_of(two, "/talker", LATER)


@pytest.mark.parametrize("kind", ["governance", "permissions"])
def test_rights_that_differ_between_the_sets_may_grow(two, kind):
    """So their change needs approvals, whatever the first set says."""
    spec = ParticipantSpec(
        name="/talker", domains=DomainSet.of(0), validity=DAY, publish=("chatter",)
    )
    governance = signed_governance(two)

    def found():
        if kind == "governance":
            return changed_protection(two, governance)
        [(_, difference)] = changed_rights(two, [spec], now=LATER)
        return difference

    assert not grows(found())
    place = "enclaves/governance.p7s" if kind == "governance" else "enclaves/talker/permissions.p7s"
    other_document(two, 1, place)
    assert grows(found())


# A set that the settings, which nobody signs, no longer name


@pytest.fixture
def hidden(two):
    """The keystore with settings that name its first set only."""
    path = two.root / "pqsec.json"
    settings = json.loads(path.read_bytes())
    settings["algorithms"] = settings["algorithms"][:1]
    path.write_text(json.dumps(settings))
    return Keystore.open(two.root)


def test_a_set_that_the_settings_hide_is_missed_by_what_shows_the_keystore(hidden):
    words = r"pqsec\.json lacks the set of credentials hybrid"
    assert any(re.search(words, each) for each in faults_of_ledger(hidden))
    assert ("PQS008", "pqsec.json") in findings(hidden)
    evidence = report_of(hidden, now=LATER).evidence
    assert any(re.search(words, each) for each in evidence.audit)
    with pytest.raises(KeystoreError, match=words):
        fleet_in(hidden, LATER, SPEC)


def test_a_head_is_not_signed_without_a_set_that_the_settings_hide(hidden):
    with pytest.raises((KeystoreError, VerificationError), match="lacks the set"):
        sign_head(hidden, hidden.unlock(None))
