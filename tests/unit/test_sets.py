"""A keystore with several sets of credentials: what they share, and what none has of another."""

import json
import shutil
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Reason
from pqsec_pki.documents import DomainSet, Governance, Kind
from pqsec_pki.errors import (
    ExistsError,
    FileError,
    KeystoreError,
    PassphraseError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    audit,
    change,
    layout,
    read_head,
    stage_governance,
    status,
)
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Renewal,
    add_set,
    adopt,
    changed_permissions,
    issue,
    renew,
    renew_list,
    revoke,
    sign_changed,
    sign_document,
    sign_governance,
    sign_permissions,
)
from pqsec_pki.lifecycle._key_checks import refuse_shared
from pqsec_pki.lint import check
from tests.unit.keystores import DAY, NOW
from tests.unit.killing import copies, fails, survives

CLASSICAL, HYBRID, PQ = map(profile_named, ("classical", "hybrid", "pq"))


def create(root, *profiles):
    return Keystore.create(
        root,
        *(profiles or (CLASSICAL, HYBRID)),
        name="Lab",
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )


@pytest.fixture
def keystore(tmp_path):
    return create(tmp_path / "k")


def rewritten(keystore, **changes):
    """The settings of the keystore with these changes, as somebody who may write it makes them."""
    path = keystore.root / layout.SETTINGS
    path.write_text(json.dumps(json.loads(path.read_bytes()) | changes))


def test_the_first_set_lies_where_a_keystore_lies_and_each_other_in_a_folder_of_its_own(keystore):
    first, second = keystore.sets
    assert (first.folder, second.folder) == (keystore.root, keystore.root / "sets/hybrid")
    assert (first.profile, second.profile) == (CLASSICAL, HYBRID)
    for each in (first, second):
        assert each.identity_ca.public_key.algorithm is each.profile.identity_key
        assert each.permissions_ca.public_key.algorithm is each.profile.permissions_key
    assert not (second.folder / "private/ledger.sqlite3").exists()
    assert Keystore.open(keystore.root).sets == keystore.sets


def test_the_cas_of_all_sets_have_distinct_names_and_keys(tmp_path):
    keystore = create(tmp_path / "k", CLASSICAL, HYBRID, PQ)
    cas = [ca for each in keystore.sets for ca in (each.identity_ca, each.permissions_ca)]
    assert len({each.subject_name for each in cas}) == len({each.spki for each in cas}) == 6
    assert keystore.sets[1].identity_ca.subject_name == "CN=Lab hybrid Identity CA"


def test_the_governance_of_all_sets_is_the_same_octet_for_octet(keystore):
    first, second = (
        (each.folder / "enclaves/governance.xml").read_bytes() for each in keystore.sets
    )
    assert first == second
    for each in keystore.sets:
        assert each.anchors.signed(each.governance).document.replace(b"\r\n", b"\n") == first


def test_a_profile_is_given_once(tmp_path):
    with pytest.raises(UsageError, match="classical is given twice"):
        create(tmp_path / "k", CLASSICAL, HYBRID, CLASSICAL)
    assert not (tmp_path / "k").exists()


def test_the_permissions_cas_of_all_sets_sign_the_head_of_the_one_ledger(keystore):
    head = read_head(keystore.root)
    for each in keystore.sets:
        head.verify([each.permissions_ca.public_key])
    assert head.head.size == len(keystore.lines()) == 6


def test_a_head_that_lacks_the_signature_of_one_set_is_refused(keystore):
    path = keystore.root / "public/ledger.checkpoint"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-1]))
    with pytest.raises(KeystoreError, match="cannot be compared with its signed head"):
        keystore.open_ledger()


@pytest.mark.parametrize("profiles", [(CLASSICAL,), (CLASSICAL, PQ), (CLASSICAL, HYBRID, PQ)])
def test_settings_with_other_sets_than_the_ledger_has_decide_nothing(keystore, profiles):
    rewritten(keystore, algorithms=[each.to_names() for each in profiles])
    with pytest.raises(KeystoreError, match=r"pqsec\.json"):
        Keystore.open(keystore.root).open_ledger()
    with pytest.raises(KeystoreError), change(keystore.root):
        pass


def test_the_lines_of_a_set_are_not_those_of_another(keystore):
    found = {}
    for each in keystore.sets:
        with each.open_ledger() as ledger:
            for kind in ("identity-ca", "permissions-ca", "governance"):
                [line] = ledger.of_kind(kind)
                assert ledger.newest(kind) == [line]
                assert line.set_name == each.set_name
                found[each.set_name, kind] = line.sha256
    assert len({*found.values()}) == 6


