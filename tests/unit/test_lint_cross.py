"""The rules about what must fit together: each sees its flaw in a keystore that was sound."""

import base64
import re
import shutil
from dataclasses import replace
from datetime import timedelta

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, padding
from cryptography.hazmat.primitives.serialization import pkcs7

from pqsec_pki._asn1 import ContentInfo, Oid, algorithm, encode
from pqsec_pki.algorithms import PROFILES, SIGNATURES, load_private_key, pem
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.documents import DefaultAction, DomainSet, Governance, Permissions
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint import check
from pqsec_pki.smime import Signer, document_in, sign, signers_in
from pqsec_pki.smime._cms import SIGNED_DATA, parse
from pqsec_pki.smime._mime import split
from pqsec_pki.stacks import Stack
from pqsec_pki.tokens import reference_to
from pqsec_pki.vendors.enclave import StackEnclave
from tests.some_keys import rsa_key
from tests.unit.keystores import DAY, NOW, TWO, made
from tests.unit.linting import TALKER, Lab, certificate, found, p256
from tests.unit.signed_files import CONSTRUCTIONS

GOVERNANCE = "enclaves/governance.p7s"
P7S = f"{TALKER}/permissions.p7s"


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path, "classical")


def other(lab, profile="classical"):
    """The same keystore made again, with other keys."""
    return made(lab.root.parent / "other", profile).root


# What keystores are made of


@pytest.mark.parametrize("profile", [profile.name for profile in PROFILES])
@pytest.mark.parametrize("target", [None, Stack.ROS2])
def test_a_keystore_of_ours_has_no_flaw(tmp_path, profile, target):
    lab = Lab(tmp_path, profile)
    pq_only = {"hybrid", "pq", "cnsa2"} if target else set()
    expected = {"PQS601", "PQS602"} if profile in pq_only else set()
    assert {rule for rule in lab.found(*filter(None, [target])) if rule[3] != "2"} == expected


def test_what_enclaves_share_is_read_once(lab):
    inventory = check([lab.root], now=NOW).inventory
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        assert len({id(enclave.certificate(name)) for enclave in inventory.enclaves}) == 1
    assert len({id(enclave.governance()) for enclave in inventory.enclaves}) == 1
    assert len(inventory.enclaves) == len(TWO)


@pytest.mark.parametrize(
    "name", ["key.pem", "cert.pem", "permissions.p7s", "governance.p7s", "identity_ca.cert.pem"]
)
def test_a_missing_file_is_found(lab, name):
    (lab / TALKER / name).unlink()
    assert name in lab.found()["PQS301"].message


SHARED_CAS = ("identity_ca.cert.pem", "permissions_ca.cert.pem", "permissions_ca.alt.cert.pem")


@pytest.mark.parametrize("name", ["cert.pem", *SHARED_CAS])
@pytest.mark.parametrize("form", ["empty", "DER"])
def test_a_certificate_that_is_none_does_not_silence_the_check(tmp_path, name, form):
    lab = Lab(tmp_path)
    path = lab / TALKER / name
    der = x509.load_pem_x509_certificate(path.read_bytes()).public_bytes(serialization.Encoding.DER)
    lab.put(f"{TALKER}/{name}", der if form == "DER" else b"")
    finding = lab.found()["PQS318"]
    assert (finding.path, finding.message) == (path, "contains no certificate in PEM")


@pytest.mark.parametrize(
    ("goal", "source", "message"),
    [
        (P7S, GOVERNANCE, "is governance, not permissions"),
        (f"{TALKER}/governance.p7s", P7S, "is permissions, not governance"),
    ],
)
def test_documents_in_each_others_place_are_found(lab, goal, source, message):
    lab.put(goal, (lab / source).read_bytes())
    finding = lab.found()["PQS318"]
    assert (finding.path, finding.message) == (lab / goal, message)


@pytest.mark.parametrize(
    ("left", "is_one"),
    [
        (("cert.pem", "permissions.p7s"), True),
        (("identity_ca.cert.pem", "permissions_ca.cert.pem"), False),
        (("cert.pem",), False),
    ],
)
def test_a_folder_of_another_name_is_an_enclave_by_what_is_in_it(lab, tmp_path, left, is_one):
    (tmp_path / "robot").mkdir()
    for name in left:
        shutil.copyfile(lab / TALKER / name, tmp_path / "robot" / name)
    assert ("PQS301" in found(tmp_path / "robot")) is is_one


