"""Rules about the S/MIME form of signed documents.

Every stack reads them with OpenSSL's SMIME_read_PKCS7 and PKCS7_verify. Each form was
measured in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1, 3.1.2 and 3.6.2.
"""

import re
from collections.abc import Iterator

from pqsec_pki.lint.file import File, SmimeFile
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.signed import broken_digests
from pqsec_pki.smime import is_canonical

_SIGN = "Sign the XML with `pqsec sign-governance` or `pqsec sign-permissions`."
_BLANK_FIRST = re.compile(rb"[ \t]*\r?\n")
_SIGNED_NAME = re.compile(r".*\.(p7s|p7m|smime)", re.IGNORECASE)


@lint_rule(
    "PQS330", Severity.ERROR, "a signed document is not in S/MIME",
    why="Stacks read only multipart/signed. They do not read PEM, DER, plain XML, or a message that"
    " encloses the text (without OpenSSL's -nodetach, or DetachedSignature).",
    fix=_SIGN,
    rows=("PEM or DER p7 instead of S/MIME", "no DetachedSignature (opaque)"), measured=SIX_STACKS,
    bad="$ cp k/enclaves/talker/permissions.xml permissions.p7s",
    good="""
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml -o permissions.p7s
    """,
)  # fmt: skip
def not_smime(file: File) -> Iterator[Violation]:
    if file.is_signed or file.unreadable or not _SIGNED_NAME.fullmatch(file.path.name):
        return
    if form := _form(file):
        yield Violation(f"{form}; stacks read only S/MIME (multipart/signed)")