def test_lines_about_the_whole_keystore_are_of_every_set(keystore):
    with change(keystore.root) as transaction:
        transaction.of("hybrid").record(Entry.of("token", "t", "0" * 64, NOW))
    for each in keystore.sets:
        with each.open_ledger() as ledger:
            assert ledger.of_kind("token")


def test_keys_of_two_cas_in_two_sets_are_refused_when_they_are_opened(keystore):
    first, second = keystore.sets
    for name in ("identity_ca.key.pem",):
        (second.folder / "private" / name).write_bytes(
            (first.folder / "private" / name).read_bytes()
        )
    public = second.folder / "public/identity_ca.cert.pem"
    public.write_bytes((first.folder / "public/identity_ca.cert.pem").read_bytes())
    with pytest.raises(KeystoreError, match="the same key"):
        keystore.unlock(None)


def test_a_change_with_cas_of_fewer_sets_is_refused(keystore):
    authorities = keystore.unlock(None)
    only = Authorities(
        identity=authorities.identity,
        permissions=authorities.permissions,
        countersigner=None,
        embed_certificate=True,
    )
    with (
        pytest.raises(KeystoreError, match="other sets of credentials"),
        change(keystore.root, only),
    ):
        pass


@pytest.mark.parametrize("file", ["identity_ca.key.pem", "permissions_ca.key.pem"])
def test_a_missing_ca_key_of_a_further_set_is_not_passed_over(keystore, file):
    (keystore.sets[1].folder / "private" / file).unlink()
    with pytest.raises(KeystoreError, match="private key is not here"):
        keystore.unlock(None)


# Issuing, renewing and revoking: in all sets, by one change


LATER = NOW + 30 * DAY
TWO = ("/listener", "/talker")


def spec(name, **others):
    return ParticipantSpec(
        name=name,
        domains=DomainSet.of(0),
        publish=("chatter",),
        validity=others.pop("validity", 90 * DAY),
        **others,
    )


def issued(keystore, *names, now=NOW, **others):
    specs = [spec(name) for name in names or TWO]
    return issue(keystore, keystore.unlock(None), specs, now=now, **others)


def texts(keystore, place):
    """The different contents of a file in all sets."""
    return {(each.folder / place).read_bytes() for each in keystore.sets}


def one_meaning_but_numbers(keystore, *names, now=LATER):
    one_meaning(keystore, *names, now=now, one_number=False)


def one_meaning(keystore, *names, now=NOW, one_number=True):
    """That all sets have credentials that say the same, and share no key and no issuer."""
    found = [each.verified(name, now=now) for name in names for each in keystore.sets]
    assert len(found) == len(names) * len(keystore.sets)
    assert len(texts(keystore, "enclaves/governance.xml")) == 1
    for name in names:
        assert len(texts(keystore, f"enclaves{name}/permissions.xml")) == 1
        mine = [each.participant(name) for each in keystore.sets]
        assert len({each.certificate.subject_der for each in mine}) == 1
        assert len({each.certificate.not_after for each in mine}) == 1
        assert len({each.certificate.issuer_der for each in mine}) == len(mine)
        assert not one_number or len({each.certificate.number for each in mine}) == 1
        assert len({each.certificate.spki for each in mine}) == len(mine)
        for view in keystore.sets:
            signed = (view.folder / f"enclaves{name}/permissions.p7s").read_bytes()
            document = view.anchors.signed(signed).document.replace(b"\r\n", b"\n")
            assert {document} == texts(keystore, f"enclaves{name}/permissions.xml")
    audit(keystore)


def test_a_participant_is_issued_in_all_sets_with_one_meaning(keystore):
    found = issued(keystore)
    assert [each.profile for each in found[0].sets] == ["classical", "hybrid"]
    one_meaning(keystore, *TWO)
    certificates = [each.participant("/talker").certificate for each in keystore.sets]
    assert [each.public_key.algorithm for each in certificates] == [
        CLASSICAL.participant_key,
        HYBRID.participant_key,
    ]


def test_three_sets_have_one_meaning_too(tmp_path):
    keystore = create(tmp_path / "k", CLASSICAL, HYBRID, PQ)
    issued(keystore)
    one_meaning(keystore, *TWO)