def test_a_key_in_a_token_is_not_missed(lab):
    (lab / TALKER / "key.pem").rename(lab / TALKER / "key.p11")
    assert lab.found() == {}


# What the room `credentials` refuses (all of it: test_one_verdict.py)


def of_one_key(lab):
    """A permissions CA that is the identity CA."""
    shutil.copy(lab / "public/identity_ca.cert.pem", lab / "public/permissions_ca.cert.pem")


def doubled(lab):
    """The identity CA twice, which no other rule minds."""
    pem = lab.authorities().identity.certificate.pem
    lab.put("public/identity_ca.cert.pem", pem + pem)


def errors_with_codes(path):
    findings = check([path], now=NOW).findings
    return {(each.rule.id, each.code) for each in findings if each.code}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda lab: (lab / TALKER / "cert.pem").unlink(), {("PQS301", "file-missing")}),
        (lambda lab: (lab / GOVERNANCE).unlink(), {("PQS302", "file-missing")}),
        (lambda lab: lab.put(f"{TALKER}/cert.pem", b""), {("PQS318", "file-malformed")}),
        (doubled, {("PQS319", "ca-doubled")}),
        (of_one_key, {("PQS312", "one-key-two-roles"), ("PQS340", "wrong-signer")}),
    ],
)
def test_credentials_that_cannot_be_trusted_are_an_error_that_is_told_once(lab, change, told):
    change(lab)
    assert errors_with_codes(lab / TALKER) == told


def test_a_sound_enclave_has_no_code(lab):
    assert errors_with_codes(lab.root) == set()


def test_a_link_that_leads_nowhere_is_found(lab):
    (lab / GOVERNANCE).unlink()
    assert lab.found()["PQS302"].path.name == "governance.p7s"
    assert "PQS301" not in lab.found()


def test_an_enclave_that_was_renamed_is_found(lab):
    (lab / TALKER).rename(lab / "enclaves/singer")
    assert set(lab.found()) == {"PQS303"}


def test_a_folder_outside_a_keystore_may_have_any_name(lab, tmp_path):
    shutil.copytree(lab / TALKER, tmp_path / "on-the-robot", symlinks=False)
    # That its keys are classical is said where no keystore says it was meant.
    assert set(found(tmp_path / "on-the-robot")) == {"PQS610"}


def test_a_key_of_another_certificate_is_found(lab):
    shutil.copy(lab / "enclaves/listener/key.pem", lab / TALKER / "key.pem")
    assert set(lab.found()) == {"PQS304"}


@pytest.mark.parametrize("asked", ["pin-value=1234", "module-path=/tmp/evil.so"])
def test_a_reference_with_a_pin_or_a_library_is_found_and_not_exported(lab, asked):
    """Other tools write such references; Fast DDS's own plugin would get the whole of it."""
    reference = reference_to(f"pkcs11:token=lab;object=talker?{asked}")
    (lab / TALKER / "key.pem").write_bytes(reference)
    assert "PQS305" in lab.found()
    with pytest.raises(UsageError, match="URI"):
        StackEnclave.find(Keystore.open(lab.root), "/talker")


def test_another_alternative_key_is_found(tmp_path):
    lab = Lab(tmp_path)
    shutil.copy(lab / "enclaves/listener/alt.key.pem", lab / TALKER / "alt.key.pem")
    assert set(lab.found()) == {"PQS304"}


def test_a_broken_key_is_found_and_not_shown(lab):
    key = (lab / TALKER / "key.pem").read_bytes()
    lab.put(f"{TALKER}/key.pem", key[:120] + key[140:])
    finding = lab.found()["PQS305"]
    assert key.splitlines()[1].decode()[:20] not in finding.message


def test_a_key_that_only_others_can_use_is_not_called_broken(lab):
    key = ec.generate_private_key(ec.BrainpoolP256R1())
    identity = lab.authorities().identity
    identifier = identity.certificate.subject_key_identifier
    text = certificate(
        key=key, issuer="Test Identity CA", signer=identity.key.handle, identifiers=False,
        extensions=[(x509.AuthorityKeyIdentifier(identifier, None, None), False)],
        end=NOW + 90 * DAY,
    )  # fmt: skip
    lab.put(f"{TALKER}/cert.pem", text)
    lab.put(f"{TALKER}/key.pem", key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ))  # fmt: skip
    assert set(lab.found()) == {"PQS103", "PQS319"}  # pqsec cannot check it


