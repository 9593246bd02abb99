"""Private keys that never lie in a file: in PKCS#11 tokens, or held by another signer.

A key is named by a URI: `pkcs11:token=lab;object=identity` (RFC 7512), or one with the scheme
that an installed package handles (entry points `pqsec.signers`). In a keystore, a file that
refers to the key stands where its private key would be (`reference.py`). Only `_pkcs11.py` talks
to tokens, with python-pkcs11, which is an extra of the package.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.tokens.keys import find_key, key_file, key_in, made_keys, participant_keys
    from pqsec_pki.tokens.pin import Pin, stored_pin
    from pqsec_pki.tokens.reference import is_reference, reference_to, uri_in
    from pqsec_pki.tokens.uri import SCHEME, KeyUri, usable, without_pin
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "SCHEME",
    "KeyUri",
    "Pin",
    "find_key",
    "is_reference",
    "key_file",
    "key_in",
    "made_keys",
    "participant_keys",
    "reference_to",
    "stored_pin",
    "uri_in",
    "usable",
    "without_pin",
]