def test_many_participants_made_by_several_processes_have_one_meaning(keystore):
    names = [f"/robot{number}" for number in range(40)]
    issued(keystore, *names)
    one_meaning(keystore, *names)


def test_certificates_of_all_sets_end_with_the_first_of_their_cas(tmp_path):
    keystore = create(tmp_path / "k", CLASSICAL)
    add_set(keystore, keystore.unlock(None), HYBRID, validity=40 * DAY, passphrase=None, now=NOW)
    keystore = Keystore.open(keystore.root, to_change=True)
    [made] = issue(keystore, keystore.unlock(None), [spec("/talker")], now=LATER)
    assert made.shortened
    one_meaning(keystore, "/talker", now=LATER)
    renew(keystore, keystore.unlock(None), ["/talker"], Renewal(validity=90 * DAY), now=LATER)
    one_meaning(keystore, "/talker", now=LATER)


def test_an_enclave_of_one_set_has_links_into_that_set_only(keystore):
    issued(keystore)
    second = keystore.sets[1].folder
    for link in (second / "enclaves/talker").iterdir():
        if link.is_symlink():
            assert link.resolve().is_relative_to(second.resolve())


def test_none_is_issued_if_a_further_set_cannot(keystore):
    authorities = keystore.unlock(None)
    (keystore.sets[1].folder / "enclaves/talker").write_bytes(b"")
    before = keystore.head
    with pytest.raises(KeystoreError):
        issue(keystore, authorities, [spec("/talker")], now=NOW)
    assert keystore.head == before
    assert keystore.names() == []


def test_files_of_a_participant_in_a_further_set_are_not_overwritten_without_force(keystore):
    issued(keystore)
    for path in (keystore.root / "enclaves/talker").iterdir():
        path.unlink()
    with pytest.raises(ExistsError, match="/talker"):
        issued(keystore, "/talker")
    issued(keystore, "/talker", force=True, now=LATER)
    one_meaning(keystore, "/talker", now=LATER)


@pytest.mark.parametrize("rekey", [None, False, True])
def test_a_renewal_is_of_all_sets(keystore, rekey):
    issued(keystore)
    before = [each.participant("/talker").certificate for each in keystore.sets]
    renew(keystore, keystore.unlock(None), ["/talker"], Renewal(rekey=rekey), now=LATER)
    one_meaning(keystore, "/talker", now=LATER)
    for each, old in zip(keystore.sets, before, strict=True):
        new = each.participant("/talker").certificate
        assert new.der != old.der
        assert (new.spki == old.spki) is (rekey is False)


