"""Certificates, keys, revocation lists and signatures as assets. No key's bits are in them."""

import hashlib
from collections.abc import Hashable, Iterable, Iterator

from cyclonedx.model.bom_ref import BomRef
from cyclonedx.model.crypto import (
    CertificateProperties,
    CryptoAssetType,
    CryptoPrimitive,
    CryptoProperties,
    RelatedCryptoMaterialProperties,
    RelatedCryptoMaterialSecuredBy,
    RelatedCryptoMaterialType,
)

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    EncryptedPrivateKeyInfo,
    PBES2Params,
    SubjectPublicKeyInfo,
    decode,
    encode,
)
from pqsec_pki.algorithms import SignatureAlgorithm, load_public_key
from pqsec_pki.cbom import _algorithms
from pqsec_pki.cbom._assets import Asset, Assets, bom_ref
from pqsec_pki.certificates import (
    Certificate,
    CertificateRequest,
    RevocationList,
    canonical_name,
    name_text,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.inspection import algorithm_name
from pqsec_pki.smime import ListedSigner

Kind = RelatedCryptoMaterialType
_PBES2 = "1.2.840.113549.1.5.13"
_SHORT = 16
"""Hex digits of a digest in a name."""


class Issuers:
    """The key algorithms of those who sign, as far as their certificates are known."""

    def __init__(self, certificates: Iterable[Certificate]) -> None:
        self._by_name: dict[Hashable, set[SignatureAlgorithm | None]] = {}
        self._by_serial: dict[tuple[Hashable, int], SignatureAlgorithm | None] = {}
        for each in certificates:
            row = _row_of(each.spki)
            self._by_name.setdefault(canonical_name(each.subject_der), set()).add(row)
            self._by_serial[canonical_name(each.issuer_der), each.serial_number] = row

    def named(self, subject_der: bytes) -> SignatureAlgorithm | None:
        """The algorithm of the keys of that subject; None if unknown, or not the same for all."""
        found = self._by_name.get(canonical_name(subject_der), set())
        return next(iter(found)) if len(found) == 1 else None

    def of(self, signer: ListedSigner) -> SignatureAlgorithm | None:
        """The algorithm of the key of a CMS signer; None if unknown."""
        if signer.issuer_der is None or signer.serial_number is None:
            return None
        return self._by_serial.get((canonical_name(signer.issuer_der), signer.serial_number))


def add_certificate(assets: Assets, certificate: Certificate, place: str, issuers: Issuers) -> str:
    """Add a certificate, its public keys and the algorithms of its signatures; its ref."""
    issuer = issuers.named(certificate.issuer_der)
    signature = _algorithms.signed_with(assets, certificate.identifier, issuer)
    key = add_public_key(assets, certificate.spki)
    details = tuple(_alternatives(assets, certificate))
    properties = CertificateProperties(
        subject_name=certificate.subject_name,
        issuer_name=certificate.issuer_name,
        not_valid_before=certificate.not_before,
        not_valid_after=certificate.not_after,
        signature_algorithm_ref=bom_ref(signature),
        subject_public_key_ref=bom_ref(key),
        certificate_format="X.509",
    )
    asset = Asset(
        ref=f"certificate:{certificate.fingerprint}",
        name=certificate.subject_name,
        crypto=CryptoProperties(
            asset_type=CryptoAssetType.CERTIFICATE, certificate_properties=properties
        ),
        needs=(signature, key, *(ref for _, ref in details)),
        sha256=certificate.fingerprint,
        details=details,
        added={"serialNumber": f"{certificate.serial_number:x}"},
    )
    return assets.add(asset, place)


def _alternatives(assets: Assets, certificate: Certificate) -> Iterator[tuple[str, str]]:
    """The alternative key and signature of a certificate: each its name and ref."""
    alternative, spki = certificate.alternative, certificate.alternative_spki
    if spki:
        yield "alternativePublicKey", add_public_key(assets, spki)
    if alternative and alternative.identifier:
        signature = _algorithms.signed_with(assets, alternative.identifier, None)
        yield "alternativeSignatureAlgorithm", signature


def add_public_key(assets: Assets, spki: bytes, *places: str) -> str:
    """Add the public key in DER SubjectPublicKeyInfo `spki`; its ref."""
    digest = hashlib.sha256(spki).hexdigest()
    algorithm, words = _key_algorithm(assets, spki)
    return _material(
        assets,
        f"public-key:{digest}",
        f"{words} public key {digest[:_SHORT]}",
        RelatedCryptoMaterialProperties(
            type=Kind.PUBLIC_KEY,
            id=digest,
            algorithm_ref=bom_ref(algorithm),
            format="SubjectPublicKeyInfo",
        ),
        (algorithm,) if algorithm else (),
        places,
    )


def add_private_key(
    assets: Assets,
    place: str,
    spki: bytes | None,
    encryption: AlgorithmIdentifier | None,
    *,
    elsewhere: bool = False,
) -> str:
    """Add a private key, by its public key if that is known, else by its place; its ref.

    `encryption` is how the key is encrypted, if it is; with `elsewhere` a token or another signer
    has it.
    """
    public = add_public_key(assets, spki) if spki is not None else None
    algorithm, words = _key_algorithm(assets, spki) if spki is not None else (None, "encrypted")
    digest = hashlib.sha256(spki if spki is not None else place.encode()).hexdigest()
    by_known = f"{words} private key {digest[:_SHORT]}"
    mechanism = _encryption(assets, encryption) if encryption is not None else None
    secured, end = _protection(mechanism, elsewhere=elsewhere)
    where = "" if spki is not None else "@"
    return _material(
        assets,
        f"private-key:{where}{digest}{end}",
        by_known if spki is not None else f"private key in {place}",
        RelatedCryptoMaterialProperties(
            type=Kind.PRIVATE_KEY,
            id=digest if spki is not None else None,
            algorithm_ref=bom_ref(algorithm),
            format=None if elsewhere else "PEM",
            secured_by=secured,
        ),
        tuple(each for each in (public, algorithm, mechanism) if each),
        (place,),
    )


def _protection(
    mechanism: str | None, *, elsewhere: bool
) -> tuple[RelatedCryptoMaterialSecuredBy | None, str]:
    """What secures a private key, and the end of its ref.

    One key, stored encrypted here and open there, is two assets.
    """
    if elsewhere:
        return RelatedCryptoMaterialSecuredBy(mechanism="HSM"), ":elsewhere"
    if mechanism is None:
        return None, ""
    secured = RelatedCryptoMaterialSecuredBy(
        mechanism="passphrase", algorithm_ref=BomRef(mechanism)
    )
    return secured, ":encrypted"


def add_request(assets: Assets, request: CertificateRequest, place: str) -> None:
    """Add the keys that a certificate request is for."""
    add_public_key(assets, request.spki, place)
    if request.alternative_spki:
        add_public_key(assets, request.alternative_spki, place)


def add_list(assets: Assets, crl: RevocationList, place: str, issuers: Issuers) -> None:
    """Add a revocation list, which CycloneDX has no kind of its own for."""
    needs = [_algorithms.signed_with(assets, crl.identifier, issuers.named(crl.issuer_der))]
    if crl.alternative and crl.alternative.identifier:
        needs.append(_algorithms.signed_with(assets, crl.alternative.identifier, None))
    digest = hashlib.sha256(crl.der).hexdigest()
    _material(
        assets,
        f"revocation-list:{digest}",
        f"revocation list of {name_text(crl.issuer)}",
        RelatedCryptoMaterialProperties(
            type=Kind.OTHER,
            id=None if crl.number is None else str(crl.number),
            algorithm_ref=bom_ref(needs[0]),
            update_date=crl.this_update,
            expiration_date=crl.next_update,
            format="X.509 CRL",
        ),
        tuple(needs),
        (place,),
        digest,
    )


def add_signatures(
    assets: Assets,
    document: bytes,
    signers: tuple[ListedSigner, ...],
    place: str,
    issuers: Issuers,
) -> None:
    """Add the signatures of a signed document, with the countersignatures."""
    digest = hashlib.sha256(document).hexdigest()
    every = [each for signer in signers for each in (signer, *signer.countersigners)]
    for number, signer in enumerate(every, 1):
        algorithm = _algorithms.signed_with(assets, signer.identifier, issuers.of(signer))
        hashed = _algorithms.digest_named(assets, signer.digest)
        _material(
            assets,
            f"signature:{digest}:{number}",
            f"signature {number} of signed document {digest[:_SHORT]}",
            RelatedCryptoMaterialProperties(
                type=Kind.SIGNATURE,
                algorithm_ref=BomRef(algorithm),
                creation_date=signer.signed_at,
                format="CMS",
            ),
            (algorithm, hashed),
            (place,),
        )


def encryption_of(der: bytes) -> AlgorithmIdentifier:
    """How the PKCS#8 key in `der` is encrypted; MalformedError if it is not such a key."""
    return decode(EncryptedPrivateKeyInfo, der, "encrypted private key").algorithm


def _encryption(assets: Assets, identifier: AlgorithmIdentifier) -> str:
    oid = identifier.algorithm.dotted_string
    if oid != _PBES2:
        return _algorithms.by_oid(assets, oid, CryptoPrimitive.OTHER)
    parts = decode(PBES2Params, encode(identifier.parameters), "encryption of a private key")
    kdf, cipher = (
        each.algorithm.dotted_string for each in (parts.key_derivation, parts.encryption)
    )
    return _algorithms.combination(
        assets,
        "PBES2",
        (
            _algorithms.by_oid(assets, kdf, CryptoPrimitive.KDF),
            _algorithms.by_oid(assets, cipher, CryptoPrimitive.BLOCK_CIPHER),
        ),
    )


def _key_algorithm(assets: Assets, spki: bytes) -> tuple[str | None, str]:
    """(ref, name) of a key's algorithm, also of one that pqsec does not support."""
    if row := _row_of(spki):
        return _algorithms.signature_row(assets, row), row.name
    try:
        info = decode(SubjectPublicKeyInfo, spki, "public key")
    except PqsecError:
        return None, "unreadable"
    oid = info.algorithm.algorithm.dotted_string
    ref = _algorithms.by_oid(assets, oid, CryptoPrimitive.UNKNOWN)
    return ref, algorithm_name(oid)


def _row_of(spki: bytes) -> SignatureAlgorithm | None:
    try:
        return load_public_key(spki).algorithm
    except PqsecError:
        return None


def _material(  # noqa: PLR0913, PLR0917 -- the parts of an asset
    assets: Assets,
    ref: str,
    name: str,
    properties: RelatedCryptoMaterialProperties,
    needs: tuple[str, ...],
    places: tuple[str, ...],
    sha256: str | None = None,
) -> str:
    asset = Asset(
        ref=ref,
        name=name,
        crypto=CryptoProperties(
            asset_type=CryptoAssetType.RELATED_CRYPTO_MATERIAL,
            related_crypto_material_properties=properties,
        ),
        needs=tuple(dict.fromkeys(needs)),
        sha256=sha256,
    )
    return assets.add(asset, *places)
