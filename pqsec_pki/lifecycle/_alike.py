"""Issues a participant with what it has already: the same permissions, until the same end."""

from pathlib import Path
from shlex import quote

from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import Permissions
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore, StagedFolder, layout
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued, Issuer, PublicKeys


def issued_alike(
    issuer: Issuer,
    inspector: Inspector,
    name: str,
    folder: StagedFolder,
    keys: PublicKeys | None = None,
) -> Issued:
    """Stage a certificate that ends with the inspector's one, and its permissions, signed again.

    With new keys, or `keys`. KeystoreError for a subject or permissions in another form than pqsec
    writes: sets of credentials would differ. Other errors as of the inspector.
    """
    old, permissions, digest = credentials_to_copy(inspector, name)
    keys = keys or issuer.new_keys(folder)
    certificate = issuer.authorities.identity.issue(
        name,
        keys.key,
        alternative=keys.alternative,
        number=issuer.number,
        now=issuer.now,
        validity=old.not_after - issuer.now,
    )
    return issuer.stage(
        folder, name, certificate, permissions, asked=old.not_after, config_digest=digest
    )


def credentials_to_copy(
    inspector: Inspector, name: str
) -> tuple[Certificate, Permissions | None, str]:
    """The certificate of the first set, its permissions if it has some, and their config digest.

    KeystoreError if pqsec would write another subject or another form.
    """
    there = inspector.keystore.folder / layout.enclave_folder(name)
    certificate = inspector.certificate(name, there)
    if certificate.subject_name != f"CN={name}":
        raise other_form(there / layout.CERTIFICATE, _renewal(inspector.keystore, name))
    if inspector.lacks_permissions(name, there):
        return certificate, None, ""
    document = document_of(inspector.anchors, inspector.signed_permissions(name, there))
    permissions = Permissions.from_xml(document)
    if permissions.to_xml() != document:
        raise other_form(there / layout.PERMISSIONS, _renewal(inspector.keystore, name))
    return certificate, permissions, inspector.config_digest(name, there)


def document_of(anchors: TrustAnchors, signed: bytes) -> bytes:
    """The document in a signed file, with the ends of lines of our files."""
    return anchors.signed(signed).document.replace(b"\r\n", b"\n")


def other_form(path: Path, way_out: str) -> KeystoreError:
    """The error for what another set of credentials could not have in the same form."""
    return KeystoreError(
        f"{path} has another form than pqsec writes: the sets would differ",
        hint=way_out,
    )


def _renewal(keystore: Keystore, name: str) -> str:
    return f"`pqsec -k {quote(str(keystore.root))} renew {quote(name)}`"
