"""The signature of a report: a signed statement of its SHA-512, in a file beside it.

The report itself stays as it is, for browsers and programs. The statement is a line of `sha512sum`,
in the same S/MIME form as documents. It can never be taken for one: documents are XML.
"""

import hashlib
import re
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.problems import Code, Problem

MAX_REPORT = 256 << 20
"""Bytes. As JSON, the report of 2,000 robots with 20 rights each has 5 MB."""
_STATEMENT = re.compile(rb"([0-9a-f]{128})  ([^/\r\n]+)\r?\n")


def signature_path(report: Path) -> Path:
    """The path of the signature of the report at that path."""
    return report.with_name(f"{report.name}.p7s")


def statement_of(report: Path, data: bytes) -> bytes:
    """The octets to sign for a report with the content `data`.

    UsageError if the file's name has characters that are not printable.
    """
    if not report.name.isprintable():
        raise UsageError(
            f"the name {report.name!r} has characters that are not printable",
            hint="choose another name for the report",
        )
    return f"{hashlib.sha512(data).hexdigest()}  {report.name}\n".encode()


def refuse_changed(document: bytes, signature: Path) -> Path | None:
    """The path of the report that `document` in the file `signature` is about.

    None if `document` is not such a statement; whether it was signed is not checked here.
    VerificationError if the report was changed, or if `signature` is not named after it: a reader
    of june.html must not read that may.html is genuine. MissingError if it is not there.
    """
    found = _STATEMENT.fullmatch(document)
    if not found:
        return None
    name = found[2].decode(errors="surrogateescape")
    if signature.name != f"{name}.p7s":
        words = f"{signature} is the signature of {name}, and is not named after it"
        raise VerificationError(
            Problem(words, Code.WRONG_SUBJECT), hint="give both files their names again"
        )
    report = signature.parent / name
    data = read(report, limit=MAX_REPORT)
    if hashlib.sha512(data).hexdigest() != found[1].decode():
        words = f"{report} was changed after signing"
        raise VerificationError(Problem(words, Code.CONTENT_CHANGED))
    return report
