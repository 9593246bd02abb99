"""A keystore as SROS2 0.13 makes it: layout, certificate profile, signatures and modes.

One P-256 key, CN=sros2CA, is both CAs; participants' certificates have basicConstraints and
nothing else; all lasts ten years from the day before; keys and folders are open to others.
"""

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    pkcs7,
)
from cryptography.x509.oid import NameOID

from pqsec_pki.documents import DomainSet, Governance, Grant, Permissions

MADE = datetime(2026, 6, 1, 12, tzinfo=UTC)
NO_CA = x509.BasicConstraints(ca=False, path_length=None)
WINDOW = (MADE - timedelta(days=1), MADE + timedelta(days=3650))


class SROS2:
    """`ros2 security create_keystore` and `create_enclave`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for name in ("public", "private", "enclaves"):
            (root / name).mkdir(parents=True)
        self.key, name = ec.generate_private_key(ec.SECP256R1()), _name("sros2CA")
        self.ca = self.certificate(name, self.key, x509.BasicConstraints(ca=True, path_length=1))
        self._put("public/ca.cert.pem", self.ca.public_bytes(Encoding.PEM))
        self._put("private/ca.key.pem", _pem(self.key))
        for role in ("identity_ca", "permissions_ca"):
            (root / f"public/{role}.cert.pem").symlink_to("ca.cert.pem")
            (root / f"private/{role}.key.pem").symlink_to("ca.key.pem")
        self.sign("enclaves/governance", Governance.protected(DomainSet.of(0)).to_xml())

    def enclave(self, name: str, *, serial: int | None = None) -> Path:
        """A participant that may publish and subscribe to rt/*."""
        folder = self.root / f"enclaves{name}"
        folder.mkdir(parents=True)
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = self.certificate(_name(name), key, NO_CA, serial)
        self._put(f"enclaves{name}/key.pem", _pem(key))
        self._put(f"enclaves{name}/cert.pem", certificate.public_bytes(Encoding.PEM))
        self.sign(f"enclaves{name}/permissions", permissions(name))
        up = os.path.relpath(self.root, folder)
        for link, place in (
            ("governance.p7s", "enclaves"),
            ("identity_ca.cert.pem", "public"),
            ("permissions_ca.cert.pem", "public"),
        ):
            (folder / link).symlink_to(f"{up}/{place}/{link}")
        return folder

    def certificate(self, subject, key, constraints, serial=None) -> x509.Certificate:
        """Signed by the CA's key; basicConstraints is all it says."""
        return (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(_name("sros2CA"))
            .public_key(key.public_key())
            .serial_number(serial or x509.random_serial_number())
            .not_valid_before(WINDOW[0])
            .not_valid_after(WINDOW[1])
            .add_extension(constraints, critical=True)
            .sign(self.key, hashes.SHA256())
        )

    def revoke(self, *serials: int) -> bytes:
        """A revocation list, as the tutorial has it made by `openssl ca`."""
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self.ca.subject)
            .last_update(MADE)
            .next_update(WINDOW[1])
        )
        for serial in serials:
            entry = x509.RevokedCertificateBuilder(serial, MADE).build()
            builder = builder.add_revoked_certificate(entry)
        return builder.sign(self.key, hashes.SHA256()).public_bytes(Encoding.PEM)

    def sign(self, place: str, xml: bytes) -> None:
        """`place`.xml and `place`.p7s."""
        builder = pkcs7.PKCS7SignatureBuilder().set_data(xml)
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        signed = builder.add_signer(self.ca, self.key, hashes.SHA256()).sign(
            Encoding.SMIME, options
        )
        self._put(f"{place}.xml", xml)
        self._put(f"{place}.p7s", signed)

    def _put(self, place: str, data: bytes) -> None:
        (self.root / place).write_bytes(data)
        (self.root / place).chmod(0o644)


def permissions(name: str, subject: str = "") -> bytes:
    """What `create_enclave` allows when no policy is given."""
    grant = Grant.least(
        name=name,
        subject_name=subject or f"CN={name}",
        not_before=WINDOW[0],
        not_after=WINDOW[1],
        domains=DomainSet.of(0),
        publish=("rt/*",),
        subscribe=("rt/*",),
    )
    return Permissions(grants=(grant,)).to_xml()


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
