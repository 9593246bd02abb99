"""What the plugin demands of a participant's files and of its peers' documents, without a stack."""

import shutil

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority
from pqsec_pki.credentials import NEEDED
from pqsec_pki.errors import FileError
from pqsec_pki.handshake import DataHolder
from pqsec_pki.plugin.credentials import certificates_below
from pqsec_pki.problems import Code
from pqsec_pki.smime import Require, Signer, document_in, sign, verify
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import RefusedError, Shim, properties, refusals, shaken, side

TOKEN = DataHolder("DDS:Access:Permissions:1.0")
SIGNED = ("governance.p7s", "permissions.p7s")
ALTERNATIVE = ("2.5.29.72", "2.5.29.73", "2.5.29.74")
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


def codes(folder, **more):
    """What the plugin says is wrong with the enclave."""
    return {code for refusal in refusals(folder, **more) for code in refusal.codes}


def test_a_transition_enclave_without_its_countersigner_is_refused_and_its_half_signed_documents(
    stores, enclave
):
    """Whether documents are signed twice is the identity CA's word, not a file's being there."""
    folder = enclave("transition")
    assert refusals(folder) == ()
    (folder / "permissions_ca.alt.cert.pem").unlink()
    assert Code.COUNTERSIGNER_MISSING in codes(folder)
    for file in SIGNED:
        message = (folder / file).read_bytes()
        (folder / file).write_bytes(signed_by_one(stores["transition"], message, half=0))
    assert codes(folder) == {Code.COUNTERSIGNER_MISSING, Code.SIGNATURE_MISSING}
    for call in (accepted, side):
        with pytest.raises(RefusedError, match="the countersigner is missing"):
            call(folder)
    (folder / "pqsec.toml").write_text('peers = "stock"')  # who says so wants less
    assert refusals(folder) == ()


def test_where_there_is_a_countersigner_both_signatures_are_demanded_of_own_documents(
    stores, enclave
):
    """Otherwise an attacker who breaks the classical key signs for every participant."""
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
    with pytest.raises(RefusedError, match=r"key\.pem: not the private key of the certificate"):
        side(folder)


def test_the_right_keys_are_taken(enclave):
    for profile in KEYS:
        assert shaken(side(enclave(profile)), side(enclave(profile, "talker")))


def test_every_flaw_of_an_enclave_is_told_by_its_code(stores, enclave):
    """What is refused, and for which reason, is what all of pqsec says of those files."""

    def public(profile, file):
        return (stores[profile].root / "public" / file).read_bytes()

    def put(file, content):
        return lambda folder: (folder / file).write_bytes(content)

    ca, permissions = (public("pq", f"{name}_ca.cert.pem") for name in ("identity", "permissions"))
    stranger = made(stores["pq"].root.parent / "other", "pq").root / "public"
    other = (stranger / "identity_ca.cert.pem").read_bytes()
    talker = stores["pq"].root / "enclaves/talker"
    flaws = {
        "one key in two roles": (put("permissions_ca.cert.pem", ca), Code.ONE_KEY_TWO_ROLES),
        "the permissions CA issues too": (
            put("identity_ca.cert.pem", ca + permissions),
            Code.ONE_KEY_TWO_ROLES,
        ),
        "a CA twice": (put("identity_ca.cert.pem", ca + ca), Code.CA_DOUBLED),
        "another CA": (put("identity_ca.cert.pem", other), Code.BAD_SIGNATURE),
        "two signers": (put("permissions_ca.cert.pem", permissions + other), Code.FILE_MALFORMED),
        "a chain": (
            put("cert.pem", (talker / "cert.pem").read_bytes() + ca),
            Code.FILE_MALFORMED,
        ),
        "another's key": (put("key.pem", (talker / "key.pem").read_bytes()), Code.KEY_MISMATCH),
        "another's permissions": (
            put("permissions.p7s", (talker / "permissions.p7s").read_bytes()),
            Code.NO_GRANT,
        ),
        "not signed": (put("governance.p7s", b"<dds/>"), Code.NOT_SIGNED),
        "no list": (put("crl.pem", b"x"), Code.FILE_MALFORMED),
    } | {
        f"no {file}": (lambda folder, file=file: (folder / file).unlink(), Code.FILE_MISSING)
        for file in (*NEEDED, "key.pem")
    }
    wrong = {}
    for name, (spoil, code) in flaws.items():
        folder = enclave("pq")
        spoil(folder)
        if code not in codes(folder):
            wrong[name] = codes(folder)
        shutil.rmtree(folder)
    assert wrong == {}


def test_a_ca_that_has_expired_is_told_by_either_call(enclave):
    folder = enclave("classical")
    found = refusals(folder, NOW + 901 * DAY)
    assert [Code.EXPIRED in each.codes for each in found] == [True, True]


def test_a_trusted_ca_that_is_not_good_keeps_no_participant_from_starting(stores, enclave):
    """It is passed over; but one that signs documents here must not issue certificates too."""
    folder, short = enclave("classical"), enclave("pq")
    trusted = folder / "trusted"
    trusted.mkdir()
    name = SIGNATURES.named("ecdsa-p256")
    ended = Authority.create("Ended", name, now=NOW - 9 * DAY, validity=DAY)
    (trusted / "ended.pem").write_bytes(ended.certificate.pem)
    for source in (folder, short):
        data = (source / "identity_ca.cert.pem").read_bytes()
        (trusted / f"{source.name}.pem").write_bytes(data)
    more = {"dds.sec.auth.trusted_ca_dir": str(trusted)}
    assert refusals(folder, **more) == ()
    (trusted / "two.pem").write_bytes((folder / "permissions_ca.cert.pem").read_bytes())
    assert codes(folder, **more) == {Code.ONE_KEY_TWO_ROLES}
    (trusted / "two.pem").write_bytes(ended.certificate.pem * 2)
    assert codes(folder, **more) == {Code.FILE_MALFORMED}


def test_a_folder_of_trusted_cas_has_at_most_64_files(tmp_path):
    for number in range(64):
        (tmp_path / f"{number}").touch()
    assert certificates_below(tmp_path) == ()
    (tmp_path / "64").touch()
    with pytest.raises(FileError, match="more than 64 files"):
        certificates_below(tmp_path)


def test_an_alternative_key_that_no_alternative_signature_vouches_for_is_refused(stores, enclave):
    """Else a participant starts that signs with two keys, and can meet nobody."""
    folder, authority = enclave("transition"), stores["transition"].unlock(None).identity
    found = x509.load_der_x509_certificate(authority.certificate.der)
    builder = x509.CertificateBuilder(
        issuer_name=found.issuer,
        subject_name=found.subject,
        public_key=found.public_key(),
        serial_number=1,
        not_valid_before=found.not_valid_before_utc,
        not_valid_after=found.not_valid_after_utc,
        extensions=[each for each in found.extensions if each.oid.dotted_string not in ALTERNATIVE],
    )
    key = (stores["transition"].root / "private/identity_ca.key.pem").read_bytes()
    plain = builder.sign(load_pem_private_key(key, None), hashes.SHA256())
    (folder / "identity_ca.cert.pem").write_bytes(plain.public_bytes(Encoding.PEM))
    assert codes(folder) == {Code.ALTERNATIVE_MISSING}
    (folder / "pqsec.toml").write_text('peers = "stock"')
    assert refusals(folder) == ()
