"""An older file, put back into its place, leaves the keystore in nothing that is made there."""

import pytest

from pqsec_pki.access import SPEC
from pqsec_pki.documents import DomainSet, Governance, Kind
from pqsec_pki.enrolment import Bundle, SignRequest, pins_in_use, request, sign
from pqsec_pki.errors import KeystoreError, PqsecError, VerificationError
from pqsec_pki.keystore import CurrentFiles, Keystore, audit, overview_of
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Rollover,
    Scope,
    renew,
    renew_list,
    revoke,
    sign_document,
    sign_governance,
)
from pqsec_pki.lint import check
from pqsec_pki.policy import fleet_of
from pqsec_pki.report import report_of
from pqsec_pki.vendors import Options, export
from tests.unit.keystores import DAY, NOW, add, begin_overlap, cancel_overlap, made, rotate

LATER = NOW + DAY


@pytest.fixture
def keystore(tmp_path):
    found = made(tmp_path / "k", "classical")
    renew_list(found, found.unlock(None), now=NOW)
    return found


def governance_again(keystore):
    governance = Governance.from_xml((keystore.root / "enclaves/governance.xml").read_bytes())
    sign_governance(keystore, keystore.unlock(None), governance, now=LATER)


def rotated(keystore):
    rotate(keystore, Rollover(profile=keystore.profile), now=LATER, passphrase=None)


CHANGES = {
    "public/identity_ca.crl.pem": lambda k: revoke(k, k.unlock(None), ["/listener"], now=LATER),
    "enclaves/governance.p7s": governance_again,
    "enclaves/talker/permissions.p7s": lambda k: renew(k, k.unlock(None), ["/talker"], now=LATER),
    "enclaves/talker/cert.pem": lambda k: renew(k, k.unlock(None), ["/talker"], now=LATER),
    "public/identity_ca.cert.pem": rotated,
    "public/permissions_ca.cert.pem": rotated,
}
SHARED = [each for each in CHANGES if "talker" not in each]
CAS = [each for each in CHANGES if "_ca.cert" in each]


def put_back(keystore, file):
    """Make the change that writes another file, and put the first one back."""
    path = keystore.root / file
    before = path.read_bytes()
    CHANGES[file](keystore)
    assert path.read_bytes() != before
    path.write_bytes(before)
    return Keystore.open(keystore.root, to_change=True)


def name_of(file):
    return file.rpartition("/")[2]


@pytest.mark.parametrize("file", CHANGES)
def test_check_finds_an_older_file(keystore, file):
    CHANGES[file](keystore)
    assert "PQS009" not in {each.rule.id for each in check([keystore.root], now=LATER).findings}
    older = put_back(keystore, file)
    found = [each for each in check([older.root], now=LATER).findings if each.rule.id == "PQS009"]
    assert [each.path for each in found] == [older.root / file]


STACKS = ["cyclonedds", "fastdds", "opendds", "connext", "ros2"]


@pytest.mark.parametrize("file", CHANGES)
def test_an_older_file_is_in_no_bundle(keystore, file):
    older = put_back(keystore, file)
    with pytest.raises(KeystoreError) as caught:
        Bundle.of(older, ["/talker"], now=LATER)
    assert name_of(file) in str(caught.value)
    assert caught.value.hint


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("file", CHANGES)
def test_an_older_file_is_in_no_export_unless_that_is_asked_for(keystore, file, stack):
    older = put_back(keystore, file)
    with pytest.raises(PqsecError):
        export(stack, older, "/talker", Options(), now=LATER)
    told = export(stack, older, "/talker", Options(anyway=True), now=LATER).warnings
    assert [each for each in told if name_of(file) in each and "ledger " in each]


@pytest.mark.parametrize("file", CHANGES)
def test_an_older_file_is_no_alarm_of_its_own_but_shows(keystore, file):
    older = put_back(keystore, file)
    with pytest.raises(VerificationError, match=r"is not the newest|no signature"):
        audit(older)


@pytest.mark.parametrize("file", CAS)
def test_pins_are_those_of_the_ledger(keystore, file):
    older = put_back(keystore, file)
    for shown in (pins_in_use, overview_of):
        with pytest.raises(KeystoreError, match="does not have the CA certificates that"):
            shown(older.as_found)


def test_another_ca_beside_the_own_one_is_not_pinned(keystore, tmp_path):
    other = made(tmp_path / "other", "classical", names=("/a",))
    path = keystore.root / "public/identity_ca.cert.pem"
    path.write_bytes(path.read_bytes() + other.identity_ca.pem)
    with pytest.raises(KeystoreError, match=path.name):
        pins_in_use(keystore)


