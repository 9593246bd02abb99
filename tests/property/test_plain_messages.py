"""Files in the form that pqsec writes are read once: OpenSSL's reader finds the same in them."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pqsec_pki.errors import MalformedError
from pqsec_pki.smime import AmbiguousError, _mime, _openssl_reader, _reading

PIECES = [
    *(b"\n", b" ", b"--", b"----", b":", b";", b'"', b"(", b"=", b"\t", b"\x0b", b"\xff", b"\r"),
    *(b"x" * 1020, b"y" * 1024, b"Content-Type: text/plain\n", b"boundary=a\n", b"\n\n", b"\r\n"),
]
TEXTS = st.lists(st.sampled_from(PIECES) | st.binary(max_size=6), max_size=12).map(b"".join)


def framed(document: bytes, signature: bytes) -> bytes:
    """What `join` writes around any octets in the place of the signature."""
    before, after = _mime._around_signature(_mime.content_of(document), "sha-256")
    return before + signature + after


def boundary_in(message: bytes) -> bytes:
    return message.splitlines()[5]


@given(TEXTS, TEXTS)
@example(b"<dds/>\n", b"TUlJ")
def test_in_a_plain_message_all_readers_find_the_same(document, signature):
    message = framed(document.replace(b"\0", b""), signature.replace(b"\0", b""))
    try:
        own = _mime.split(message)
    except MalformedError:
        return
    if _mime.is_plain(message, own):
        other = _openssl_reader.read(message)
        assert (other.boundary, other.content) == (own.boundary, own.content)
        assert other.signature.rstrip() == own.signature.rstrip()
        assert _openssl_reader.text(own.content) == own.header_and_text[1]


def test_a_message_that_pqsec_writes_is_plain():
    assert _reading.read(framed(b"<dds/>\n", b"TUlJ")).is_plain


@pytest.mark.parametrize("after", [b"x", b"-", b"--x"])
def test_a_line_in_the_signature_that_begins_like_the_boundary_is_not_plain(after):
    mark = boundary_in(framed(b"<dds/>\n", b""))
    with pytest.raises(AmbiguousError):
        _reading.read(framed(b"<dds/>\n", b"TUlJ\n" + mark + after + b"\nTUlJ"))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"MIME-Version: 1.0\n", b"MIME-Version: 1.0\nContent-Type: text/plain\n"),
        (b'micalg="sha-256"', b'micalg="sha-256" (a'),
        (b"Content-Type: text/plain\n", b"Content-Type: text/plain; a\n"),
        (b"TUlJ", b"TUlJ\r"),
        (b"This is", b"That is"),
        (b"--\n\n", b"--\n"),
    ],
)
def test_a_message_with_anything_else_around_its_parts_is_not_plain(old, new):
    message = framed(b"<dds/>\n", b"TUlJ").replace(old, new, 1)
    try:
        own = _mime.split(message)
    except MalformedError:
        return
    assert not _mime.is_plain(message, own)


def test_a_signed_part_with_another_header_is_not_plain():
    before, after = _mime._around_signature(b"Content-Type: text/plain; a\r\n\r\n<dds/>", "sha-256")
    message = before + b"TUlJ" + after
    assert not _mime.is_plain(message, _mime.split(message))
