"""One reading of a signed file: what other readers could find in it is refused."""

import base64
import re
import shutil
import subprocess
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    ContentInfo,
    Oid,
    SetOf,
    attribute,
    decode,
    encode,
    raw,
)
from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.problems import Code
from pqsec_pki.smime import (
    AmbiguousError,
    Require,
    SignedFile,
    Signer,
    _canonical,
    _openssl_reader,
    _signer_info,
    document_in,
    is_canonical,
    sign,
    signers_in,
    verify,
)
from pqsec_pki.smime import parts_of as parted
from pqsec_pki.smime._mime import TEXT_HEADER
from tests.unit.signed_files import CONSTRUCTIONS, parts_of

NOW = datetime.now(UTC).replace(microsecond=0)
YEAR = timedelta(days=365)
ALLOWED, DENIED = b"<dds>\n  <allowed/>\n</dds>\n", b"<dds>\n  <denied/>\n</dds>\n"


def signer_of(name, algorithm):
    ca = Authority.create(name, SIGNATURES.named(algorithm), now=NOW, validity=YEAR)
    return Signer(ca.certificate, ca.key)


CA = signer_of("Permissions CA", "ecdsa-p256")
COUNTER = signer_of("Permissions CA ml-dsa-65", "ml-dsa-65")


def signed(document=ALLOWED, **options):
    return sign(document, CA, now=NOW, **options)


def lines_before(message):
    return SignedFile(message).lines_before


def countersigned(document=ALLOWED):
    return signed(document, countersigner=COUNTER)


def read(message, require=Require.BOTH):
    return verify(message, CA.certificate, alternative_ca=COUNTER.certificate, require=require)


def crlf(text):
    return text.replace(b"\n", b"\r\n")


def cms_of(message):
    return base64.b64decode(parts_of(message)[1].partition(b"\n\n")[2])


