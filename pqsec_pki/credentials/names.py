"""The files of an enclave, by the names that SROS2 gave them, and what pqsec adds."""

CERTIFICATE, KEY, ALT_KEY = "cert.pem", "key.pem", "alt.key.pem"
IDENTITY_CA, PERMISSIONS_CA = "identity_ca.cert.pem", "permissions_ca.cert.pem"
PERMISSIONS_ALT_CA = "permissions_ca.alt.cert.pem"
"""The countersigner's certificate, where documents are signed twice."""
PERMISSIONS, GOVERNANCE = "permissions.p7s", "governance.p7s"
REVOCATION_LIST = "crl.pem"
REQUEST = "request.pem"
"""Beside its certificate, where a participant's keys are on its robot alone; no stack reads it."""
ENCLAVES = "enclaves"
"""The folder that enclaves lie in, by their paths."""

KEYS = (KEY, ALT_KEY)
"""The private ones; 0600 wherever they lie."""
NEEDED = (CERTIFICATE, PERMISSIONS, GOVERNANCE, IDENTITY_CA, PERMISSIONS_CA)
"""Without the keys, which may be on the participant's robot alone."""
CA_FILES = (IDENTITY_CA, PERMISSIONS_CA, PERMISSIONS_ALT_CA)
FILES = (*NEEDED, PERMISSIONS_ALT_CA, REVOCATION_LIST, *KEYS)
"""All that an enclave may hold and a stack reads; never a CA's key."""
