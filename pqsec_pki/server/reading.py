"""Reads what a client asks and shows, in the process that faces the network.

It refuses malformed requests, and signatures for another connection.
"""

import base64
import binascii

from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.errors import MalformedError
from pqsec_pki.est import (
    CERTIFICATE_HEADER,
    SCHEME,
    from_base64,
    verify_est_request,
    verify_signed,
)
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.channel import LimitedRequest
from pqsec_pki.server.routes import Route

_ONLY_OWN = "a signed request is for paths of pqsec, and without a client certificate"
_BASIC = "Authorization must be Basic, once, with the token's id and secret"


def signer_call(route: Route, request: LimitedRequest, address: str) -> SignerCall:
    """What to ask the signer.

    MalformedError for what is not a request, or wrong credentials; VerificationError for a request
    that EST's rules refuse.
    """
    token, secret = _credentials(request)
    return SignerCall(
        kind=route.kind,
        label=route.label,
        address=address,
        token=token,
        secret=secret,
        certificate=_certificate(route, request),
        chain=request.channel.peer_chain(),
        body=_content(route, request),
    )


def _content(route: Route, request: LimitedRequest) -> bytes:
    """The DER of a request, or a receipt; errors as of `signer_call`."""
    body = request.content.read()
    if not route.kind.issues:
        return body if route.kind is CallKind.RECEIPT else b""
    if route.is_est:
        found = CertificateRequest.from_der(from_base64(body))
        renews = route.kind is CallKind.REENROL
        verify_est_request(found, request.channel.connection, renews=renews)
        return found.der
    if body.lstrip().startswith(b"-----"):
        match CertificateRequest.all_from_pem(body):
            case (found,):
                return found.der
        raise MalformedError("send one request at a time")
    return CertificateRequest.from_der(body).der


def _certificate(route: Route, request: LimitedRequest) -> bytes:
    """The certificate whose key the client has, by TLS or by a signature over this request.

    MalformedError for both, and in EST, which has no such signature.
    """
    shown, signatures = request.channel.peer(), _signatures(request)
    if not signatures:
        return shown
    if shown or route.is_est:
        raise MalformedError(_ONLY_OWN)
    return verify_signed(
        request.channel.connection,
        method=request.method.decode("ascii"),
        path=request.path.decode("ascii"),
        body=request.content.getvalue(),
        certificates=values_of(request, CERTIFICATE_HEADER),
        signatures=signatures,
    ).der


def _signatures(request: LimitedRequest) -> str:
    """The credentials after the scheme of signed requests; empty for another scheme."""
    given = values_of(request, "Authorization")
    scheme, _, value = given[0].partition(" ") if len(given) == 1 else ("", "", "")
    return value if scheme.upper() == SCHEME else ""


def _credentials(request: LimitedRequest) -> tuple[str, str]:
    """The token's identifier and secret (RFC 7617); MalformedError for another scheme."""
    given = values_of(request, "Authorization")
    if not given or _signatures(request):
        return "", ""
    scheme, _, value = given[0].partition(" ")
    if len(given) > 1 or scheme.lower() != "basic":
        raise MalformedError(_BASIC)
    try:
        text = base64.b64decode(value.strip(), validate=True).decode("ascii")
    except (ValueError, binascii.Error):
        raise MalformedError(_BASIC) from None
    token, _, secret = text.partition(":")
    return token, secret


def media_type_of(request: LimitedRequest) -> str:
    """The media type of what is sent, without parameters; empty if it has none."""
    given = values_of(request, "Content-Type") or [""]
    return given[0].partition(";")[0].strip().lower()


def values_of(request: LimitedRequest, name: str) -> list[str]:
    """The values of that header, which may have any octets (RFC 9110 5.5)."""
    found = request.requestHeaders.getRawHeaders(name.encode(), [])
    return [each.decode("latin-1") for each in found]
