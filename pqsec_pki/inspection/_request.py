"""Describes a certificate request, and verifies its proof of possession."""

from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import VerificationError
from pqsec_pki.inspection import _algorithms, _extensions
from pqsec_pki.inspection.description import Description, Fact


def describe_request(der: bytes) -> Description:
    """The description of the request in `der`; MalformedError if it is not a request."""
    request = CertificateRequest.from_der(der)
    signature = _algorithms.algorithm_name(_algorithms.oid_of(request.identifier))
    facts = (
        Fact.of("subject", request.subject_name),
        _algorithms.key_fact("key", request.spki),
        _algorithms.alternative_key_fact(request.alternative_spki),
        *(
            _algorithms.key_fact(f"key of set {number}", each.spki)
            for number, each in enumerate(request.further, 2)
        ),
        Fact.of("signature", signature),
        _proof(request),
        _extensions.extensions_fact("requests", request.extensions),
        _algorithms.spki_digest(request.spki),
        Fact.of("SHA-256", request.fingerprint, key="sha256"),
    )
    return Description("certificate request", f"Request for {request.subject_name}", facts)


def _proof(request: CertificateRequest) -> Fact:
    try:
        request.verify()
    except VerificationError as error:
        return Fact.of("proof", {"holds": False, "problems": error.lines}, *error.lines)
    both = " and the alternative key" if request.alternative else ""
    all_keys = " of each set" if request.further else both
    words = f"verified: the requester has the private key{all_keys}"
    return Fact.of("proof", {"holds": True, "problems": ()}, words)
