"""Rules about key, certificate and identity CA of an enclave, which must match each other."""

from collections.abc import Iterator

from cryptography import x509

from pqsec_pki._times import said
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials import ALT_KEY, CERTIFICATE, ENCLAVES, IDENTITY_CA, KEY
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint._keys import is_signed_by, key_of
from pqsec_pki.lint.rule import CYCLONE, SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile, EnclaveFolder
from pqsec_pki.stacks import Stack


@lint_rule(
    "PQS303", Severity.ERROR, "the certificate and the enclave have different names",
    why="ROS 2 selects the enclave by its folder, and peers identify the participant by its"
    " certificate. Logs and permissions then use different names.",
    fix="Issue a certificate with the enclave's path as its common name (CN=/fleet/robot1).",
    bad="$ mv k/enclaves/talker k/enclaves/speaker",
    good="$ mv k/enclaves/speaker k/enclaves/talker",
)  # fmt: skip
def different_names(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None or ENCLAVES not in enclave.folder.parts:
        return
    if certificate.subject_der != _expected(enclave.name):
        name = certificate.subject_name or "an empty name"
        yield Violation(f"the certificate is for {name}, not for CN={enclave.name}")


@lint_rule(
    "PQS304", Severity.ERROR, "the private key does not match the certificate",
    why="Fast DDS refuses to start. Cyclone DDS starts, but every handshake fails with 'Failed to"
    " finalize digest context (code: 200)'.",
    fix="Replace the key with the one of this certificate, or issue the participant again.",
    rows=("key does not match cert",), measured=SIX_STACKS,
    bad="$ cp k/enclaves/listener/key.pem k/enclaves/talker",
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def another_key(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None:
        return
    for name, spki in _certified(certificate):
        file = enclave.files.get(name)
        if file and file.private_key.spki not in (None, spki):
            yield Violation(f"{name} is not the key of {CERTIFICATE}", path=file.path)


@lint_rule(
    "PQS305", Severity.ERROR, "the private key cannot be read",
    why="No stack starts with it.",
    fix="Restore the key, or issue the participant again.",
    bad="$ head -n 2 k/enclaves/listener/key.pem > k/enclaves/talker/key.pem",
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def unreadable_key(enclave: EnclaveFolder) -> Iterator[Violation]:
    for name in (KEY, ALT_KEY):
        file = enclave.files.get(name)
        if file and (reason := file.private_key.reason):
            yield Violation(f"cannot be read: {reason}", path=file.path)


@lint_rule(
    "PQS328", Severity.INFO, "a key in a token was not checked",
    why="The file refers to a key elsewhere, which this check does not ask for. Whether it is the"
    " certificate's is unknown. Stacks' own plugins take no such file, and pqsec's does.",
    fix="`pqsec verify-handshake` asks the token. For a key in a file: `pqsec issue --force"
    " --participant-key-uri file`, with all rights of the participant.",
    bad="""
        $ echo '-----BEGIN PKCS#11 PROVIDER URI-----' > reference
        $ echo MDsaGVBLQ1MjMTEgUHJvdmlkZXIgVVJJIHYxLjAMHnBrY3MxMTp0b2tlbj1sYWI7 >> reference
        $ echo b2JqZWN0PXRhbGtlcg== >> reference
        $ echo '-----END PKCS#11 PROVIDER URI-----' >> reference
        $ cp reference k/enclaves/talker/key.pem
    """,
    good="$ pqsec -k k issue --force --participant-key-uri file --publish chatter /talker",
)  # fmt: skip
def key_in_token(enclave: EnclaveFolder) -> Iterator[Violation]:
    for name in (KEY, ALT_KEY):
        file = enclave.files.get(name)
        if file and file.is_reference and not file.private_key.reason:
            yield Violation("refers to a key in a token, which was not checked", path=file.path)


@lint_rule(
    "PQS306", Severity.ERROR, "the identity CA did not issue the certificate",
    why="Neither this participant nor its peers can verify it.",
    fix="Use the CA that issued the certificate, or issue the participant again.",
    rows=(
        "two CAs in file, right one second", "identity_ca=int+root, cert=leaf (no AKI)",
        "identity_ca=root, cert.pem=leaf+intermediate",
    ),
    measured=SIX_STACKS,
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ pqsec -k other ca init --no-passphrase
        $ cp other/public/identity_ca.cert.pem robot
    """,
    good="$ cp k/public/identity_ca.cert.pem robot",
)  # fmt: skip
def of_another_ca(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or ca is None or _intermediate(enclave):
        return
    if not certificate.names_issuer(ca):
        yield Violation(f"the certificate was not issued by {ca.subject_name}")
    elif not is_signed_by(certificate, ca):
        yield Violation(f"{ca.subject_name} did not sign the certificate: same name, another key")


@lint_rule(
    "PQS313", Severity.ERROR, "the certificate names another key of its CA",
    why="Its authorityKeyIdentifier differs from the CA's subjectKeyIdentifier. OpenSSL, which all"
    " stacks use, then does not find the CA: 'unable to get local issuer certificate'.",
    fix="Issue the participant again with this CA, or restore the CA's certificate that issued it.",
    measured="`openssl verify` 3.0.19 and 3.5",
    bad=r"""
        $ cp -rL k/enclaves/talker robot
        $ openssl req -x509 -key k/private/identity_ca.key.pem -subj '/CN=Identity CA' -days 3650 \
          -addext basicConstraints=critical,CA:TRUE -out robot/identity_ca.cert.pem
    """,
    good="$ cp k/public/identity_ca.cert.pem robot",
)  # fmt: skip
def names_another_key(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or ca is None or not is_signed_by(certificate, ca):
        return  # PQS306 says so
    named = certificate.extension(x509.AuthorityKeyIdentifier)
    wanted = ca.subject_key_identifier
    if named and named.key_identifier and wanted and named.key_identifier != wanted:
        yield Violation(
            f"the certificate names a CA with the key identifier {named.key_identifier.hex()},"
            f" but {ca.subject_name} has {wanted.hex()}"
        )


@lint_rule(
    "PQS316", Severity.ERROR, "an intermediate CA issued the certificate",
    why="Fast DDS finds the intermediate CA after the root in the identity CA's file. Cyclone DDS"
    " and OpenDDS read only the first certificate of the file.",
    fix="Issue the participant with a self-signed CA.",
    stacks={**CYCLONE, Stack.OPENDDS: ""},
    rows=("identity_ca=root+int, cert=leaf",), measured=SIX_STACKS + "; OpenDDS by source",
    bad=r"""
        $ cp -rL k/enclaves/talker robot
        $ openssl req -x509 -key key.pem -subj /CN=Middle -out middle.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem \
          -addext basicConstraints=critical,CA:TRUE
        $ openssl req -x509 -key robot/key.pem -subj '/CN=\/talker' -out robot/cert.pem \
          -CA middle.pem -CAkey key.pem \
          -addext basicConstraints=critical,CA:FALSE -addext authorityKeyIdentifier=keyid
        $ cat k/public/identity_ca.cert.pem middle.pem > robot/identity_ca.cert.pem
    """,
    good="$ cp k/enclaves/talker/cert.pem k/public/identity_ca.cert.pem robot",
)  # fmt: skip
def issued_by_intermediate(enclave: EnclaveFolder) -> Iterator[Violation]:
    if found := _intermediate(enclave):
        yield Violation(
            f"issued by {found.subject_name}, which only Fast DDS finds in {IDENTITY_CA}"
        )


@lint_rule(
    "PQS307", Severity.WARNING, "the certificate ends after its CA",
    why="When the CA expires, the participant is refused, before its own certificate expires.",
    fix="Issue the certificate with a shorter validity. pqsec limits the validity itself.",
    bad=r"""
        $ pqsec -k c ca init --no-passphrase --profile classical
        $ pqsec -k c issue --publish chatter /talker
        $ openssl x509 -in c/public/identity_ca.cert.pem -signkey c/private/identity_ca.key.pem \
          -days 90 -out c/public/identity_ca.new.pem
        $ mv c/public/identity_ca.new.pem c/public/identity_ca.cert.pem
    """,
    good="$ pqsec -k c issue --force --publish chatter /talker",
)  # fmt: skip
def ends_after_ca(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate and ca and certificate.not_after > ca.not_after:
        yield Violation(
            f"the certificate ends on {said(certificate.not_after)},"
            f" after its CA on {said(ca.not_after)}"
        )


def _intermediate(enclave: EnclaveFolder) -> Certificate | None:
    """The intermediate CA that issued the certificate, if it follows its root in the file."""
    certificate, root = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or root is None:
        return None
    file = enclave.subjects[IDENTITY_CA]
    more = file.certificates[1:] if isinstance(file, CertificateFile) else ()
    above = (each for each in more if _is_issued_by(certificate, each))
    return next((each for each in above if _is_issued_by(each, root)), None)


def _is_issued_by(certificate: Certificate, ca: Certificate) -> bool:
    return certificate.names_issuer(ca) and is_signed_by(certificate, ca)


def _expected(name: str) -> bytes | None:
    try:
        return common_name(name)
    except PqsecError:
        return None


def _certified(certificate: Certificate) -> Iterator[tuple[str, bytes]]:
    if key_of(certificate):
        yield KEY, certificate.spki
    if certificate.alternative_spki:
        yield ALT_KEY, certificate.alternative_spki
