"""What the plugin demands of a participant's files and of its peers' documents, without a stack."""

import shutil

import pytest

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority
from pqsec_pki.handshake import DataHolder
from pqsec_pki.smime import Require, Signer, document_in, sign, verify
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import RefusedError, Shim, properties, shaken, side

TOKEN = DataHolder("DDS:Access:Permissions:1.0")
SIGNED = ("governance.p7s", "permissions.p7s")
KEYS = {"classical": ("key.pem",), "transition": ("key.pem", "alt.key.pem"), "pq": ("key.pem",)}


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    root = tmp_path_factory.mktemp("k")
    return {profile: made(root / profile, profile) for profile in KEYS}


@pytest.fixture
def enclave(stores, tmp_path):
    """enclave(profile, name) is a copy of that participant's files."""

    def copy(profile, name="listener"):
        folder = stores[profile].root / "enclaves" / name
        return shutil.copytree(folder, tmp_path / f"{profile}-{name}", symlinks=False)

    return copy


def signed_by_one(keystore, message, *, half):
    """The document with one of its two signatures: of the permissions CA, or its countersigner."""
    authorities = keystore.unlock(None)
    ca, second = authorities.permissions, authorities.countersigner
    both = verify(message, ca.certificate, alternative_ca=second.certificate, require=Require.BOTH)
    signer = (ca, second)[half]
    return sign(both.document, Signer(signer.certificate, signer.key), now=NOW)


def accepted(folder):
    """Whether access control takes a participant with these files."""
    pairs, where = properties(folder)
    return Shim("access_control").call("validate_local_permissions", 1, 0, where, pairs)


def test_where_there_is_a_countersigner_both_signatures_are_demanded_of_own_documents(
    stores, enclave
):
    """Else whoever breaks the classical key signs for everybody, whatever the other one is for."""
    folder, taken = enclave("transition"), []
    assert accepted(folder)
    for file in SIGNED:
        message = (folder / file).read_bytes()
        for half in (0, 1):
            (folder / file).write_bytes(signed_by_one(stores["transition"], message, half=half))
            try:
                accepted(folder)
            except RefusedError:
                continue
            taken.append((file, half))
        (folder / file).write_bytes(message)
    assert taken == []
    assert accepted(folder)


def test_a_countersigner_with_a_classical_key_is_none_against_a_quantum_computer(enclave):
    """Two signatures of one kind fall together: of the two, one is post-quantum."""
    folder = enclave("classical")
    ca, second = (
        Authority.create(name, SIGNATURES.named("ecdsa-p256"), now=NOW, validity=DAY)
        for name in ("Permissions CA", "Second")
    )
    signers = [Signer(each.certificate, each.key) for each in (ca, second)]
    for file in SIGNED:
        text = document_in((folder / file).read_bytes())
        (folder / file).write_bytes(sign(text, signers[0], countersigner=signers[1], now=NOW))
    (folder / "permissions_ca.cert.pem").write_bytes(ca.certificate.pem)
    assert accepted(folder)
    (folder / "permissions_ca.alt.cert.pem").write_bytes(second.certificate.pem)
    with pytest.raises(RefusedError, match="there is no post-quantum signature"):
        accepted(folder)


def test_where_there_is_a_countersigner_both_signatures_are_demanded_of_peers(stores, enclave):
    folder = enclave("transition")
    shim, (pairs, where) = Shim("access_control"), properties(folder)
    shim.call("validate_local_permissions", 1, 0, where, pairs)
    message = (folder / "permissions.p7s").read_bytes()
    peers = [message, *(signed_by_one(stores["transition"], message, half=n) for n in (0, 1))]
    found = []
    for each in peers:
        items = (("c.id", (folder / "cert.pem").read_text()), ("c.perm", each.decode()))
        try:
            shim.call("validate_remote_permissions", 1, 2, TOKEN, DataHolder("", items))
        except RefusedError as refusal:
            found.append("signature" in str(refusal))
        else:
            found.append("taken")
    assert found == ["taken", True, True]


def test_a_key_that_is_not_the_certificates_is_refused_before_anything_is_signed(stores, enclave):
    """By the plugin: stock stacks find out when they meet somebody, or tell the peer's story."""
    wrong = []
    for profile, keys in KEYS.items():
        for key in keys:
            folder = enclave(profile)
            other = stores[profile].root / "enclaves/talker" / key
            (folder / key).write_bytes(other.read_bytes())
            try:
                side(folder)
            except RefusedError as refusal:
                if key not in str(refusal) or "key" not in str(refusal):
                    wrong.append((profile, key, str(refusal)))
            else:
                wrong.append((profile, key, "taken"))
            shutil.rmtree(folder)
    assert wrong == []


def test_a_key_of_another_kind_is_refused_too(stores, enclave):
    folder = enclave("pq")
    key = stores["classical"].root / "enclaves/listener/key.pem"
    (folder / "key.pem").write_bytes(key.read_bytes())
    with pytest.raises(RefusedError, match=r"key\.pem is not the key of CN=/listener"):
        side(folder)


def test_the_right_keys_are_taken(enclave):
    for profile in KEYS:
        assert shaken(side(enclave(profile)), side(enclave(profile, "talker")))
