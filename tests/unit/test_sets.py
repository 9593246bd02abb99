"""A keystore with several sets of credentials: what they share, and what none has of another."""

import json

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Authorities, Entry, Keystore, change, layout, read_head
from tests.unit.keystores import DAY, NOW

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
