"""The algorithms: signatures, key agreements, profiles; encoding and decoding of keys.

The only room that uses raw primitives. To add an algorithm, write its row in
signature.py or key_agreement.py; nothing else in the package names one.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.algorithms._agreement import KeyAgreement, KeyPair
    from pqsec_pki.algorithms._pair import pair_private, pair_public
    from pqsec_pki.algorithms._pem import exact_der, first_pem, pem, unpem
    from pqsec_pki.algorithms._row import (
        ExternalKey,
        PrivateKey,
        PublicKey,
        SignatureAlgorithm,
        broken_digest,
    )
    from pqsec_pki.algorithms._table import Family, Registered
    from pqsec_pki.algorithms.digest import BROKEN_DIGESTS, Digest, digest_of
    from pqsec_pki.algorithms.key_agreement import KEY_AGREEMENTS, MODP_DER, MODP_RAW
    from pqsec_pki.algorithms.keys import (
        is_encrypted,
        load_private_key,
        load_public_key,
        private_key_pem,
        public_key_from_pem,
    )
    from pqsec_pki.algorithms.profile import (
        DEFAULT_PROFILE,
        PROFILES,
        STOCK_AGREEMENT,
        STOCK_AGREEMENTS,
        Profile,
        profile_named,
        usual_agreements,
    )
    from pqsec_pki.algorithms.protection import protection_lost
    from pqsec_pki.algorithms.sealing import SealingPrivateKey, SealingPublicKey
    from pqsec_pki.algorithms.signature import SIGNATURES
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BROKEN_DIGESTS",
    "DEFAULT_PROFILE",
    "KEY_AGREEMENTS",
    "MODP_DER",
    "MODP_RAW",
    "PROFILES",
    "SIGNATURES",
    "STOCK_AGREEMENT",
    "STOCK_AGREEMENTS",
    "Digest",
    "ExternalKey",
    "Family",
    "KeyAgreement",
    "KeyPair",
    "PrivateKey",
    "Profile",
    "PublicKey",
    "Registered",
    "SealingPrivateKey",
    "SealingPublicKey",
    "SignatureAlgorithm",
    "broken_digest",
    "digest_of",
    "exact_der",
    "first_pem",
    "is_encrypted",
    "load_private_key",
    "load_public_key",
    "pair_private",
    "pair_public",
    "pem",
    "private_key_pem",
    "profile_named",
    "protection_lost",
    "public_key_from_pem",
    "unpem",
    "usual_agreements",
]
