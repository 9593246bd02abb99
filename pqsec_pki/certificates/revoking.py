"""Issue revocation lists (RFC 5280 5), signed with the CA's keys.

Complete lists of one CA only; revocation.py reads them.
"""

from collections.abc import Iterable
from datetime import datetime, timedelta
from enum import StrEnum

from cryptography import x509

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    Extension,
    Oid,
    RevokedEntry,
    Signed,
    TBSCertList,
    bits,
    decode,
    encode,
    raw,
    time_of,
)
from pqsec_pki.certificates import _alternative
from pqsec_pki.certificates.authority import BACKDATE, Authority, cut, end_of, key_identifier
from pqsec_pki.certificates.revocation import MAX_DER, RevocationList, RevokedCertificate
from pqsec_pki.errors import TooLargeError

_SHORTER = (
    "certificates that have ended are not on the list: issue for a shorter time; new CAs begin an"
    " empty list: `pqsec ca rotate`"
)


class Reason(StrEnum):
    """The reason why a participant's certificate is revoked (RFC 5280 5.3.1).

    Not included: removeFromCRL is for delta lists, cACompromise and aACompromise are for
    CAs, and certificateHold can be lifted, which no DDS stack supports.
    """

    UNSPECIFIED = "unspecified"
    KEY_COMPROMISE = "keyCompromise"
    AFFILIATION_CHANGED = "affiliationChanged"
    SUPERSEDED = "superseded"
    CESSATION_OF_OPERATION = "cessationOfOperation"
    PRIVILEGE_WITHDRAWN = "privilegeWithdrawn"


def revocation_list(
    authority: Authority,
    revoked: Iterable[RevokedCertificate],
    *,
    number: int,
    now: datetime,
    validity: timedelta,
) -> RevocationList:
    """The CA's revocation list with the CRL number `number`, valid until `now` + `validity`.

    It begins a day early, like certificates, and never expires after the CA. UsageError if
    the validity is invalid, PqsecError if the CA is expired or not yet valid,
    VerificationError if its certificate does not allow it to sign lists, TooLargeError for a list
    that could not be read.
    """
    certificate = authority.certificate
    end = cut(end_of(now, validity), certificate, now)
    entries = sorted(revoked, key=lambda each: each.serial_number)
    tbs = TBSCertList(
        version=1,
        signature=decode(AlgorithmIdentifier, authority.key.algorithm.identifier, "algorithm"),
        issuer=raw(certificate.subject_der),
        this_update=time_of(max(now - BACKDATE, certificate.not_before)),
        next_update=time_of(end),
        # 5.1.2.6: absent if there are none
        revoked_certificates=[raw(encode(_entry(each))) for each in entries] or None,
        crl_extensions=_extensions(authority, number),
    )
    made = _signed(tbs, authority)
    made.verify(certificate)
    return made


def _signed(tbs: TBSCertList, authority: Authority) -> RevocationList:
    if authority.alternative_key:
        _alternative.add_list_signature(tbs, authority.alternative_key)
    content = encode(tbs)
    signature = bits(authority.key.sign(content))
    whole = Signed(tbs=raw(content), signature_algorithm=tbs.signature, signature=signature)
    der = encode(whole)
    TooLargeError.check("the revocation list", len(der), MAX_DER, hint=_SHORTER)
    return RevocationList.from_der(der)


def _entry(revoked: RevokedCertificate) -> RevokedEntry:
    extensions = None
    # 5.3.1: unspecified is said by saying nothing
    if revoked.reason not in (None, Reason.UNSPECIFIED):
        extensions = [_extension(x509.CRLReason(x509.ReasonFlags(revoked.reason)))]
    return RevokedEntry(
        user_certificate=revoked.serial_number,
        revocation_date=time_of(revoked.revoked_at),
        crl_entry_extensions=extensions,
    )


def _extensions(authority: Authority, number: int) -> list[Extension]:
    """5.2.1 and 5.2.3: which key signs, as its certificate names it, and the number."""
    known = authority.certificate.subject_key_identifier
    key = known or key_identifier(authority.key.public_key)
    return [
        _extension(x509.AuthorityKeyIdentifier(key, None, None)),
        _extension(x509.CRLNumber(number)),
    ]


def _extension(value: x509.ExtensionType) -> Extension:
    oid = Oid(value.oid.dotted_string)
    return Extension(extn_id=oid, critical=False, extn_value=value.public_bytes())
