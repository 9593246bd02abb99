"""Rules about the files of one enclave, which must match each other."""

from collections.abc import Iterator

from cryptography import x509

from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.credentials import ALT_KEY, CERTIFICATE, ENCLAVES, IDENTITY_CA, KEY, REQUEST
from pqsec_pki.documents import DefaultAction, Grant, parse_subject, same_subject
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint._keys import held
from pqsec_pki.lint._roles import extension, is_signed_by, key_of
from pqsec_pki.lint._shadows import domains_meet
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import SIX, CertificateFile, Enclave

FAMILY = Family("cross-artefact")
_ALL = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2"


@FAMILY.rule(
    "PQS301", Severity.ERROR, Enclave, "a file is missing in an enclave",
    why="Every stack needs all six files. ROS 2 only reports that security files were not found.",
    fix="Issue the participant again, or copy the missing files.",
    measured="source of rmw_dds_common (security.cpp)",
)  # fmt: skip
def incomplete(enclave: Enclave) -> Iterator[Violation]:
    there = {*enclave.files, *enclave.lost}
    missing = [name for name in SIX if name not in there and not _is_elsewhere(enclave, name)]
    if missing:
        yield Violation(f"lacks {', '.join(missing)}")


@FAMILY.rule(
    "PQS302", Severity.ERROR, Enclave, "a broken link",
    why="A copy of an enclave without the files behind its links contains only broken links.",
    fix="Follow the links when you copy (cp -rL, rsync -L), or restore the shared files.",
)  # fmt: skip
def lost(enclave: Enclave) -> Iterator[Violation]:
    for name in sorted(enclave.lost):
        yield Violation("the link is broken", path=enclave.folder / name)


@FAMILY.rule(
    "PQS303", Severity.ERROR, Enclave, "the certificate and the enclave have different names",
    why="ROS 2 selects the enclave by its folder, and peers identify the participant by its"
    " certificate. Logs and permissions then use different names.",
    fix="Issue a certificate with the enclave's path as its common name (CN=/fleet/robot1).",
)  # fmt: skip
def different_names(enclave: Enclave) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None or ENCLAVES not in enclave.folder.parts:
        return
    if certificate.subject_der != _expected(enclave.name):
        name = certificate.subject_name or "an empty name"
        yield Violation(f"the certificate is for {name}, not for CN={enclave.name}")


@FAMILY.rule(
    "PQS304", Severity.ERROR, Enclave, "the private key does not match the certificate",
    why="Fast DDS refuses to start. Cyclone DDS starts, but every handshake fails with 'Failed to"
    " finalize digest context (code: 200)'.",
    fix="Replace the key with the one of this certificate, or issue the participant again.",
    rows=("key does not match cert",), measured=_ALL,
)  # fmt: skip
def other_key(enclave: Enclave) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None:
        return
    for name, spki in _certified(certificate):
        file = enclave.files.get(name)
        if file and held(file).spki not in (None, spki):
            yield Violation(f"{name} is not the key of {CERTIFICATE}", path=file.path)


@FAMILY.rule(
    "PQS305", Severity.ERROR, Enclave, "the private key cannot be read",
    why="No stack starts with it.",
    fix="Restore the key, or issue the participant again.",
)  # fmt: skip
def unreadable_key(enclave: Enclave) -> Iterator[Violation]:
    for name in (KEY, ALT_KEY):
        file = enclave.files.get(name)
        if file and (reason := held(file).reason):
            yield Violation(f"cannot be read: {reason}", path=file.path)


@FAMILY.rule(
    "PQS306", Severity.ERROR, Enclave, "the identity CA did not issue the certificate",
    why="Neither this participant nor its peers can verify it.",
    fix="Use the CA that issued the certificate, or issue the participant again.",
    rows=(
        "two CAs in file, right one second", "identity_ca=int+root, cert=leaf (no AKI)",
        "identity_ca=root, cert.pem=leaf+intermediate",
    ),
    measured=_ALL,
)  # fmt: skip
def of_another_ca(enclave: Enclave) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or ca is None or _intermediate(enclave):
        return
    if certificate.issuer_der != ca.subject_der:
        yield Violation(f"the certificate was not issued by {ca.subject_name}")
    elif not is_signed_by(certificate, ca):
        yield Violation(f"{ca.subject_name} did not sign the certificate: same name, another key")


@FAMILY.rule(
    "PQS313", Severity.ERROR, Enclave, "the certificate names another key of its CA",
    why="Its authorityKeyIdentifier differs from the CA's subjectKeyIdentifier. OpenSSL, which all"
    " stacks use, then does not find the CA: 'unable to get local issuer certificate'.",
    fix="Issue the participant again with this CA, or restore the CA's certificate that issued it.",
    measured="`openssl verify` 3.0.19 and 3.5",
)  # fmt: skip
def names_another_key(enclave: Enclave) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or ca is None or not is_signed_by(certificate, ca):
        return  # PQS306 says so
    named = extension(certificate, x509.AuthorityKeyIdentifier)
    wanted = ca.subject_key_identifier
    if named and named.key_identifier and wanted and named.key_identifier != wanted:
        yield Violation(
            f"the certificate names a CA with the key identifier {named.key_identifier.hex()},"
            f" but {ca.subject_name} has {wanted.hex()}"
        )