def test_nothing_is_renewed_if_a_file_of_a_further_set_is_not_the_newest(keystore):
    issued(keystore)
    other = keystore.sets[1].folder / "enclaves"
    (other / "talker/cert.pem").write_bytes((other / "listener/cert.pem").read_bytes())
    before = keystore.head
    with pytest.raises(KeystoreError, match=r"sets/hybrid/enclaves/talker/cert\.pem"):
        renew(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    assert keystore.head == before


def test_changed_rights_are_signed_in_all_sets(keystore):
    issued(keystore)
    authorities = keystore.unlock(None)
    sign_permissions(
        keystore, authorities, [replace(spec("/talker"), publish=("other",))], now=LATER
    )
    one_meaning(keystore, *TWO, now=LATER)
    found = changed_permissions(keystore, ["/talker"], lambda _, grant: grant, now=LATER)
    sign_changed(keystore, authorities, found, now=LATER)
    one_meaning(keystore, *TWO, now=LATER)


def test_a_governance_is_signed_in_all_sets(keystore):
    issued(keystore)
    before = texts(keystore, "enclaves/governance.xml")
    weaker = Governance.from_xml(next(iter(before)))
    rule = replace(weaker.domain_rules[0], allow_unauthenticated_participants=True)
    sign_governance(
        keystore, keystore.unlock(None), replace(weaker, domain_rules=(rule,)), now=LATER
    )
    assert texts(keystore, "enclaves/governance.xml") != before
    one_meaning(keystore, *TWO, now=LATER)


@pytest.mark.parametrize(
    ("kind", "place"),
    [(Kind.GOVERNANCE, "enclaves"), (Kind.PERMISSIONS, "enclaves/talker")],
)
def test_a_document_that_is_signed_in_its_place_is_signed_in_all_sets(keystore, kind, place):
    issued(keystore)
    path = keystore.root / place / f"{kind.value}.xml"
    document = path.read_bytes().replace(b"</dds>", b"<!-- edited --></dds>")
    sign_document(
        keystore,
        kind,
        document,
        path.with_suffix(".p7s"),
        keystore.unlock(None),
        now=LATER,
        force=True,
    )
    one_meaning(keystore, *TWO, now=LATER)


def test_a_revoked_participant_is_in_the_lists_of_all_sets_with_one_number(keystore):
    issued(keystore)
    revoked, made = revoke(
        keystore, keystore.unlock(None), ["/talker"], reason=Reason.KEY_COMPROMISE, now=LATER
    )
    assert len(revoked) == 2
    assert all(each.listed for each in revoked)
    lists = [each.revocation_list for each in keystore.sets]
    assert [each.number for each in lists] == [made.number] * 2
    for each, view in zip(lists, keystore.sets, strict=True):
        each.verify(view.identity_ca)
        [gone] = each.revoked
        assert gone.serial_number == view.participant("/talker").certificate.serial_number
        assert (view.folder / "enclaves/listener/crl.pem").resolve().is_relative_to(view.folder)
        with pytest.raises(VerificationError, match="revoked"):
            view.verified("/talker", now=LATER)
    audit(keystore)


def test_one_certificate_is_revoked_in_its_set_and_all_lists_are_issued(keystore):
    issued(keystore)
    serial = keystore.sets[1].participant("/talker").certificate.serial_number
    revoked, _ = revoke(keystore, keystore.unlock(None), [f"{serial:x}"], now=LATER)
    assert [each.listed for each in revoked] == [True]
    first, second = (each.revocation_list for each in keystore.sets)
    assert (len(first.revoked), len(second.revoked)) == (0, 1)
    assert first.number == second.number


def test_a_certificate_in_a_file_is_revoked_in_the_set_that_issued_it(keystore):
    issued(keystore)
    given = keystore.sets[1].participant("/talker").certificate
    revoke(keystore, keystore.unlock(None), [], certificates=[given], now=LATER)
    assert [len(each.revocation_list.revoked) for each in keystore.sets] == [0, 1]


def test_replaced_certificates_of_all_sets_are_revoked(keystore):
    issued(keystore)
    authorities = keystore.unlock(None)
    renew(keystore, authorities, ["/talker"], now=LATER)
    revoked, _ = revoke(keystore, authorities, ["/talker"], superseded=True, now=LATER)
    assert len(revoked) == 2
    one_meaning(keystore, *TWO, now=LATER)


def test_lists_are_issued_together_also_by_a_renewal(keystore):
    issued(keystore)
    authorities = keystore.unlock(None)
    renew_list(keystore, authorities, now=NOW, validity=10 * DAY)
    renew(keystore, authorities, ["/talker"], Renewal(due=60 * DAY), now=NOW + DAY)
    assert [each.revocation_list.number for each in keystore.sets] == [2, 2]
    one_meaning(keystore, *TWO, now=NOW + DAY)


def test_a_list_of_a_set_that_was_lost_does_not_stop_the_others_and_comes_back(keystore):
    issued(keystore)
    authorities = keystore.unlock(None)
    revoke(keystore, authorities, ["/talker"], now=NOW)
    (keystore.sets[1].folder / "public/identity_ca.crl.pem").unlink()
    renew_list(keystore, authorities, now=LATER)
    lists = [each.revocation_list for each in keystore.sets]
    assert [(each.number, len(each.revoked)) for each in lists] == [(2, 1), (2, 1)]


@pytest.mark.parametrize("file", ["enclaves/governance.p7s", "public/identity_ca.crl.pem"])
def test_with_an_older_file_of_a_further_set_nothing_is_issued(keystore, file):
    authorities, path = keystore.unlock(None), keystore.sets[1].folder / file
    renew_list(keystore, authorities, now=NOW)
    older = path.read_bytes()
    renew_list(keystore, authorities, now=LATER)
    governance = Governance.from_xml((keystore.root / "enclaves/governance.xml").read_bytes())
    sign_governance(keystore, authorities, governance, now=LATER)
    path.write_bytes(older)
    with pytest.raises(KeystoreError, match="is an older one"):
        issued(keystore, now=LATER)


def test_a_key_of_another_set_is_not_certified(keystore):
    """By the ledger, which knows the keys of all sets."""
    issued(keystore)
    key = keystore.participant("/talker").certificate.public_key
    with keystore.sets[1].open_ledger() as ledger:
        with pytest.raises(VerificationError, match="another set"):
            refuse_shared(ledger, {"/talker": [key]}, NOW)
        with pytest.raises(VerificationError, match="its key is that of /talker"):
            refuse_shared(ledger, {"/other": [key]}, NOW)
    with keystore.open_ledger() as ledger:
        refuse_shared(ledger, {"/talker": [key]}, NOW)


# What is missing is a fault, and nothing is concluded from what lies there


def states(keystore, now=LATER):
    found = status(keystore, now=now, compare_files=True)
    return {each.name: str(each.state) for each in found.participants}


def test_a_complete_participant_has_one_state(keystore):
    issued(keystore)
    assert states(keystore) == dict.fromkeys(TWO, "valid")
    found = status(keystore, now=LATER)
    assert [(each.kind, each.set_name) for each in found.shared] == [
        (kind, name) for name in ("", "hybrid") for kind in ("identity-ca", "permissions-ca")
    ]


@pytest.mark.parametrize("number", [0, 1])
def test_a_participant_without_its_folder_in_one_set_is_incomplete(keystore, number):
    issued(keystore)
    shutil.rmtree(keystore.sets[number].folder / "enclaves/talker")
    assert states(keystore) == {"/listener": "valid", "/talker": "incomplete"}


def test_a_participant_that_is_revoked_in_one_set_is_incomplete(keystore):
    issued(keystore)
    serial = keystore.sets[1].participant("/talker").certificate.serial_number
    revoke(keystore, keystore.unlock(None), [f"{serial:x}"], now=NOW)
    assert states(keystore) == {"/listener": "valid", "/talker": "incomplete"}


def test_what_is_to_be_issued_again_does_not_stop_the_renewal_of_others(keystore):
    issued(keystore)
    shutil.rmtree(keystore.sets[1].folder / "enclaves/talker")
    now = NOW + 80 * DAY
    assert states(keystore, now) == {"/listener": "due", "/talker": "incomplete"}
    due = status(keystore, now=now).due
    assert due == ["/listener"]
    renew(keystore, keystore.unlock(None), due, now=now)
    one_meaning(keystore, "/listener", now=now)


def test_a_list_that_is_gone_in_one_set_is_seen(keystore):
    renew_list(keystore, keystore.unlock(None), now=NOW)
    (keystore.sets[1].folder / "public/identity_ca.crl.pem").unlink()
    assert status(keystore, now=LATER).revocation_list.state == "gone"
    renew(keystore, keystore.unlock(None), [], now=LATER)
    assert [each.revocation_list.number for each in keystore.sets] == [2, 2]


@pytest.mark.parametrize("file", ["public/identity_ca.cert.pem", "public/permissions_ca.cert.pem"])
def test_without_a_ca_of_a_further_set_there_is_no_status(keystore, file):
    (keystore.sets[1].folder / file).unlink()
    with pytest.raises((FileError, KeystoreError), match=f"sets/hybrid/{file}"):
        status(keystore, now=LATER)


def test_an_audit_sees_files_of_a_further_set_without_a_line(keystore):
    issued(keystore)
    second = keystore.sets[1].folder / "enclaves"
    (second / "talker/permissions.p7s").write_bytes(
        (keystore.root / "enclaves/talker/permissions.p7s").read_bytes()
    )
    with pytest.raises(VerificationError, match=r"sets/hybrid/enclaves/talker/permissions\.p7s"):
        audit(keystore)


def test_an_audit_sees_a_set_that_was_taken_out_of_the_settings(keystore):
    rewritten(keystore, algorithms=[CLASSICAL.to_names()])
    with pytest.raises(VerificationError, match="lacks the set of credentials hybrid"):
        audit(Keystore.open(keystore.root))


def findings(keystore, now=LATER):
    found = check([keystore.root], now=now).findings
    return {(each.rule.id, str(each.path.relative_to(keystore.root))) for each in found}


UNENCRYPTED = {
    ("PQS707", f"{folder}private/{role}_ca.key.pem")
    for folder in ("", "sets/hybrid/")
    for role in ("identity", "permissions")
}
"""For tests: the keys are not encrypted."""


def test_a_check_finds_nothing_wrong_with_several_sets(keystore):
    issued(keystore)
    nobody_subscribes = ("PQS345", "enclaves/listener/permissions.p7s")
    assert findings(keystore) == {*UNENCRYPTED, nobody_subscribes}


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    "file",
    [
        *("enclaves/governance.p7s", "public/identity_ca.crl.pem", "public/identity_ca.cert.pem"),
        *("enclaves/talker/cert.pem", "enclaves/talker/permissions.p7s"),
    ],
)
def test_a_check_finds_what_is_missing_in_one_set(keystore, number, file):
    issued(keystore)
    renew_list(keystore, keystore.unlock(None), now=NOW)
    path = keystore.sets[number].folder / file
    path.unlink()
    assert ("PQS010", str(path.relative_to(keystore.root))) in findings(keystore)


