"""Rules about signed documents: their S/MIME form, and who signed them.

Every stack reads them with OpenSSL's SMIME_read_PKCS7 and PKCS7_verify. Each form was
measured in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1, 3.1.2 and 3.6.2.
"""

import re
from collections.abc import Iterator

from pqsec_pki.algorithms import Family as Strength
from pqsec_pki.certificates import Certificate, name_text
from pqsec_pki.lint import _signatures
from pqsec_pki.lint._roles import family_of
from pqsec_pki.lint._signatures import Pair
from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import Inventory
from pqsec_pki.smime import is_canonical

FAMILY = Family("cross-artefact")
_ALL = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2"
_SIGN = "Sign the XML with `pqsec sign-governance` or `pqsec sign-permissions`."
_BLANK_FIRST = re.compile(rb"[ \t]*\r?\n")
_SIGNED_NAME = re.compile(r".*\.(p7s|p7m|smime)", re.IGNORECASE)


@FAMILY.rule(
    "PQS330", Severity.ERROR, File, "a signed document is not in S/MIME",
    why="Stacks read only multipart/signed. They do not read PEM, DER, plain XML, or a message that"
    " encloses the text (without OpenSSL's -nodetach, or DetachedSignature).",
    fix=_SIGN,
    rows=("PEM or DER p7 instead of S/MIME", "no DetachedSignature (opaque)"), measured=_ALL,
)  # fmt: skip
def not_smime(file: File) -> Iterator[Violation]:
    if file.is_signed or file.unreadable or not _SIGNED_NAME.fullmatch(file.path.name):
        return
    if form := _form(file):
        yield Violation(f"{form}; stacks read only S/MIME (multipart/signed)")


@FAMILY.rule(
    "PQS331", Severity.ERROR, File, "the signed text is not text/plain",
    why="Stacks verify with PKCS7_TEXT. Without exactly this header they report 'SMIME_text: mime"
    " no content type', or nothing.",
    fix="Sign with -text (OpenSSL) or PKCS7Options.Text, or with pqsec.",
    rows=(
        "no Text flag (`Detached` only)", "`Detached+Binary`",
        "inner `text/xml` or `application/xml`", "inner Content-Type absent",
    ),
    measured=_ALL,
)  # fmt: skip
def not_text(file: File) -> Iterator[Violation]:
    if _signatures.listed(file) and _signatures.text(file) is None and not file.is_ambiguous:
        yield Violation("the signed text has no header 'Content-Type: text/plain'")


@FAMILY.rule(
    "PQS332", Severity.ERROR, File, "a signed document begins with a blank line",
    why="OpenSSL reads the blank line as the end of the header, and finds no content type.",
    fix="Remove the blank line; the signature does not cover it.",
    rows=("blank first line",), measured=_ALL,
)  # fmt: skip
def blank_first(file: File) -> Iterator[Violation]:
    if file.is_signed and _BLANK_FIRST.match(file.data):
        yield Violation("begins with a blank line, so stacks find no header", 1)


@FAMILY.rule(
    "PQS333", Severity.ERROR, File, "a signed document is broken",
    why="No stack can read it.",
    fix=_SIGN,
)  # fmt: skip
def broken(file: File) -> Iterator[Violation]:
    if file.is_signed and not file.is_ambiguous and (reason := _signatures.trouble(file)):
        yield Violation(f"cannot be read: {reason}")


@FAMILY.rule(
    "PQS334", Severity.ERROR, File, "the document identifies its signer by a key identifier",
    why="Stacks read PKCS #7 1.5, which identifies signers only by issuer and serial number.",
    fix="Sign without -keyid.",
    rows=("SignerInfo by key id (`cms -keyid`)",), measured=_ALL,
)  # fmt: skip
def by_key_identifier(file: File) -> Iterator[Violation]:
    signers = _signatures.signers(file)
    if any(signer.key_identifier is not None for signer in signers):
        yield Violation("names its signer by key identifier, which no stack reads")