def test_an_encrypted_key_is_nobodys_flaw(lab):
    key = serialization.load_pem_private_key((lab / TALKER / "key.pem").read_bytes(), None)
    secret = serialization.BestAvailableEncryption(b"secret")
    lab.put(f"{TALKER}/key.pem", key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, secret
    ))  # fmt: skip
    assert lab.found() == {}


def test_a_certificate_of_another_ca_of_the_same_name_is_found(lab):
    shutil.copy(other(lab) / "public/identity_ca.cert.pem", lab / "public/identity_ca.cert.pem")
    assert set(lab.found()) == {"PQS306"}


def test_a_certificate_of_an_intermediate_ca_is_found(lab):
    root, middle, own = lab.authorities().identity, p256(), p256()
    between = certificate(
        "Middle", ca=True, key=middle, issuer="Test Identity CA", signer=root.key.handle
    )
    lab.put("public/identity_ca.cert.pem", root.certificate.pem + between)
    end = NOW + 90 * DAY
    lab.put(f"{TALKER}/cert.pem", certificate(key=own, issuer="Middle", signer=middle, end=end))
    assert set(lab.found()) == {
        "PQS131",
        "PQS304",
        "PQS316",
        "PQS319",
    }  # that of the key is right too
    assert "PQS316" not in lab.found(Stack.FASTDDS)


def test_a_certificate_of_a_ca_of_another_name_is_found(lab):
    shutil.copy(lab / "public/permissions_ca.cert.pem", lab / "public/identity_ca.cert.pem")
    assert {"PQS306", "PQS312"} <= set(lab.found())


def test_a_certificate_that_outlives_its_ca_is_found(lab):
    key = lab.authorities().identity.key.handle
    identifier = lab.authorities().identity.certificate.subject_key_identifier
    ca = certificate(
        "Test Identity CA", key=key, ca=True, end=NOW + 80 * DAY, identifiers=False,
        extensions=[(x509.SubjectKeyIdentifier(identifier), False)],
    )  # fmt: skip
    lab.put("public/identity_ca.cert.pem", ca)
    assert set(lab.found()) == {"PQS307"}


def test_a_ca_renewed_with_another_key_identifier_is_found(lab):
    # As other tools do it: the same name and key, and their own way to make identifiers.
    key = lab.authorities().identity.key.handle
    lab.put("public/identity_ca.cert.pem", certificate("Test Identity CA", key=key, ca=True))
    assert set(lab.found()) == {"PQS313"}


@pytest.mark.parametrize("octet", [0, 4, 19])
def test_a_key_identifier_that_differs_in_one_octet_is_found(lab, octet):
    identity = lab.authorities().identity
    identifier = bytearray(identity.certificate.subject_key_identifier)
    identifier[octet] ^= 1
    near = x509.SubjectKeyIdentifier(bytes(identifier))
    ca = certificate(
        "Test Identity CA", key=identity.key.handle, ca=True, identifiers=False,
        extensions=[(near, False)],
    )  # fmt: skip
    lab.put("public/identity_ca.cert.pem", ca)
    assert set(lab.found()) == {"PQS313"}


def test_an_enclave_that_was_copied_to_a_second_robot_is_found(lab):
    shutil.copytree(lab / TALKER, lab / "enclaves/second", symlinks=True)
    findings = lab.found()
    assert set(findings) == {"PQS303", "PQS314"}
    assert "/second" in findings["PQS314"].message or "/talker" in findings["PQS314"].message


@pytest.mark.parametrize("issuer", ["CA", "ca"])
def test_two_certificates_with_one_serial_number_are_found(lab, issuer):
    text = certificate("/else", issuer="CA", signer=p256(), serial=7)
    lab.put("public/else.cert.pem", text)
    assert lab.found() == {}
    lab.put("public/same.cert.pem", text)  # a copy is no second certificate
    assert lab.found() == {}
    lab.put("public/third.cert.pem", certificate("/third", issuer=issuer, signer=p256(), serial=7))
    assert set(lab.found()) == {"PQS315"}


