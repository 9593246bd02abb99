"""A factory: its root and intermediate CA, revocation lists, and devices."""

from datetime import timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.est import TlsIdentity
from tests.some_keys import some_key

KIND = "ecdsa-p256"
DAY = timedelta(days=1)


class Maker:
    """A factory whose keys are its `owner`'s: two owners have CAs with the same names."""

    def __init__(self, now, owner="acme"):
        self.now, self.owner = now, owner
        self.root = self.ca("root", "root")
        self.line = self.ca("line", "root")

    def put(self, folder, **revoked):
        """Write the root, and the list of each CA with the serial numbers that it `revoked`."""
        (folder / f"{self.owner}.pem").write_bytes(self.root)
        for name in ("root", "line"):
            (folder / f"{name}.crl").write_bytes(self.revoked(name, *revoked.get(name, ())))

    def ca(self, name, issuer):
        return self.certificate([(NameOID.COMMON_NAME, name)], name, issuer, ca=True)

    def device(self, number, **choices):
        """What the device with that serial number shows."""
        names = [(NameOID.ORGANIZATION_NAME, "Acme"), (NameOID.SERIAL_NUMBER, number)]
        made = self.certificate(names, f"device {number}", "line", **choices)
        key = private_key_pem(some_key(KIND, f"{self.owner} device {number}"))
        return TlsIdentity.of(made + self.line, key)

    def certificate(  # noqa: PLR0913 -- by name
        self, names, owner, issuer, *, ca=False, since=None, serial=None, purposes=(), signs=True
    ):
        since = since or self.now - DAY
        key, by = (some_key(KIND, f"{self.owner} {each}") for each in (owner, issuer))
        builder = (
            x509.CertificateBuilder()
            .subject_name(x509.Name([x509.NameAttribute(*each) for each in names]))
            .issuer_name(name_of(issuer))
            .public_key(key.handle.public_key())
            .serial_number(serial or x509.random_serial_number())
            .not_valid_before(since)
            .not_valid_after(since + 9 * DAY)
            .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
            .add_extension(usage(ca=ca, signs=signs), critical=True)
        )
        if purposes:
            builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        made = builder.sign(by.handle, hashes.SHA256())
        return made.public_bytes(Encoding.PEM)

    def revoked(self, issuer, *serials):
        """The revocation list of one of the CAs."""
        builder = x509.CertificateRevocationListBuilder(name_of(issuer)).last_update(self.now - DAY)
        for each in serials:
            entry = x509.RevokedCertificateBuilder(each, self.now - DAY).build()
            builder = builder.add_revoked_certificate(entry)
        by = some_key(KIND, f"{self.owner} {issuer}")
        made = builder.next_update(self.now + DAY).sign(by.handle, hashes.SHA256())
        return made.public_bytes(Encoding.PEM)


SERVERS_ONLY = (ExtendedKeyUsageOID.SERVER_AUTH,)


def name_of(text):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def usage(*, ca, signs):
    return x509.KeyUsage(
        digital_signature=signs and not ca,
        content_commitment=False,
        key_encipherment=not signs,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=ca,
        crl_sign=ca,
        encipher_only=False,
        decipher_only=False,
    )