def test_a_check_finds_a_set_that_is_gone(keystore):
    issued(keystore)
    shutil.rmtree(keystore.root / "sets")
    assert ("PQS010", "sets/hybrid/public/identity_ca.cert.pem") in findings(keystore)


@pytest.mark.parametrize("place", ["enclaves/governance", "enclaves/talker/permissions"])
def test_a_check_finds_a_document_that_says_something_else_in_one_set(keystore, place):
    issued(keystore)
    second = keystore.sets[1].folder
    document = (second / f"{place}.xml").read_bytes().replace(b"<dds ", b"<dds  ")
    signed = keystore.unlock(None).sets[1].sign(document, number=99, now=NOW)
    (second / f"{place}.p7s").write_bytes(signed)
    assert ("PQS010", f"sets/hybrid/{place}.p7s") in findings(keystore)


# Adding a set to a keystore that runs


@pytest.fixture
def running(tmp_path):
    """A keystore with one set, two participants and a revocation list."""
    keystore = create(tmp_path / "running", CLASSICAL)
    issued(keystore, *TWO, "/gone")
    revoke(keystore, keystore.unlock(None), ["/gone"], now=NOW)
    return keystore


def added(keystore, profile=HYBRID, now=LATER, **others):
    return add_set(
        keystore,
        keystore.unlock(None),
        profile,
        validity=900 * DAY,
        passphrase=None,
        now=now,
        **others,
    )