def permissions(lab):
    return Permissions.from_xml((lab / TALKER / "permissions.xml").read_bytes())


def regrant(lab, **changes):
    """The talker's permissions with its grant changed, and signed again."""
    [grant] = permissions(lab).grants
    lab.sign_permissions(Permissions(grants=(replace(grant, **changes),)))


def on_domain(lab, domains):
    [grant] = permissions(lab).grants
    rules = tuple(replace(rule, domains=DomainSet.parse(domains)) for rule in grant.rules)
    regrant(lab, rules=rules)


@pytest.mark.parametrize("name", ["CN=/listener", "CN=/talker,O=Lab", "CN=/talker/x", "cn=/talker"])
def test_permissions_of_somebody_else_are_found(lab, name):
    regrant(lab, subject_name=name)
    assert lab.found().keys() & {"PQS308", "PQS309"} == {"PQS308"}


def test_domains_that_are_not_governed_are_found(lab):
    on_domain(lab, "1-5")
    assert "PQS309" in lab.found()
    regrant(lab, default=DefaultAction.ALLOW)
    assert "PQS309" not in lab.found()


def test_domains_that_are_governed_too_are_enough(lab):
    on_domain(lab, "0-5")
    assert lab.found() == {}


def test_governance_that_only_some_have_is_found(lab):
    text = Governance.protected(DomainSet.of(0, 1)).to_xml()
    lab.put("enclaves/other.p7s", lab.authorities().sign(text, now=NOW))
    (lab / TALKER / "governance.p7s").unlink()
    (lab / TALKER / "governance.p7s").symlink_to("../other.p7s")
    assert set(lab.found()) == {"PQS310"}


def test_a_ca_that_only_some_trust_is_found(lab):
    shutil.copy(other(lab) / "public/identity_ca.cert.pem", lab / "public/other.cert.pem")
    (lab / TALKER / "identity_ca.cert.pem").unlink()
    (lab / TALKER / "identity_ca.cert.pem").symlink_to("../../public/other.cert.pem")
    assert set(lab.found()) == {"PQS306", "PQS311"}


def test_keystores_that_are_checked_together_may_trust_different_cas(lab):
    assert "PQS311" not in found(lab.root, other(lab))


def test_one_key_for_both_cas_is_found(lab):
    # As SROS2 makes it: one file, and links with both names.
    lab.put("public/ca.cert.pem", (lab / "public/identity_ca.cert.pem").read_bytes())
    for name in ("identity_ca.cert.pem", "permissions_ca.cert.pem"):
        (lab / "public" / name).unlink()
        (lab / "public" / name).symlink_to("ca.cert.pem")
    assert lab.found()["PQS312"].path.name == "ca.cert.pem"


# Time


def test_of_two_grants_one_that_is_good_with_the_certificate_is_enough(lab):
    [grant] = permissions(lab).grants
    past = replace(grant, not_before=NOW - 300 * DAY, not_after=NOW - 200 * DAY)
    lab.sign_permissions(Permissions(grants=(past, grant)))
    assert lab.found().keys() & {"PQS320", "PQS327"} == {"PQS320"}


@pytest.mark.parametrize(
    ("rules", "begin", "end"),
    [
        ({"PQS320", "PQS325", "PQS327"}, -300 * DAY, -2 * DAY),
        ({"PQS320", "PQS324", "PQS325"}, -300 * DAY, -DAY / 24),
        ({"PQS321", "PQS325"}, -300 * DAY, 20 * DAY),
        ({"PQS322"}, DAY / 24, 90 * DAY),
        ({"PQS323"}, -DAY / 24, 90 * DAY),
        ({"PQS325"}, -DAY, 87 * DAY),
        ({"PQS326"}, -DAY, 93 * DAY),
        ({"PQS322", "PQS326", "PQS327"}, 91 * DAY, 200 * DAY),
        (set(), -DAY, 89 * DAY),
        (set(), -DAY, 90 * DAY),
        (set(), -DAY, 91 * DAY),
        (set(), -13 * DAY / 24, 90 * DAY),
    ],
)
def test_times_of_a_grant(lab, rules, begin, end):
    regrant(lab, not_before=NOW + begin, not_after=NOW + end)
    assert set(lab.found()) == rules


