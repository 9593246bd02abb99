"""Signed files in which two readers find two documents, each validly signed."""

import re


def parts_of(message):
    """(text part, signature part) of a signed file as pqsec writes it, LF line ends."""
    [boundary] = re.findall(rb'boundary="(.*?)"', message)
    _, text, signature, _ = re.split(rb"(?m)^--" + boundary + rb"(?:--)?\n", message)
    return text, signature


def _body(boundary, message):
    text, signature = parts_of(message)
    mark = b"--" + boundary
    return b"\n".join([mark, text.removesuffix(b"\n"), mark, signature.rstrip(), b"", mark + b"--"])


def _both(header, one, other):
    """Both under one header: of the boundaries OLD and NEW, each reader sees one."""
    bodies = _body(b"OLD", one), _body(b"NEW", other)
    return b"\n".join([b"MIME-Version: 1.0", header, b"", *bodies, b""])


def quoted_parameter(one, other):
    """A parameter in quotes."""
    return _both(b'Content-Type: multipart/signed; a="; boundary=NEW"; boundary="OLD"', one, other)


def commented_parameter(one, other):
    """A parameter in a comment."""
    return _both(
        b'Content-Type: multipart/signed; a=b(; boundary=NEW; ); boundary="OLD"', one, other
    )


def prefixed_boundary(one, other):
    """Boundary lines that go on."""
    (text, signature), (text2, signature2) = parts_of(one), parts_of(other)
    lines = [
        *(b"--Xa", text.removesuffix(b"\n"), b"--Xa", signature.rstrip(), b"", b"--X--junk"),
        *(b"--X", text2.removesuffix(b"\n"), b"--X", signature2.rstrip(), b"", b"--X--"),
    ]
    head = [b"MIME-Version: 1.0", b"Content-Type: multipart/signed; boundary=X", b""]
    return b"\n".join([*head, *lines, b""])


def long_header(one, other):
    """A header line that OpenSSL takes for two."""
    header = b"Content-Type: multipart/signed; boundary="
    long = (b"X-Long: " + b"a" * 1023)[:1023] + header + b"OLD"
    return _both(long + b"\n" + header + b"NEW", one, other)


def vertical_tab(one, other):
    """White space that only OpenSSL takes for such."""
    header = b"multipart/signed; boundary="
    lines = [b"Content-Type:\x0b" + header + b"OLD", b"Content-Type: " + header + b"NEW"]
    return _both(b"\n".join(lines), one, other)


CONSTRUCTIONS = (
    quoted_parameter,
    commented_parameter,
    prefixed_boundary,
    long_header,
    vertical_tab,
)
"""Each of (one, other): OpenSSL reads the document of `one`."""