def with_cms(message, der):
    old = parts_of(message)[1].partition(b"\n\n")[2].rstrip()
    lines = [base64.b64encode(der)[at : at + 64] for at in range(0, len(der) * 4 // 3 + 3, 64)]
    return message.replace(old, b"\n".join(line for line in lines if line))


def changed(message, change):
    """`message` after `change` did something to its SignedData and its SignerInfo."""
    structure = decode(ContentInfo, cms_of(message), "CMS")
    [info] = structure.content.signer_infos.as_list()
    change(structure.content, info)
    structure.content.signer_infos = SetOf([info])
    return with_cms(message, encode(structure))


@pytest.fixture(scope="module")
def openssl(requires):
    """Reads a file as stacks do: the document, or None."""
    program = requires(shutil.which("openssl"), "openssl", "apt-get install openssl")

    def reading(message, folder, command="smime"):
        (folder / "ca.pem").write_bytes(CA.certificate.pem)
        (folder / "message").write_bytes(message)
        options = ["-in", "message", "-text", "-noverify", "-nointern", "-certfile", "ca.pem"]
        ran = subprocess.run(
            [program, command, "-verify", *options], cwd=folder, capture_output=True, check=False
        )
        return ran.stdout if ran.returncode == 0 else None

    return reading


# Two documents in one file


@pytest.mark.parametrize("construction", CONSTRUCTIONS, ids=lambda each: each.__name__)
def test_a_file_in_which_readers_find_two_documents_is_refused(construction):
    message = construction(signed(ALLOWED), signed(DENIED))
    for ask in (document_in, signers_in, lines_before):
        with pytest.raises(AmbiguousError, match="would not read the same document"):
            ask(message)
    with pytest.raises(VerificationError, match="would not read the same document") as caught:
        verify(message, CA.certificate)
    assert caught.value.codes == {Code.READERS_DISAGREE}
    assert not is_canonical(message)


@pytest.mark.interop
@pytest.mark.parametrize("command", ["smime", "cms"])
@pytest.mark.parametrize("construction", CONSTRUCTIONS, ids=lambda each: each.__name__)
def test_openssl_reads_the_first_of_two_documents(openssl, tmp_path, construction, command):
    # So the refusal above is for a reason; what readers agree on is the other half of it.
    message = construction(signed(ALLOWED), signed(DENIED))
    assert openssl(message, tmp_path, command) == crlf(ALLOWED)
    assert openssl(read(countersigned()).message, tmp_path, command) == crlf(ALLOWED)


WRAPPERS = {
    "CRLF": crlf,
    "CR CR LF": lambda message: message.replace(b"\n", b"\r\r\n"),
    "text in CRLF": lambda message: message.replace(ALLOWED, crlf(ALLOWED)),
    "another preamble": lambda m: m.replace(b"This is an S/MIME signed message", b"<dds/>"),
    "a trailer": lambda message: message + b"<dds/>\n",
    "another header": lambda message: b"X-Sent-By: somebody\n" + message,
    "another boundary": lambda message: re.sub(rb"----[0-9A-F]{32}", b"=_other", message),
    "other parameters": lambda m: m.replace(b'micalg="sha-256"', b'charset=utf-8; x="y"'),
    "lines of 76": lambda message: message.replace(
        parts_of(message)[1].partition(b"\n\n")[2].rstrip(),
        base64.encodebytes(cms_of(message)).rstrip(),
    ),
    "spaces after the boundary": lambda message: re.sub(
        rb"(?m)^(------[0-9A-F]{32}(--)?)$", rb"\1 \t", message
    ),
    "no line end at the end": lambda message: message.rstrip(b"\n"),
    "no blank line after the signature": lambda message: re.sub(
        rb"\n\n(------[0-9A-F]{32}--)", rb"\n\1", message
    ),
}


@pytest.mark.parametrize("form", WRAPPERS)
def test_a_file_of_another_form_is_read_and_handed_on_in_the_one_form(form):
    message = countersigned()
    other = WRAPPERS[form](message)
    assert other != message
    assert not is_canonical(other)
    found = read(other)
    assert (found.document, found.message) == (crlf(ALLOWED), message)


@pytest.mark.interop
@pytest.mark.parametrize("form", WRAPPERS)
def test_openssl_reads_the_other_forms_too(openssl, tmp_path, form):
    assert openssl(WRAPPERS[form](countersigned()), tmp_path) == crlf(ALLOWED)


@pytest.mark.parametrize("padding", [b"=", b"==", b"===", b"\n="])
def test_a_signature_with_too_much_padding_is_refused(padding):
    # OpenSSL reads nothing then, and others pass over it.
    message = countersigned()
    end = b"\n\n------"
    head, _, tail = message.rpartition(end)
    with pytest.raises(VerificationError, match="is not base64"):
        read(head + padding + end + tail)


# What no signature covers


def _crls(data, _):
    data.crls = [raw(CA.certificate.der)]


def _certificates(data, _):
    data.certificates = [raw(COUNTER.certificate.der), *data.certificates]


def _version(data, info):
    data.version, info.version = 4, 7


def _digests(data, info):
    sha1 = AlgorithmIdentifier(algorithm=Oid("1.3.14.3.2.26"), parameters=None)
    data.digest_algorithms = SetOf([info.digest_algorithm, sha1])


def _attribute(_, info):
    info.unsigned_attributes = [
        *info.unsigned_attributes,
        attribute("1.2.840.113549.1.9.16.2.14", b"\x30\x00"),
    ]


def _twice(_, info):
    info.unsigned_attributes = info.unsigned_attributes * 2


def _order(_, info):
    info.signed_attributes = info.signed_attributes[::-1]


def _foreign_counter(_, info):
    mallory = signer_of("Mallory", "ml-dsa-44")
    other = decode(
        ContentInfo, cms_of(signed(countersigner=mallory)), "CMS"
    ).content.signer_infos.as_list()[0]
    info.unsigned_attributes = [*info.unsigned_attributes, *other.unsigned_attributes]


UNSIGNED = {
    "a list of revoked certificates": _crls,
    "another certificate": _certificates,
    "other versions": _version,
    "another digest": _digests,
    "an unsigned attribute": _attribute,
    "the countersignature twice": _twice,
    "signed attributes in another order": _order,
    "somebody else's countersignature": _foreign_counter,
}


@pytest.mark.parametrize("name", UNSIGNED)
def test_what_no_signature_covers_is_not_handed_on(name):
    message = countersigned()
    altered = changed(message, UNSIGNED[name])
    assert altered != message
    assert read(altered).message == message


def test_a_digest_with_parameters_is_refused():
    def parameters(data, info):
        info.digest_algorithm.parameters = raw(b"\x04\x06hidden")

    with pytest.raises(VerificationError, match="the digest has parameters"):
        read(changed(signed(), parameters), Require.ANY)


def test_a_signature_with_a_value_that_openssl_reads_otherwise_is_refused():
    # A string in pieces: OpenSSL puts it together, and then looks for another digest.
    def in_pieces(_, info):
        info.signed_attributes = [
            *info.signed_attributes,
            attribute("1.3.6.1.4.1.99999.1", bytes.fromhex("2c03 0c0161")),
        ]

    with pytest.raises(VerificationError, match="a value in pieces"):
        read(changed(signed(), in_pieces), Require.ANY)


def test_a_look_alike_of_the_signers_certificate_is_not_handed_on():
    # OpenSSL looks for the signer by issuer and serial number among those that came along.
    def look_alike(data, _):
        theirs, spki = CA.certificate.der, CA.certificate.spki
        data.certificates = [
            raw(theirs.replace(spki, signer_of("CA", "ecdsa-p256").certificate.spki))
        ]

    message = countersigned()
    assert read(changed(message, look_alike)).message == message


# The one form


@pytest.mark.parametrize("embedded", [True, False])
@pytest.mark.parametrize("countersigner", [None, COUNTER], ids=["", "countersigned"])
def test_what_pqsec_signs_is_in_the_one_form(embedded, countersigner):
    message = signed(embed_certificate=embedded, countersigner=countersigner)
    assert is_canonical(message)
    assert read(message, Require.ANY).message == message


def test_a_countersignature_that_cannot_be_checked_is_kept_where_none_can_be():
    message = countersigned()
    assert verify(message, CA.certificate).message == message
    assert verify(message, CA.certificate).unchecked == 1


def test_a_countersignature_by_somebody_else_is_dropped():
    message = signed(countersigner=signer_of("Mallory", "ml-dsa-44"))
    found = read(message, Require.ANY)
    assert found.unchecked == 1
    assert found.message != message
    assert read(found.message, Require.ANY).unchecked == 0


def test_the_header_of_the_signed_part_is_kept_as_it_was_signed():
    header = b"Content-Language: en\r\nContent-Type: text/plain; charset=utf-8\r\n\r\n"
    message = signed_as(header + crlf(ALLOWED))
    found = read(message, Require.ANY)
    assert (found.document, found.message) == (crlf(ALLOWED), message)
    assert lines_before(message) == message[: message.index(b"<dds>")].count(b"\n")


@pytest.mark.parametrize("form", WRAPPERS)
def test_the_line_where_the_document_begins_is_known(form):
    message = WRAPPERS[form](signed(b"\n" + ALLOWED))
    before = message[: message.index(b"  <allowed/>")]
    assert lines_before(message) + 2 == before.count(b"\n")


def test_the_text_can_hide_nothing_behind_its_own_header():
    # A line so long that OpenSSL takes its rest for the blank line that ends the header.
    long = b"X-Long: " + b"a" * (1023 - 8)
    content = long + b"\r\nContent-Type: text/plain\r\n\r\n" + crlf(ALLOWED)
    with pytest.raises(VerificationError, match="would not read the same document"):
        read(signed_as(content), Require.ANY)


@pytest.mark.parametrize("text", [b"<a>\r</a>\r\n", b"\r<a/>\r\n"])
def test_a_signed_carriage_return_alone_is_in_no_canonical_file(text):
    """The signature covers it, and a file of the parts would have a line end there."""
    message = signed_as(TEXT_HEADER + text)
    with pytest.raises(MalformedError, match="the signed part is not in pqsec's canonical form"):
        parted(message)


def test_the_signature_can_hide_nothing_behind_its_own_header():
    """OpenSSL would verify the signature above the blank line, and pqsec the one below it."""
    message, other = signed(), sign(ALLOWED, CA, now=NOW + timedelta(days=1))
    _, part = parts_of(message)
    header, _, base64_text = part.partition(b"\n\n")
    hidden = parts_of(other)[1].partition(b"\n\n")[2].strip()
    long = b"X-Long: " + b"a" * (1023 - 8)
    lines = (header, long, hidden, b"", base64_text)
    forged = message.replace(part, b"\n".join(lines))
    model = _openssl_reader.read(forged)
    assert model.signature.replace(b"\r\n", b"\n").startswith(hidden)
    with pytest.raises(AmbiguousError, match="finds another signature between"):
        document_in(forged)
    with pytest.raises(VerificationError, match="would not read the same document"):
        verify(forged, CA.certificate)


def signed_as(content):
    """A file whose signature covers `content`, MIME header and all."""
    info = _signer_info.make(CA, content, now=NOW)
    return _canonical.file_of(content, info, [], raw(CA.certificate.der))


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (b"Content-Type: multipart/signed", "it finds no boundary"),
        (b"Content-Type: multipart/signed; boundary", "it finds no boundary"),
        (b"Content-Type: multipart/signed;\r boundary=a", "it finds no boundary"),
        (b"Content-Type: multipart/signed; boundary=a; boundary=b", "it finds 2 boundaries"),
        (b"Content-Type: text/plain\nContent-Type: text/plain", "it finds 2 content types"),
        (b"Subject: none", "it finds no content type"),
        (b"Content-Type:", "it finds no content type"),
        (b"X: y\n" * (1 << 14), "a header is longer than 65536 bytes"),
    ],
)
def test_the_model_of_openssl_says_why_it_takes_no_file(header, words):
    with pytest.raises(MalformedError, match=words):
        _openssl_reader.read(header + b"\n\n--a\n")