@FAMILY.rule(
    "PQS335", Severity.ERROR, File, "the document does not have exactly one signature",
    why="Every stack refuses a document with two signers, such as ECDSA and ML-DSA, in any order. A"
    " second signature can be in an unsigned attribute, as pqsec writes it.",
    fix=_SIGN,
    rows=(
        "two SignerInfos EC + ML-DSA (any order, any CA arrangement)",
        "two SignerInfos EC + EC, same CA",
    ),
    measured=_ALL,
)  # fmt: skip
def not_one_signer(file: File) -> Iterator[Violation]:
    listed = _signatures.listed(file)
    if listed and len(listed.signers) != 1:
        yield Violation(f"has {len(listed.signers)} signatures; stacks accept exactly one")


@FAMILY.rule(
    "PQS336", Severity.ERROR, Inventory, "the signer's certificate is not in the document",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 search for it only in the document.",
    fix="Sign without -nocerts, or run `pqsec sign-permissions --embed-certificate`.",
    stacks=(Target.CYCLONEDDS, Target.FASTDDS),
    rows=("`NoCerts`",), measured="Cyclone DDS 0.10.2, 0.10.5; Fast DDS 2.9.1",
)  # fmt: skip
def without_certificate(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        listed = _signatures.listed(pair.file)
        if listed and not listed.certificates and _is_for_stock(pair):
            words = "lacks the signer's certificate: Cyclone DDS 0.10 and Fast DDS 2.9"
            yield Violation(f"{words} refuse it", path=pair.file.path)


@FAMILY.rule(
    "PQS337", Severity.ERROR, File, "the document is signed with a broken hash",
    why="An attacker who gets one document signed can create a second one with the same SHA-1 or"
    " MD5 digest. The signature is valid for both. Stacks accept it; pqsec peers refuse it.",
    fix=_SIGN,
)  # fmt: skip
def broken_digest(file: File) -> Iterator[Violation]:
    for digest in _signatures.broken_digests(file):
        yield Violation(f"signed with {digest}")


@FAMILY.rule(
    "PQS338", Severity.WARNING, Inventory, "pqsec cannot check the signature",
    why="Stacks may accept it: OpenSSL supports more keys and digests than pqsec, and signatures"
    " without signed attributes. pqsec peers refuse it. This check cannot tell whether the document"
    " was changed.",
    fix="Sign it without -noattr, with SHA-256 and an ecdsa-p256 or RSA key, or with pqsec.",
    measured="`NoAttributes` is taken by " + _ALL,
)  # fmt: skip
def cannot_be_checked(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        reason = _signatures.uncheckable(pair)
        if reason and not _signatures.broken_digests(pair.file):
            yield Violation(f"the signature was not checked: it has {reason}", path=pair.file.path)


@FAMILY.rule(
    "PQS340", Severity.ERROR, Inventory, "the permissions CA did not sign the document",
    why="Cyclone DDS 11, Fast DDS 3 and OpenDDS refuse a document that another certificate below"
    " the CA signed. On stacks that accept it, any such certificate can give itself permissions.",
    fix="Sign with the permissions CA itself.",
    rows=("document signed by leaf or intermediate under the CA, CA file = root",),
    measured=_ALL,
)  # fmt: skip
def of_another_signer(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        signers = _signatures.signers(pair.file)
        if signers and not any(_signatures.is_by(signer, pair.ca) for signer in signers):
            yield Violation(_by_another(pair), path=pair.file.path)


@FAMILY.rule(
    "PQS341", Severity.ERROR, Inventory, "the signature is not valid",
    why="The document was changed after signing, or another key signed it in the CA's name. Every"
    " stack refuses it.",
    fix="Find out who changed the document, and sign it again.",
    rows=("tampered",), measured=_ALL,
)  # fmt: skip
def does_not_hold(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        for problem in _signatures.plain_problems(pair):
            yield Violation(problem, path=pair.file.path)


@FAMILY.rule(
    "PQS342", Severity.WARNING, Inventory, "the XML file differs from the signed document",
    why="Stacks read the signed document. A reader of the XML file next to it is misled.",
    fix="Sign the XML file again, or remove it.",
)  # fmt: skip
def differs_from_xml(inventory: Inventory) -> Iterator[Violation]:
    files = {file.path: file for file in inventory.files}
    for file in inventory.files:
        plain = files.get(file.path.with_suffix(".xml"))
        text = _signatures.text(file) if file.is_signed and plain else None
        if plain and text is not None and _lines(text) != _lines(plain.data):
            yield Violation(f"differs from {plain.path.name}", path=file.path)


@FAMILY.rule(
    "PQS343", Severity.ERROR, File, "programs can read different documents from a signed file",
    why="OpenSSL, which every stack uses, differs from RFC 2045 and 2046: for quotes, comments,"
    " long lines, and lines that begin like the boundary. One file can therefore contain two"
    " documents with valid signatures, one for a human reader and one for the stacks. pqsec refuses"
    " such a file from any signer.",
    fix="Find out who created the file, ask the signer for the document, and sign it again.",
)  # fmt: skip
def ambiguous(file: File) -> Iterator[Violation]:
    if file.is_signed and file.is_ambiguous and not _BLANK_FIRST.match(file.data):
        yield Violation(str(file.signed_text[1]))


@FAMILY.rule(
    "PQS344", Severity.INFO, File, "a signed file is not in the form that pqsec writes",
    why="Every stack reads the same document from it. Some parts have no signature, for example"
    " additional headers, additional certificates, or another boundary. pqsec does not copy these"
    " parts: it installs and exports only what it verified.",
    fix="Nothing needs to be done. Signing again with pqsec writes its own form.",
)  # fmt: skip
def not_canonical(file: File) -> Iterator[Violation]:
    readable = file.is_signed and _signatures.text(file) is not None
    if readable and len(_signatures.signers(file)) == 1 and not is_canonical(file.data):
        yield Violation("has another form than pqsec writes; stacks read the same document from it")


def _is_for_stock(pair: Pair) -> bool:
    """Whether stock stacks can read the document: all keys are classical."""
    certificates = (pair.ca, *(each for _, each in pair.others))
    return all(family_of(each) is Strength.CLASSICAL for each in certificates)


def _form(file: File) -> str | None:
    """What the file is instead; None if that is unknown (PQS201 reports it)."""
    if file.data.lstrip()[:1] == b"<":
        return "is not signed"
    if "PKCS7" in file.labels or "CMS" in file.labels:
        return "is a signature in PEM"
    if b"pkcs7-mime" in file.data[:4096]:
        return "is an S/MIME message that encloses its text (opaque)"
    return "is a signature in DER" if file.data[:1] == b"\x30" else None


def _by_another(pair: Pair) -> str:
    """A message: who signed instead of the permissions CA, if document and enclave show it."""
    name, signers = pair.ca.subject_name, _signatures.signers(pair.file)
    if who := _known(pair):
        return f"signed by {who}, not by {name}"
    if all(signer.issuer != name_text(pair.ca.subject) for signer in signers):
        return f"signed by {signers[0].issuer or 'another key'}, not by {name}"
    certificate = next(_signatures.embedded(pair.file), None)
    if certificate is None:
        words = f"signed with a certificate whose issuer is {name}"
        return f"{words}: another CA with that name, or a certificate that the CA issued"
    if certificate.is_self_issued:
        return f"signed by another CA with the same name {name}, not by this one"
    return f"signed by a certificate that {name} issued, not by {name}"


def _known(pair: Pair) -> str | None:
    """The signer with its role, if it is one of the enclave's certificates."""
    signers = _signatures.signers(pair.file)
    known: list[tuple[str, Certificate]] = [
        (f"{role}, {certificate.subject_name}", certificate) for role, certificate in pair.others
    ]
    named = (who for who, each in known for one in signers if _signatures.is_by(one, each))
    return next(named, None)


def _lines(text: bytes) -> list[bytes]:
    return text.strip().splitlines()