def test_both_cas_of_an_overlap_are_pinned_and_one_after_it(keystore):
    before = pins_in_use(keystore)
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY, name="Next")
    begin_overlap(keystore, terms, now=LATER, kept=keystore.unlock(None), passphrase=None)
    pinned = pins_in_use(keystore)
    assert {len(each) for each in pinned.values()} == {1, 2}
    assert Bundle.of(keystore, ["/talker"], now=LATER).fingerprints
    cancel_overlap(keystore, now=LATER)
    assert pins_in_use(keystore) == before


def test_the_list_that_an_overlap_ended_is_not_put_back(keystore):
    path = keystore.root / "public/identity_ca.crl.pem"
    before = path.read_bytes()
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY, name="Next")
    begin_overlap(keystore, terms, now=LATER, kept=keystore.unlock(None), passphrase=None)
    path.write_bytes(before)
    with pytest.raises(KeystoreError, match="by the ledger its CA has no list now"):
        Bundle.of(keystore, ["/talker"], now=LATER)


@pytest.mark.parametrize("file", ["public/identity_ca.crl.pem", "enclaves/governance.p7s"])
def test_no_participant_is_issued_beside_an_older_file(keystore, file):
    older = put_back(keystore, file)
    with pytest.raises(KeystoreError, match=r"is an older one: line \d+ of the ledger has"):
        add(older, more="0")
    assert not older.has("/more")


def test_the_hints_lead_out(keystore):
    older = put_back(keystore, "public/identity_ca.crl.pem")
    renew_list(older, older.unlock(None), now=LATER)
    add(older, more="0", now=LATER)
    older = put_back(older, "enclaves/governance.p7s")
    governance_again(older)
    assert Bundle.of(older, ["/more"], now=LATER).enclaves["/more"]["crl.pem"]


def test_a_governance_that_was_signed_by_hand_is_the_newest_then(keystore):
    path = keystore.root / "enclaves/governance.p7s"
    before, cas = path.read_bytes(), keystore.unlock(None)
    document = path.with_suffix(".xml").read_bytes()
    sign_document(keystore, Kind.GOVERNANCE, document, path, cas, now=LATER, force=True)
    assert Bundle.of(keystore, ["/talker"], now=LATER).enclaves["/talker"]["governance.p7s"]
    path.write_bytes(before)
    with pytest.raises(KeystoreError, match=r"governance\.p7s is not the newest governance"):
        Bundle.of(keystore, ["/talker"], now=LATER)


def test_permissions_that_were_signed_by_hand_are_the_newest_then(keystore):
    path = keystore.root / "enclaves/talker/permissions.p7s"
    before, cas = path.read_bytes(), keystore.unlock(None)
    document = path.with_suffix(".xml").read_bytes()
    sign_document(keystore, Kind.PERMISSIONS, document, path, cas, now=LATER, force=True)
    assert Bundle.of(keystore, ["/talker"], now=LATER)
    path.write_bytes(before)
    with pytest.raises(KeystoreError, match=r"permissions\.p7s is not the newest permissions"):
        Bundle.of(keystore, ["/talker"], now=LATER)


def test_an_answer_to_an_offline_request_has_no_older_list(keystore, tmp_path):
    asked = request("/third", keystore.profile, tmp_path / "r").request
    older = put_back(keystore, "public/identity_ca.crl.pem")
    spec = ParticipantSpec(name="/third", domains=DomainSet.of(0), validity=30 * DAY)
    made_of = SignRequest.from_bytes(SignRequest((asked,), (spec,)).to_bytes(now=NOW))
    with pytest.raises(KeystoreError, match="identity_ca"):
        sign(made_of, older, older.unlock(None), now=LATER)


@pytest.mark.parametrize("file", SHARED)
def test_a_report_shows_no_rights_by_an_older_file(keystore, file):
    older = put_back(keystore, file)
    found = report_of(older, now=LATER)
    assert found.rights is None
    assert any(file.rpartition("/")[2] in each.reason for each in found.gaps)


def test_who_may_leaves_out_older_permissions(keystore):
    older = put_back(keystore, "enclaves/talker/permissions.p7s")
    fleet = fleet_of((older.root,), None, LATER, SPEC)
    assert "is not the newest permissions" in fleet.refused["/talker"]
    assert [each.name for each in fleet.members] == ["/listener"]


def test_the_list_is_shown_as_the_ledger_has_it(keystore):
    older = put_back(keystore, "public/identity_ca.crl.pem")
    with CurrentFiles.of(older) as current, pytest.raises(KeystoreError, match="not the newest"):
        assert current.revocation_list
    (older.root / "public/identity_ca.crl.pem").unlink()
    with CurrentFiles.of(older) as current, pytest.raises(KeystoreError, match="is missing"):
        assert current.revocation_list