def test_who_does_not_run_fast_dds_may_write_fresh_grants(lab):
    regrant(lab, not_before=NOW - timedelta(hours=1), not_after=NOW + 90 * DAY)
    assert lab.found(Stack.CYCLONEDDS) == {}


def test_a_keystore_that_is_left_alone_runs_out(lab):
    assert {"PQS111", "PQS321"} == set(lab.found(now=NOW + 80 * DAY))
    assert {"PQS110", "PQS320"} <= set(lab.found(now=NOW + 92 * DAY))


# S/MIME. The signer of these is the permissions CA, by the library that others use.


def xml_of(lab):
    return (lab / TALKER / "permissions.xml").read_bytes()


def signed(lab, *options, digest=None, times=1):
    """The talker's permissions, signed as those options have it."""
    ca = lab.authorities().permissions
    builder = pkcs7.PKCS7SignatureBuilder().set_data(xml_of(lab))
    certificate = x509.load_der_x509_certificate(ca.certificate.der)
    for _ in range(times):
        builder = builder.add_signer(certificate, ca.key.handle, digest or hashes.SHA256())
    return builder.sign(serialization.Encoding.SMIME, options)


OPAQUE = b"Content-Type: application/x-pkcs7-mime; smime-type=signed-data\n\n"
TEXT, DETACHED = pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature


def der(lab):
    return split(signed(lab, TEXT, DETACHED)).cms


def with_inner(header):
    """The signed part with another header; its signature does not matter any more."""
    return lambda lab: signed(lab, TEXT, DETACHED).replace(b"Content-Type: text/plain\r\n", header)


NO_SMIME = [
    lambda lab: pem("PKCS7", der(lab)),
    der,
    lambda lab: OPAQUE + base64.encodebytes(der(lab)),
]
FORMS = [
    *(("PQS330", make) for make in NO_SMIME),
    ("PQS331", signed),
    ("PQS330", xml_of),
    ("PQS331", lambda lab: signed(lab, DETACHED)),
    ("PQS331", lambda lab: signed(lab, DETACHED, pkcs7.PKCS7Options.Binary)),
    ("PQS331", with_inner(b"Content-Type: text/xml\r\n")),
    ("PQS331", with_inner(b"Content-Type: application/xml\r\n")),
    ("PQS331", with_inner(b"")),
    ("PQS332", lambda lab: b"\r\n" + signed(lab, TEXT, DETACHED)),
    ("PQS332", lambda lab: b"\n" + lab.authorities().sign(xml_of(lab), now=NOW)),
    ("PQS333", lambda lab: signed(lab, TEXT, DETACHED)[:-300]),
    ("PQS333", lambda lab: signed(lab, TEXT, DETACHED).replace(b"MII", b"MIJ")),
    ("PQS335", lambda lab: signed(lab, TEXT, DETACHED, times=2)),
    ("PQS336", lambda lab: signed(lab, TEXT, DETACHED, pkcs7.PKCS7Options.NoCerts)),
    ("PQS337", lambda lab: with_digest(lab, "1.3.14.3.2.26")),
    ("PQS337", lambda lab: with_digest(lab, "1.2.840.113549.2.5")),
    ("PQS338", lambda lab: signed(lab, TEXT, DETACHED, pkcs7.PKCS7Options.NoAttributes)),
    ("PQS338", lambda lab: signed(lab, TEXT, DETACHED, digest=hashes.SHA224())),
]


OTHER_FORM = {"PQS344"}
"""Told of whatever pqsec did not write; it is no trouble."""


@pytest.mark.parametrize(("rule", "make"), FORMS)
def test_a_form_that_stacks_do_not_read_is_found(lab, rule, make):
    lab.put(P7S, make(lab))
    # Where there is no S/MIME at all, it is told too that there is no XML; and what nobody here
    # can check, nobody here trusts.
    more = {"PQS201"} if make in NO_SMIME else {"PQS319"} if rule == "PQS338" else set()
    assert set(lab.found()) - OTHER_FORM == {rule} | more


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: text.replace(b"\r\n", b"\n"),
        lambda text: re.sub(rb'micalg="[^"]*"', b'micalg="md5"', text),
        lambda text: text.replace(b"application/x-pkcs7-signature", b"application/pkcs7-signature"),
        lambda text: text.replace(b"MIME-Version: 1.0\r\n", b"Subject: permissions\r\n"),
        lambda text: text.replace(b"text/plain\r\n", b"text/plain; charset=utf-8\r\n"),
    ],
)
def test_a_form_that_stacks_read_is_not_complained_of(lab, change):
    lab.put(P7S, change(signed(lab, TEXT, DETACHED)))
    # A changed inner header breaks the signature.
    assert OTHER_FORM <= set(lab.found()) <= OTHER_FORM | {"PQS341"}