def test_the_model_of_openssl_takes_no_signature_of_another_content_type():
    message = signed()
    _openssl_reader.read(message)
    _, signature = parts_of(message)
    other = signature.replace(b"application/x-pkcs7-signature", b"text/plain")
    assert other != signature
    with pytest.raises(MalformedError, match="it takes the signature for 'text/plain'"):
        _openssl_reader.read(message.replace(signature, other))


def test_the_model_of_openssl_takes_a_short_file_without_a_body_for_no_long_header():
    with pytest.raises(MalformedError, match="it finds no end of the last part"):
        _openssl_reader.read(b"Content-Type: multipart/signed; boundary=a\n")


def test_where_no_countersigner_is_named_none_is_missed():
    verified = verify(signed(), CA.certificate, require=Require.CLASSICAL, pinned=True)
    assert verified.document == crlf(ALLOWED)


def test_the_model_of_openssl_stops_at_the_first_line_that_ends_the_last_part():
    message = signed()
    found = _openssl_reader.read(message)
    mark = b"--" + found.boundary
    more = message + mark + b"\n\nanother part\n" + mark + b"--\n"
    assert _openssl_reader.read(more) == found


@pytest.mark.parametrize(
    ("code", "text", "agree"),
    [
        ("UTF-8", "é", True),
        ("utf8", "é", True),
        ("ISO-8859-1", "e", True),
        ("windows-1252", "e", True),
        ("ISO-8859-1", "é", False),
        ("UTF-7", "é", False),
        ("EBCDIC-CP-US", "e", False),
        ("punycode", "e", False),
    ],
)
def test_a_declared_code_in_which_the_octets_are_other_letters_than_for_stacks(code, text, agree):
    """Stacks read the octets as they are: they would find another topic than the one signed."""
    head = f'<?xml version="1.0" encoding="{code}"?>'
    codec = "latin-1" if code == "ISO-8859-1" else "utf-7" if code == "UTF-7" else "utf-8"
    xml = f"{head}\r\n<dds><topic>{text}</topic></dds>\r\n".encode(codec)
    signed = sign(xml, signer_of("CA", "ecdsa-p256"), now=NOW)
    if agree:
        assert document_in(signed) == xml
    else:
        with pytest.raises(AmbiguousError, match=f"it is in {code}"):
            document_in(signed)