@FAMILY.rule(
    "PQS316", Severity.ERROR, Enclave, "an intermediate CA issued the certificate",
    why="Fast DDS finds the intermediate CA after the root in the identity CA's file. Cyclone DDS"
    " and OpenDDS read only the first certificate of the file.",
    fix="Issue the participant with a self-signed CA.",
    stacks=(Target.CYCLONEDDS, Target.OPENDDS),
    rows=("identity_ca=root+int, cert=leaf",), measured=_ALL + "; OpenDDS by source",
)  # fmt: skip
def below_an_intermediate(enclave: Enclave) -> Iterator[Violation]:
    if found := _intermediate(enclave):
        yield Violation(
            f"issued by {found.subject_name}, which only Fast DDS finds in {IDENTITY_CA}"
        )


@FAMILY.rule(
    "PQS307", Severity.WARNING, Enclave, "the certificate ends after its CA",
    why="When the CA expires, the participant is refused, before its own certificate expires.",
    fix="Issue the certificate with a shorter validity. pqsec limits the validity itself.",
)  # fmt: skip
def outlives_ca(enclave: Enclave) -> Iterator[Violation]:
    certificate, ca = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate and ca and certificate.not_after > ca.not_after:
        yield Violation(
            f"the certificate ends on {certificate.not_after:%Y-%m-%d},"
            f" after its CA on {ca.not_after:%Y-%m-%d}"
        )


@FAMILY.rule(
    "PQS308", Severity.ERROR, Enclave, "no grant is for this participant",
    why="Stacks search the grants for the subject of the certificate. If there is none, they refuse"
    " to start.",
    fix="Write the subject as `pqsec inspect cert.pem` prints it, and sign the permissions again.",
    rows=("subset `CN=x` only", "superset (+`,L=Madrid`)"), measured=_ALL,
)  # fmt: skip
def no_grant(enclave: Enclave) -> Iterator[Violation]:
    document, certificate = enclave.permissions(), enclave.certificate()
    if document and document.permissions and certificate and not own_grants(enclave):
        yield Violation(f"no grant is for {certificate.subject_name}", path=document.path)


@FAMILY.rule(
    "PQS309", Severity.ERROR, Enclave, "governance and permissions have no domain in common",
    why="Governance has no rule for the domains of the permissions, and permissions have no rule"
    " for the domains of the governance. The participant cannot join any domain.",
    fix="Name the same domains in both documents.",
)  # fmt: skip
def no_common_domain(enclave: Enclave) -> Iterator[Violation]:
    governance, permissions = enclave.governance(), enclave.permissions()
    if not (governance and governance.governance and permissions):
        return
    governed = [rule.domains for rule in governance.governance.domain_rules]
    grants = own_grants(enclave)
    if any(grant.default is DefaultAction.ALLOW for grant in grants):
        return  # on every domain
    granted = dict.fromkeys(rule.domains for grant in grants for rule in grant.rules)
    if granted and not any(domains_meet(one, other) for one in governed for other in granted):
        yield Violation("names no domain that the governance names", path=permissions.path)


def _intermediate(enclave: Enclave) -> Certificate | None:
    """The intermediate CA that issued the certificate, if it follows its root in the file."""
    certificate, root = enclave.certificate(), enclave.certificate(IDENTITY_CA)
    if certificate is None or root is None:
        return None
    file = enclave.inventory_files[enclave.files[IDENTITY_CA].path]
    more = file.certificates[1:] if isinstance(file, CertificateFile) else ()
    above = (each for each in more if _is_issued_by(certificate, each))
    return next((each for each in above if _is_issued_by(each, root)), None)


def _is_issued_by(certificate: Certificate, ca: Certificate) -> bool:
    return certificate.issuer_der == ca.subject_der and is_signed_by(certificate, ca)


def _is_elsewhere(enclave: Enclave, name: str) -> bool:
    """Whether a PKCS #11 address (.p11, for ROS 2) replaces the file, or the robot has it."""
    if name == KEY and has_keys_on_robot(enclave):
        return True
    return (enclave.folder / name).with_suffix(".p11").exists()


def has_keys_on_robot(enclave: Enclave) -> bool:
    """Whether the enclave was issued for a request, so that only the robot has the keys."""
    return REQUEST in enclave.files and KEY not in enclave.files


def own_grants(enclave: Enclave) -> list[Grant]:
    """The grants for the certificate's subject, in any spelling."""
    document, certificate = enclave.permissions(), enclave.certificate()
    if not (document and document.permissions and certificate):
        return []
    return [
        grant
        for grant in document.permissions.grants
        if _is_for(grant.subject_name, certificate.subject_name)
    ]


def _is_for(named: str, subject: str) -> bool:
    try:
        return named == subject or same_subject(parse_subject(named), parse_subject(subject))
    except PqsecError:
        return False


def _expected(name: str) -> bytes | None:
    try:
        return common_name(name)
    except PqsecError:
        return None


def _certified(certificate: Certificate) -> Iterator[tuple[str, bytes]]:
    if key_of(certificate):
        yield KEY, certificate.spki
    if certificate.alternative and certificate.alternative.spki:
        yield ALT_KEY, certificate.alternative.spki
