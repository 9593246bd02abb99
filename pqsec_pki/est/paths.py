"""Paths, media types and limits of enrolment over HTTP: EST (RFC 7030) and pqsec's own."""

EST = "/.well-known/est"
"""RFC 7030 3.2.2; a label may follow."""
REQUESTS, BUNDLE, RECEIPTS = "/pqsec/v1/requests", "/pqsec/v1/bundle", "/pqsec/v1/receipts"
REVOCATION_LIST, HEAD = "/pqsec/v1/revocation-lists", "/pqsec/v1/head"

PKCS7 = "application/pkcs7-mime; smime-type=certs-only"
"""RFC 7030 4.1.3 and 4.2.3."""
PKCS10, CSRATTRS = "application/pkcs10", "application/csrattrs"
PEM_FILE, PKIX_CRL = "application/x-pem-file", "application/pkix-crl"
BUNDLE_TYPE, RECEIPT_TYPE = "application/vnd.pqsec.bundle", "application/vnd.pqsec.receipt"
PROBLEM, TEXT = "application/problem+json", "text/plain; charset=utf-8"
"""RFC 9457."""
REQUEST_ENDED = "/pqsec/v1/problems/request-ended"
"""The type of a problem (RFC 9457 3.1.1): the server never answers this request, and may answer
another one."""
WAS_REVOKED = "/pqsec/v1/problems/revoked"
"""Likewise: the participant was revoked, and only a token that was made since admits it."""
