"""The tables of docs/reference/wire-tables.md: names, OIDs, sizes and limits."""

import re
from collections.abc import Iterator

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, SignatureAlgorithm
from pqsec_pki.algorithms._agreement import Hybrid, KeyAgreement
from pqsec_pki.algorithms._composite import Composite
from pqsec_pki.algorithms._pair import SignaturePair
from pqsec_pki.algorithms._pbes2 import MAX_ITERATIONS
from pqsec_pki.certificates.certificate import MAX_CERTIFICATE
from pqsec_pki.certificates.request import MAX_REQUEST
from pqsec_pki.certificates.revocation import MAX_DER, MAX_LIST
from pqsec_pki.documents._schema import MAX_PROBLEMS
from pqsec_pki.documents._xml import MAX_DOCUMENT
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE, MAX_CONTENT, MAX_MEMBERS
from pqsec_pki.handshake import KeyMaterial, TransformationKind, compact
from pqsec_pki.handshake._secured import MAX_RECEIVERS, Secure
from pqsec_pki.handshake.protection import MAX_PAYLOAD, MAX_SUBMESSAGE
from pqsec_pki.handshake.wire import MAX_PROPERTIES, MAX_SAMPLE, MAX_TOKEN, MAX_TOKENS
from pqsec_pki.smime._ber import MAX_CHILDREN, MAX_DEPTH, MAX_SIZE
from pqsec_pki.smime._mime import MAX_MESSAGE
from pqsec_pki.smime.document import MAX_CARRIED, MAX_CARRIED_VALUES
from tests.docs.rows import table

HEAD = """These tables belong to [the wire specification](wire.md), and are normative like its
sections 3 to 13. *From* is the origin: `1.1` is DDS-Security 1.1; `1.2` is a name of DDS-Security
1.2 as third parties document it, not checked against that text; `pqsec` is new. Sizes are in
octets."""
PAIRS = (("ecdsa-p256", "ml-dsa-65"), ("ecdsa-p384", "ml-dsa-87"), ("rsa-2048", "ml-dsa-44"))
_FROM = {"ecdsa-p256": "1.1", "rsa-2048": "1.1", "ecdsa-p384": "1.2"}
_FROM |= {"ecdh-p256": "1.1", "dh-modp-2048-256": "1.1", "ecdh-p384": "1.2"}
_SENT = {
    "ecdh-p256": ("P-256",) * 3,
    "ecdh-p384": ("P-384",) * 3,
    "dh-modp-2048-256": ("number",) * 3,
    "x25519": ("X25519",) * 3,
    "mlkem768": ("ML-KEM-768 key", "ciphertext", "ML-KEM"),
    "mlkem1024": ("ML-KEM-1024 key", "ciphertext", "ML-KEM"),
}
"""What is in dh1, dh2 and the secret."""
LIMITS = {
    "a token": MAX_TOKEN,
    "a sample": MAX_SAMPLE,
    "a certificate": MAX_CERTIFICATE,
    "`id` of the second version, inflated": compact.MAX_CREDENTIALS,
    "the CMS structure in `id`": MAX_CARRIED,
    "ASN.1 values in that structure": MAX_CARRIED_VALUES,
    "properties in one list": MAX_PROPERTIES,
    "tokens in one message": MAX_TOKENS,
    "a submessage to be protected": MAX_SUBMESSAGE,
    "a payload to be protected": MAX_PAYLOAD,
    "receivers of one submessage": MAX_RECEIVERS,
}
FILE_LIMITS = {
    "a governance or permissions document": MAX_DOCUMENT,
    "a signed document": MAX_MESSAGE,
    "the CMS structure in it": MAX_SIZE,
    "nesting of BER in that structure": MAX_DEPTH,
    "parts in one of its BER values": MAX_CHILDREN,
    "a certificate": MAX_CERTIFICATE,
    "a certificate request": MAX_REQUEST,
    "a revocation list in PEM": MAX_LIST,
    "a revocation list in DER": MAX_DER,
    "a bundle, as a file": MAX_ARCHIVE,
    "a bundle, unpacked": MAX_CONTENT,
    "files in a bundle": MAX_MEMBERS,
    "PBKDF2 iterations of an encrypted key": MAX_ITERATIONS,
    "problems reported of one document": MAX_PROBLEMS,
}