@pytest.mark.parametrize("option", ["NoCapabilities", "Text"])
@pytest.mark.parametrize("digest", [hashes.SHA384(), hashes.SHA512()])
def test_options_that_stacks_take_are_not_complained_of(lab, option, digest):
    options = {TEXT, DETACHED, getattr(pkcs7.PKCS7Options, option)}
    lab.put(P7S, signed(lab, *options, digest=digest))
    assert set(lab.found()) == OTHER_FORM


def test_a_signature_that_cannot_be_checked_is_not_called_false(lab):
    key = rsa_key(2048)
    text = certificate("Test Permissions CA", key=key, ca=True)
    lab.put("public/permissions_ca.cert.pem", text)
    pss = padding.PSS(padding.MGF1(hashes.SHA256()), 32)
    builder = pkcs7.PKCS7SignatureBuilder().set_data(xml_of(lab))
    builder = builder.add_signer(
        x509.load_pem_x509_certificate(text), key, hashes.SHA256(), rsa_padding=pss
    )
    lab.put(P7S, builder.sign(serialization.Encoding.SMIME, [TEXT, DETACHED]))
    found = lab.found()
    assert "RSASSA-PSS" in found["PQS338"].message
    assert "PQS341" not in found


@pytest.mark.parametrize("construction", CONSTRUCTIONS, ids=lambda each: each.__name__)
def test_a_file_in_which_readers_find_two_documents_is_found(lab, construction):
    ca, xml = lab.authorities(), xml_of(lab)
    one, other = ca.sign(xml, now=NOW), ca.sign(xml.replace(b"ALLOW", b"DENY"), now=NOW)
    lab.put(P7S, construction(one, other))
    found = lab.found()
    assert set(found) == {"PQS343"}
    assert "would not read the same document" in found["PQS343"].message


def test_a_file_of_another_form_is_told_and_what_pqsec_writes_is_not(lab):
    message = lab.authorities().sign(xml_of(lab), now=NOW)
    lab.put(P7S, message)
    assert lab.found() == {}
    lab.put(P7S, message.replace(b"\n", b"\r\n"))
    assert set(lab.found()) == OTHER_FORM


def with_signer_info(lab, change):
    """The talker's permissions as pqsec signs them, with its SignerInfo changed after."""
    text = lab.authorities().sign((lab / TALKER / "permissions.xml").read_bytes(), now=NOW)
    content = parse(split(text).cms)
    [info] = content.signer_infos.as_list()
    change(info)
    whole = ContentInfo(content_type=Oid(SIGNED_DATA), content=content)
    return with_signature(text, encode(whole))


def by_key_identifier(lab):
    """Signed by OpenSSL as with `cms -sign -keyid`: the signer is told by its key."""

    def change(info):
        info.sid, info.version = lab.authorities().permissions.certificate.subject_key_identifier, 3

    return with_signer_info(lab, change)


def with_digest(lab, oid):
    def change(info):
        info.digest_algorithm = algorithm(oid)

    return with_signer_info(lab, change)


def with_signature(text, der):
    head, _, rest = text.partition(b'filename="smime.p7s"\n\n')
    end = rest[rest.index(b"\n--") :]
    return b"".join((head, b'filename="smime.p7s"\n\n', base64.encodebytes(der), end))


def test_a_signer_that_is_named_by_key_is_found(lab):
    lab.put(P7S, by_key_identifier(lab))
    assert set(lab.found()) - OTHER_FORM == {"PQS334"}


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_a_changed_document_is_found(tmp_path, profile):
    lab = Lab(tmp_path, profile)
    lab.edit(P7S, b"<default>DENY", b"<default>DROP")
    assert {"PQS341", "PQS342"} <= set(lab.found())


