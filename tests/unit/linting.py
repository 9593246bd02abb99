"""Keystores and certificates to check, sound until a test breaks one thing."""

import shutil
from datetime import timedelta
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint import Severity, check
from tests.unit.keystores import DAY, NOW, made

YEAR = timedelta(days=365)
TALKER = "enclaves/talker"
_PLACE = TemporaryDirectory(prefix="pqsec-lint-")
SECRET = b"a passphrase"


def found(*paths, targets=(), now=NOW):
    """What is wrong there, by rule."""
    findings = check(paths, now=now, targets=targets).findings
    return {finding.rule.id: finding for finding in findings}


@cache
def _model(profile):
    """A keystore of two participants, with encrypted CA keys."""
    root = Path(_PLACE.name) / profile
    made(root, profile, subscribe=("x",))
    for path in (root / "private").glob("*.pem"):
        path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), SECRET))
    return root


class Lab:
    """A keystore that may be broken."""

    def __init__(self, folder, profile="transition"):
        self.root = folder / "keystore"
        shutil.copytree(_model(profile), self.root, symlinks=True)

    def __truediv__(self, path):
        return self.root / path

    def found(self, *targets, now=NOW):
        return found(self.root, targets=targets, now=now)

    def report(self, *targets, now=NOW):
        return check([self.root], now=now, targets=targets)

    def authorities(self):
        return Keystore.open(self.root).unlock(SECRET)

    def put(self, path, data):
        """A file in the place of what is there, were it a link; with its mode."""
        goal = self.root / path
        mode = goal.stat().st_mode if goal.exists() else 0o644
        goal.unlink(missing_ok=True)
        goal.write_bytes(data)
        goal.chmod(mode)
        return goal

    def edit(self, path, old, new):
        data = (self.root / path).read_bytes()
        assert old in data, old
        return self.put(path, data.replace(old, new))

    def sign_permissions(self, permissions, now=NOW):
        """Those permissions for /talker, signed as the keystore does."""
        xml = permissions if isinstance(permissions, bytes) else permissions.to_xml()
        self.put(f"{TALKER}/permissions.xml", xml)
        self.put(f"{TALKER}/permissions.p7s", self.authorities().sign(xml, now=now))


def p256():
    return ec.generate_private_key(ec.SECP256R1())


def named(name):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)] if name else [])


USAGES = (
    *("digital_signature", "content_commitment", "key_encipherment", "data_encipherment"),
    *("key_agreement", "key_cert_sign", "crl_sign", "encipher_only", "decipher_only"),
)


def usage(*names):
    return x509.KeyUsage(**{name: name in names for name in USAGES})


CA_USAGE = usage("digital_signature", "key_cert_sign", "crl_sign")
OWN_USAGE = usage("digital_signature")


def own_identifier(key):
    return x509.SubjectKeyIdentifier.from_public_key(key.public_key())


def issuers_identifier(key):
    return x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key())


def certificate(  # noqa: PLR0913 -- each is something to get wrong
    name="/talker",
    *,
    key=None,
    issuer=None,
    signer=None,
    ca=False,
    constraints=True,
    use=None,
    identifiers=True,
    serial=None,
    extensions=(),
    begin=NOW - DAY,
    end=NOW + YEAR,
    digest=None,
    **options,
):
    """PEM of a certificate as pqsec makes it, but for what is given; self-signed unless signed."""
    key = key or p256()
    builder = (
        x509.CertificateBuilder(not_valid_before=begin, not_valid_after=end)
        .subject_name(named(name))
        .issuer_name(named(name if issuer is None else issuer))
        .public_key(key.public_key())
        .serial_number(serial or x509.random_serial_number())
    )
    use = use or (CA_USAGE if ca else OWN_USAGE)
    if constraints:
        builder = builder.add_extension(x509.BasicConstraints(ca, None), critical=True)
    if use != "none":
        builder = builder.add_extension(use, critical=True)
    signer = signer or key
    if identifiers:
        for made in (own_identifier(key), issuers_identifier(signer)):
            builder = builder.add_extension(made, critical=False)
    for extension, critical in extensions:
        builder = builder.add_extension(extension, critical=critical)
    digest = hashes.SHA256() if digest is None else digest or None
    return builder.sign(signer, digest, **options).public_bytes(Encoding.PEM)


def check_nothing_broken(root):
    """`pqsec check` finds no error; a draft that a kill left is removed by the next change."""
    findings = check([root], now=NOW).findings
    errors = [each for each in findings if each.rule.severity is Severity.ERROR]
    assert [each for each in errors if "/.draft-" not in str(each.path)] == []