def parts() -> Iterator[str]:
    """The title, and the sections."""
    yield from ("# The wire: names, sizes and limits", HEAD)
    single = [each for each in SIGNATURES if not isinstance(each, Composite)]
    heads = ("Key", "`c.dsign_algo`", "`*.algo`", "Signature, octets", "From")
    yield from ("## Signatures", _SIGNATURES, table(heads, map(_signature, single)))
    heads = ("`c.kagree_algo`", "`dh1`", "Octets", "`dh2`", "Octets", "Secret", "Octets")
    heads += ("SharedSecret", "From")
    yield from ("## Key agreements", _AGREEMENTS, table(heads, map(_agreement, KEY_AGREEMENTS)))
    heads = ("`c.dsign_algo`", "OID", "Prehash", "ML-DSA", "Other", "Signature, octets")
    composites = [each for each in SIGNATURES if isinstance(each, Composite)]
    yield from ("## Composites", _COMPOSITES, table(heads, map(_composite, composites)))
    heads = ("Plain key", "Alternative key", "`c.dsign_algo`", "Alternative's, octets")
    yield from ("## Pairs", _PAIRS, table((*heads, "Whole signature, octets"), map(_pair, PAIRS)))
    heads = ("Kind", "Name", "Key and salt, octets", "Content", "Key material, octets")
    kinds = table((*heads, "With receiver key"), map(_kind, TransformationKind))
    yield from ("## Kinds of protection", _KINDS, kinds)
    submessages = ((f"SEC_{each.name}", f"`{each.value:02x}`") for each in Secure)
    yield from ("## Secure submessages", _SECURE, table(("Submessage", "Kind"), submessages))
    dictionary = compact.CREDENTIALS_DICTIONARY.decode()
    yield from ("## The dictionary", _DICTIONARY, f"```xml\n{dictionary}```")
    yield from ("## Limits", _LIMITS, _limits("Limit", LIMITS))
    yield from ("## Limits of files", _FILE_LIMITS, _limits("Limit of files", FILE_LIMITS))


_SIGNATURES = "Section 6.1. Composites and pairs are below; pairs have the plain key's `*.algo`."
_AGREEMENTS = "Section 6.2 says how each value is encoded, and 8.3 how SharedSecret is computed."
_COMPOSITES = "Section 7.2. `*.algo` is the same name."
_PAIRS = "Section 7.3: a certificate with an alternative key."
_KINDS = "Section 12.2, the transformation_kind of key material."
_SECURE = "Section 12.4."
_DICTIONARY = (
    "Section 5.1. The preset dictionary of DEFLATE is this text; it ends with a line feed."
)
_LIMITS = "Section 13: pqsec's limits, in octets where it is a size."
_FILE_LIMITS = "Of [the formats](formats.md): what pqsec reads, in octets where it is a size."


def _limits(head: str, limits: dict[str, int]) -> str:
    return table((head, "Value"), ((name, str(value)) for name, value in limits.items()))


def _signature(algorithm: SignatureAlgorithm) -> tuple[str, ...]:
    names = (f"`{algorithm.wire_name}`", f"`{algorithm.token_name}`")
    source = _FROM.get(algorithm.name, "pqsec")
    return (
        _words(algorithm).replace("RSA-", "RSA "),
        *names,
        _size(algorithm, "DER, up to "),
        source,
    )


def _words(algorithm: SignatureAlgorithm) -> str:
    """As the field writes it: ECDSA P-256, Ed25519, RSA-2048-PSS."""
    name = re.sub(r"^ecdsa-p(256|384)$", r"ECDSA P-\1", algorithm.name)
    if name.startswith("ed"):
        return name.capitalize()
    return name.upper().replace("BRAINPOOL", "brainpool").replace("R1", "r1")


def _size(algorithm: SignatureAlgorithm, up_to: str = "up to ") -> str:
    varies = "ecdsa" in algorithm.name
    return f"{up_to if varies else ''}{algorithm.signature_size}"


def _agreement(agreement: KeyAgreement) -> tuple[str, ...]:
    halves = (agreement.first, agreement.second) if isinstance(agreement, Hybrid) else (agreement,)
    sent = [" ‖ ".join(each) for each in zip(*(_SENT[half.name] for half in halves), strict=True)]
    sizes = (agreement.public_size, agreement.ciphertext_size, agreement.secret_size)
    up_to = "up to " if agreement.wire_name.startswith("DH+") else ""
    cells = [
        cell for what, size in zip(sent, sizes, strict=True) for cell in (what, f"{up_to}{size}")
    ]
    kind = "bound" if agreement.binds_transcript else "plain"
    return (f"`{agreement.wire_name}`", *cells, kind, _FROM.get(agreement.name, "pqsec"))


def _composite(row: Composite) -> tuple[str, ...]:
    prehash = row.digest.name.upper().replace("_", "")
    names = (f"`{row.wire_name}`", row.key_oid, prehash)
    return (*names, _words(row.ml_dsa), _words(row.traditional), _size(row))


def _pair(names: tuple[str, str]) -> tuple[str, ...]:
    plain, alternative = map(SIGNATURES.named, names)
    pair = SignaturePair.of(plain, alternative)
    own = (f"`{pair.wire_name}`", str(alternative.signature_size), _size(pair))
    return (_words(plain).replace("RSA-", "RSA "), _words(alternative), *own)


def _kind(kind: TransformationKind) -> tuple[str, ...]:
    material = KeyMaterial.generate(kind)
    sizes = [str(len(material.encode()))]
    sizes.append(str(len(material.for_receiver().encode())) if kind else "")
    content = ("encrypted" if kind.encrypts else "signed") if kind else "as it is"
    return (str(kind.value), kind.name, str(kind.key_size), content, *sizes)