def files_of(folder):
    """The content of each file, and the target of each link, below these folders of a set."""
    return {
        str(path.relative_to(folder)): path.readlink() if path.is_symlink() else path.read_bytes()
        for part in ("public", "private", "enclaves")
        for path in sorted((folder / part).rglob("*"))
        if path.is_symlink() or path.is_file()
    }


ABOUT_THE_LEDGER = {
    *("private/ledger.sqlite3", "public/ledger.checkpoint", "public/ledger.tree"),
    "private/seen.json",
}


def test_adding_a_set_changes_no_octet_of_the_files_of_the_first_set(running):
    before = files_of(running.root)
    found = added(running)
    after = files_of(running.root)
    assert before.keys() == after.keys()
    assert {each for each in before if before[each] != after[each]} <= ABOUT_THE_LEDGER
    assert [each.name for each in found.issued] == list(TWO)
    assert found.left == ()


def test_an_added_set_has_the_meaning_of_the_first_one(running):
    added(running)
    keystore = Keystore.open(running.root, to_change=True)
    assert [each.profile for each in keystore.sets] == [CLASSICAL, HYBRID]
    one_meaning_but_numbers(keystore, *TWO)
    lists = [each.revocation_list for each in keystore.sets]
    assert [each.number for each in lists] == [1, 1]
    assert states(keystore) == {
        "/gone": "revoked",
        **dict.fromkeys(TWO, "valid"),
    }


def test_from_then_on_all_sets_change_together(running):
    added(running)
    keystore = Keystore.open(running.root, to_change=True)
    authorities, later = keystore.unlock(None), LATER + DAY
    renew(keystore, authorities, ["/talker"], now=later)
    one_meaning(keystore, "/talker", now=later)
    issue(keystore, authorities, [spec("/new")], now=later)
    one_meaning(keystore, "/new", now=later)
    revoke(keystore, authorities, ["/listener"], now=later)
    assert [each.revocation_list.number for each in keystore.sets] == [2, 2]
    assert [len(each.revocation_list.revoked) for each in keystore.sets] == [2, 1]


def test_a_third_set_is_added_too(running):
    added(running)
    keystore = Keystore.open(running.root, to_change=True)
    before = [files_of(each.folder) for each in keystore.sets]
    added(keystore, PQ)
    changed = {
        each
        for old, view in zip(before, keystore.sets, strict=True)
        for each, data in files_of(view.folder).items()
        if old[each] != data
    }
    assert changed <= ABOUT_THE_LEDGER
    one_meaning_but_numbers(Keystore.open(running.root), *TWO)


