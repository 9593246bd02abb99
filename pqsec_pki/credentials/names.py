"""The names of an enclave's files, as in SROS2, and those that pqsec adds."""

CERTIFICATE, KEY, ALT_KEY = "cert.pem", "key.pem", "alt.key.pem"
IDENTITY_CA, PERMISSIONS_CA = "identity_ca.cert.pem", "permissions_ca.cert.pem"
PERMISSIONS_ALT_CA = "permissions_ca.alt.cert.pem"
"""The countersigner's certificate, if documents are signed twice."""
PERMISSIONS, GOVERNANCE = "permissions.p7s", "governance.p7s"
REVOCATION_LIST = "crl.pem"
REQUEST = "request.pem"
"""The certificate request, if a participant's keys are only on its robot; no stack reads it."""
ENCLAVES = "enclaves"
"""The folder of all enclaves."""

KEYS = (KEY, ALT_KEY)
"""Private keys, always with mode 0600."""
NEEDED = (CERTIFICATE, PERMISSIONS, GOVERNANCE, IDENTITY_CA, PERMISSIONS_CA)
"""Required files without the keys, which may be only on the participant's robot."""
SIX = (IDENTITY_CA, CERTIFICATE, KEY, PERMISSIONS_CA, GOVERNANCE, PERMISSIONS)
"""The files that every stack needs; ROS 2 does not report which one is missing."""
CA_FILES = (IDENTITY_CA, PERMISSIONS_CA, PERMISSIONS_ALT_CA)
FILES = (*NEEDED, PERMISSIONS_ALT_CA, REVOCATION_LIST, *KEYS)
"""All files of an enclave that a stack reads; never a CA's private key."""