def test_an_impostor_of_the_permissions_ca_is_found(lab):
    # Same name and serial number, another key: what a look into the document would not show.
    ca = lab.authorities().permissions.certificate
    key = SIGNATURES.named("ecdsa-p256").generate()
    lab.put(P7S, sign(xml_of(lab), Signer(ca, key), now=NOW))
    assert set(lab.found()) == {"PQS341"}


def by_identity_ca(lab):
    identity = lab.authorities().identity
    return Signer(identity.certificate, identity.key)


def by_participant(lab):
    certificate, key = ((lab / TALKER / name).read_bytes() for name in ("cert.pem", "key.pem"))
    return Signer(Certificate.from_pem(certificate), load_private_key(key))


def by_delegate(lab):
    """A subject to which the permissions CA issued a certificate."""
    key = SIGNATURES.named("ecdsa-p256").generate()
    year = 365 * DAY
    delegate = lab.authorities().permissions.issue("x", key.public_key, now=NOW, validity=year)
    return Signer(delegate, key)


def by_another_ca(lab):
    authority = Authority.create("Else", SIGNATURES.named("ecdsa-p256"), now=NOW, validity=9 * DAY)
    return Signer(authority.certificate, authority.key)


@pytest.mark.parametrize(
    ("signer", "words"),
    [
        (by_identity_ca, "signed by the identity CA, CN=Test Identity CA"),
        (by_participant, "signed by the participant itself, CN=/talker"),
        (by_delegate, "signed by a certificate that CN=Test Permissions CA issued"),
        (by_another_ca, "signed by CN=Else"),
    ],
)
def test_another_signer_than_the_permissions_ca_is_found(lab, signer, words):
    lab.put(P7S, sign(xml_of(lab), signer(lab), now=NOW))
    found = lab.found()
    assert set(found) == {"PQS340"}
    assert found["PQS340"].message.startswith(words)


def test_another_ca_of_the_same_name_is_told_as_that(lab):
    """It was told as `signed by a certificate that X issued, not by X`."""
    ecdsa = SIGNATURES.named("ecdsa-p256")
    other = Authority.create("Test Permissions CA", ecdsa, now=NOW, validity=9 * DAY)
    signer = Signer(other.certificate, other.key)
    text = "signed by another CA with the same name CN=Test Permissions CA, not by this one"
    lab.put(P7S, sign(xml_of(lab), signer, now=NOW))
    assert {key: each.message for key, each in lab.found().items()} == {"PQS340": text}
    bare = sign(xml_of(lab), signer, now=NOW, embed_certificate=False)
    lab.put(P7S, bare)
    found = lab.found()["PQS340"].message
    words = "signed with a certificate whose issuer is CN=Test Permissions CA"
    assert found == f"{words}: another CA with that name, or a certificate that the CA issued"


def test_governance_by_another_signer_is_told_once(lab):
    text = document_in((lab / GOVERNANCE).read_bytes())
    lab.put(GOVERNANCE, sign(text, by_identity_ca(lab), now=NOW))
    findings = check([lab.root], now=NOW).findings
    assert [finding.rule.id for finding in findings] == ["PQS340"]


@pytest.mark.parametrize("profile", ["transition", "pq"])
def test_governance_is_looked_at_before_there_is_any_participant(tmp_path, profile):
    lab = Lab(tmp_path, profile)
    for name in ("talker", "listener"):
        shutil.rmtree(lab / "enclaves" / name)
    assert lab.found() == {}
    lab.edit(GOVERNANCE, b">ENCRYPT<", b">NONE<")
    assert {"PQS341", "PQS342"} <= set(lab.found())


def test_loose_files_are_looked_at_together(lab):
    ca = lab / "public/permissions_ca.cert.pem"
    assert set(found(ca, lab / GOVERNANCE)) == set()
    lab.put(GOVERNANCE, sign(xml_of(lab), by_identity_ca(lab), now=NOW))
    assert "PQS340" in found(ca, lab / GOVERNANCE)


def test_xml_that_was_changed_and_not_signed_is_found(lab):
    lab.edit(f"{TALKER}/permissions.xml", b"<default>", b"<!-- later --><default>")
    assert "PQS342" in lab.found()


def test_post_quantum_documents_need_no_certificate_inside(tmp_path):
    lab = Lab(tmp_path, "pq")
    assert signers_in((lab / P7S).read_bytes()).certificates == ()
    assert lab.found() == {}