@lint_rule(
    "PQS331", Severity.ERROR, "the signed text is not text/plain",
    why="Stacks verify with PKCS7_TEXT. Without exactly this header they report 'SMIME_text: mime"
    " no content type', or nothing.",
    fix="Sign with -text (OpenSSL) or PKCS7Options.Text, or with pqsec.",
    rows=(
        "no Text flag (`Detached` only)", "`Detached+Binary`",
        "inner `text/xml` or `application/xml`", "inner Content-Type absent",
    ),
    measured=SIX_STACKS,
    bad=r"""
        $ openssl smime -sign -in k/enclaves/talker/permissions.xml -out permissions.p7s \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem
    """,
    good=r"""
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def not_text(file: SmimeFile) -> Iterator[Violation]:
    if file.listed and file.signed_text[0] is None and not file.is_ambiguous:
        yield Violation("the signed text has no header 'Content-Type: text/plain'")


@lint_rule(
    "PQS332", Severity.ERROR, "a signed document begins with a blank line",
    why="OpenSSL reads the blank line as the end of the header, and finds no content type.",
    fix="Remove the blank line; the signature does not cover it.",
    rows=("blank first line",), measured=SIX_STACKS,
    bad="$ (echo; cat k/enclaves/talker/permissions.p7s) > permissions.p7s",
    good="$ sed -i 1d permissions.p7s",
)  # fmt: skip
def blank_first(file: SmimeFile) -> Iterator[Violation]:
    if _BLANK_FIRST.match(file.data):
        yield Violation("begins with a blank line, so stacks find no header", 1)


@lint_rule(
    "PQS333", Severity.ERROR, "a signed document is broken",
    why="No stack can read it.",
    fix=_SIGN,
    bad="$ head -c 2000 k/enclaves/talker/permissions.p7s > permissions.p7s",
    good="$ cp k/enclaves/talker/permissions.p7s .",
)  # fmt: skip
def broken(file: SmimeFile) -> Iterator[Violation]:
    if not file.is_ambiguous and (reason := file.signature_error):
        yield Violation(f"cannot be read: {reason}")


@lint_rule(
    "PQS334", Severity.ERROR, "the document identifies its signer by a key identifier",
    why="Stacks read PKCS #7 1.5, which identifies signers only by issuer and serial number.",
    fix="Sign without -keyid.",
    rows=("SignerInfo by key id (`cms -keyid`)",), measured=SIX_STACKS,
    bad=r"""
        $ openssl cms -sign -text -keyid -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl cms -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def by_key_identifier(file: SmimeFile) -> Iterator[Violation]:
    signers = file.signers
    if any(signer.key_identifier is not None for signer in signers):
        yield Violation("names its signer by key identifier, which no stack reads")


@lint_rule(
    "PQS335", Severity.ERROR, "the document does not have exactly one signature",
    why="Every stack refuses a document with two signers, such as ECDSA and ML-DSA, in any order. A"
    " second signature can be in an unsigned attribute, as pqsec writes it.",
    fix=_SIGN,
    rows=(
        "two SignerInfos EC + ML-DSA (any order, any CA arrangement)",
        "two SignerInfos EC + EC, same CA",
    ),
    measured=SIX_STACKS,
    bad=r"""
        $ openssl cms -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -signer k/public/identity_ca.cert.pem -inkey k/private/identity_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl cms -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def not_one_signer(file: SmimeFile) -> Iterator[Violation]:
    listed = file.listed
    if listed and len(listed.signers) != 1:
        yield Violation(f"has {len(listed.signers)} signatures; stacks accept exactly one")


@lint_rule(
    "PQS337", Severity.ERROR, "the document is signed with a broken hash",
    why="An attacker who gets one document signed can create a second one with the same SHA-1 or"
    " MD5 digest. The signature is valid for both. Stacks accept it; pqsec peers refuse it.",
    fix=_SIGN,
    bad=r"""
        $ openssl smime -sign -text -md sha1 -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl smime -sign -text -md sha256 -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def broken_digest(file: SmimeFile) -> Iterator[Violation]:
    for digest in broken_digests(file):
        yield Violation(f"signed with {digest}")


@lint_rule(
    "PQS343", Severity.ERROR, "programs can read different documents from a signed file",
    why="OpenSSL, which every stack uses, differs from RFC 2045 and 2046: for quotes, comments,"
    " long lines, and lines that begin like the boundary. One file can therefore contain two"
    " documents with valid signatures, one for a human reader and one for the stacks. pqsec refuses"
    " such a file from any signer.",
    fix="Find out who created the file, ask the signer for the document, and sign it again.",
    bad="$ cp elsewhere/ambiguous.p7s permissions.p7s",
    good="$ cp k/enclaves/talker/permissions.p7s .",
)  # fmt: skip
def ambiguous(file: SmimeFile) -> Iterator[Violation]:
    if file.is_ambiguous and not _BLANK_FIRST.match(file.data):
        yield Violation(str(file.signed_text[1]))


@lint_rule(
    "PQS344", Severity.INFO, "a signed file is not in the form that pqsec writes",
    why="Every stack reads the same document from it. Some parts have no signature, for example"
    " additional headers, additional certificates, or another boundary. pqsec does not copy these"
    " parts: it installs and exports only what it verified.",
    fix="Nothing needs to be done. Signing again with pqsec writes its own form.",
    bad=r"$ sed 's/$/\r/' k/enclaves/talker/permissions.p7s > permissions.p7s",
    good="$ cp k/enclaves/talker/permissions.p7s .",
)  # fmt: skip
def not_canonical(file: SmimeFile) -> Iterator[Violation]:
    if file.signed_text[0] is not None and len(file.signers) == 1 and not is_canonical(file.signed):
        yield Violation("has another form than pqsec writes; stacks read the same document from it")


def _form(file: File) -> str | None:
    """What the file is instead; None if that is unknown (PQS201 reports it)."""
    if file.data.lstrip()[:1] == b"<":
        return "is not signed"
    if "PKCS7" in file.labels or "CMS" in file.labels:
        return "is a signature in PEM"
    if b"pkcs7-mime" in file.data[:4096]:
        return "is an S/MIME message that encloses its text (opaque)"
    return "is a signature in DER" if file.data[:1] == b"\x30" else None