def test_a_participant_whose_key_is_elsewhere_is_left_and_seen(running):
    (running.root / "enclaves/talker/key.pem").unlink()
    found = added(running)
    assert found.left == ("/talker",)
    keystore = Keystore.open(running.root, to_change=True)
    assert states(keystore)["/talker"] == "incomplete"
    assert states(keystore, NOW + 80 * DAY)["/talker"] == "due"
    renew(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    assert not (keystore.sets[1].folder / "enclaves/talker").exists()


def test_a_set_that_is_there_is_not_added(running):
    with pytest.raises(ExistsError, match="a set of profile classical already"):
        added(running, CLASSICAL)


def test_a_folder_that_lies_in_the_place_of_a_set_is_not_taken_for_it(running):
    (running.root / "sets/hybrid/enclaves/talker").mkdir(parents=True)
    with pytest.raises(ExistsError, match="is not a set of this keystore"):
        added(running)
    with pytest.raises(ExistsError, match="already has"):
        create(running.root)


def test_a_keystore_with_sets_that_lost_its_settings_is_not_adopted(keystore):
    (keystore.root / "pqsec.json").unlink()
    with pytest.raises(KeystoreError, match="which would be left behind"):
        adopt(keystore.root, now=LATER)


@pytest.mark.parametrize("folder", ["", "/hybrid", "/hybrid/public", "/hybrid/private"])
def test_a_further_set_that_others_could_change_is_not_changed(keystore, folder):
    (keystore.root / f"sets{folder}").chmod(0o777)
    with pytest.raises(KeystoreError, match=f"sets{folder}"):
        Keystore.open(keystore.root, to_change=True)


def test_a_document_that_pqsec_would_write_otherwise_stops_the_addition(running):
    path = running.root / "enclaves/governance.xml"
    authorities = running.unlock(None)
    document = path.read_bytes().replace(b"<domain_access_rules>", b"<domain_access_rules >")
    with change(running.root, authorities) as transaction:
        stage_governance(transaction.of(""), authorities, document, now=NOW)
    before = files_of(running.root)
    with pytest.raises(KeystoreError, match="has another form than pqsec writes") as refused:
        added(running)
    assert "sign-governance" in refused.value.hint
    assert files_of(running.root) == before
    assert not (running.root / "sets").exists()


def test_the_new_cas_keep_the_passphrase_and_have_names_of_their_own(tmp_path):
    keystore = Keystore.create(
        tmp_path / "k",
        CLASSICAL,
        name="Lab",
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=b"secret words",
        now=NOW,
    )
    authorities = keystore.unlock(b"secret words")
    choices = {"validity": 900 * DAY, "passphrase": b"secret words", "now": NOW}
    add_set(keystore, authorities, HYBRID, **choices)
    opened = Keystore.open(tmp_path / "k", to_change=True)
    assert opened.is_locked()
    assert opened.sets[1].identity_ca.subject_name == "CN=Lab hybrid Identity CA"
    with pytest.raises(PassphraseError):
        opened.unlock(b"other")
    opened.unlock(b"secret words")


# All or none, wherever the process dies


@pytest.mark.parametrize("trial", [survives, fails], ids=["killed", "disk refuses"])
@pytest.mark.parametrize(
    "work",
    [
        pytest.param(lambda keystore: issued(keystore, "/new", now=LATER), id="issue"),
        pytest.param(
            lambda keystore: revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER),
            id="revoke",
        ),
        pytest.param(lambda keystore: added(keystore, PQ), id="add"),
    ],
)
def test_a_change_is_made_in_all_sets_or_in_none(running, place, trial, work):
    added(running)
    outcomes = []
    disturbed = copies(
        place, running.root, lambda root: work(Keystore.open(root, to_change=True)), trial, every=13
    )
    for root, _ in disturbed:
        Keystore.recover(root)
        keystore = Keystore.open(root, to_change=True)
        audit(keystore)
        made = [
            (each.has("/new"), each.revocation_list.number, len(keystore.sets))
            for each in keystore.sets
        ]
        assert len({*made}) == 1
        one_meaning_but_numbers(keystore, *(["/new"] if made[0][0] else []))
        outcomes.append(made[0])
    assert len({*outcomes}) == 2
