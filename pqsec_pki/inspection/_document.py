"""Describes governance and permissions, signed or not."""

from datetime import datetime

from pqsec_pki._times import exact
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Governance, Kind, Permissions, validate
from pqsec_pki.errors import InvalidDocumentError, MalformedError
from pqsec_pki.inspection import _algorithms, _governance, _permissions
from pqsec_pki.inspection.description import Description, Fact, Value
from pqsec_pki.smime import CmsContent, ListedSigner, document_in, signers_in

NOT_VERIFIED = "not verified; `pqsec verify` does that"
UNSIGNED = "none: no DDS stack accepts it until it is signed (`pqsec sign-{kind}`)"


def describe_document(xml: bytes, now: datetime) -> Description:
    """The description of the XML document; InvalidDocumentError if it breaks its schema."""
    kind, fact = _content(xml, now)
    unsigned = Fact.of("signatures", (), UNSIGNED.format(kind=kind))
    return Description(
        f"{kind} document", f"{kind.capitalize()} document, unsigned", (unsigned, fact)
    )


def describe_signed(message: bytes, now: datetime) -> Description:
    """The description of the signed document and its signatures, which are not verified."""
    listed = signers_in(message)
    try:
        kind, fact = _content(document_in(message), now)
    except InvalidDocumentError as error:
        kind, fact = _broken(*map(str, error.problems))
    except MalformedError as error:
        kind, fact = _broken(str(error))
    facts = (*_signatures(listed), *_certificates(listed), fact)
    title = f"{kind.capitalize()} document, signed"
    return Description(f"signed {kind} document", title, facts)


def _broken(*problems: str) -> tuple[str, Fact]:
    return "broken", Fact.of("problems", problems, *problems)


def _content(xml: bytes, now: datetime) -> tuple[str, Fact]:
    kind = validate(xml)
    if kind is Kind.GOVERNANCE:
        return kind.value, _governance.governance_fact(Governance.from_xml(xml))
    return kind.value, _permissions.permissions_fact(Permissions.from_xml(xml), now)


def _signatures(listed: CmsContent) -> tuple[Fact, ...]:
    rows = [("signatures", NOT_VERIFIED)]
    for number, signer in enumerate(listed.signers, 1):
        first, *rest = _signer_words(signer)
        rows += [(f"signature {number}", first), *(("", line) for line in rest)]
    values = tuple(map(_signer_value, listed.signers))
    return (Fact("signatures", values, tuple(rows)), Fact("verified", value=False, rows=()))


def _signer_words(signer: ListedSigner) -> list[str]:
    name = _algorithms.algorithm_name(_algorithms.oid_of(signer.identifier))
    when = f", signing time {exact(signer.signed_at)}" if signer.signed_at else ""
    lines = [f"{name}, digest {signer.digest}{when}", f"by {_who(signer)}"]
    for counter in signer.countersigners:
        first, *rest = _signer_words(counter)
        lines += [f"  countersigned: {first}", *(f"  {line}" for line in rest)]
    return lines


def _who(signer: ListedSigner) -> str:
    if signer.serial_number is not None:
        return f"the certificate with serial {signer.serial_number:x} of issuer {signer.issuer}"
    return f"the certificate with key identifier {(signer.key_identifier or b'').hex()}"


def _signer_value(signer: ListedSigner) -> dict[str, Value]:
    serial = signer.serial_number
    return {
        "issuer": signer.issuer,
        "serial": None if serial is None else f"{serial:x}",
        "key_identifier": signer.key_identifier.hex() if signer.key_identifier else None,
        "algorithm": _algorithms.algorithm_name(_algorithms.oid_of(signer.identifier)),
        "digest": signer.digest,
        "signed_at": signer.signed_at.isoformat() if signer.signed_at else None,
        "countersignatures": tuple(map(_signer_value, signer.countersigners)),
    }


def _certificates(listed: CmsContent) -> tuple[Fact, ...]:
    subjects = tuple(map(_subject, listed.certificates))
    words = subjects or ("none; stock DDS stacks need the signer's",)
    return (Fact.of("embedded certificates", subjects, *words),)


def _subject(der: bytes) -> str:
    try:
        certificate = Certificate.from_der(der)
    except MalformedError:
        return "unreadable"
    return f"{certificate.subject_name}, serial {certificate.serial_number:x}"
