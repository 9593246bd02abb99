"""pqsec verify: who signed this document?"""

from dataclasses import replace
from pathlib import Path

import click

from pqsec_pki._files import is_there, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.credentials import (
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    TrustAnchors,
    only_certificate,
)
from pqsec_pki.documents import validate
from pqsec_pki.errors import PqsecError, VerificationError, located
from pqsec_pki.smime import Require, Verified


@click.command()
@click.argument("file", type=_settings.FILE)
@click.option(
    "--ca",
    type=_settings.FILE,
    help="The permissions CA's certificate. [default: the keystore's]",
)
@click.option(
    "--alt-ca",
    type=_settings.FILE,
    help="The countersigner's certificate. [default: *.alt.cert.pem beside the CA's]",
)
@click.option(
    "--require",
    type=click.Choice([each.value for each in Require]),
    help="Refuse a file without such a signature. [default: what the keystore's CAs"
    " promise; both with --alt-ca; any with --ca]",
)
@_settings.command_options
def verify(file: Path, ca: Path | None, alt_ca: Path | None, require: str | None) -> None:
    """Check who signed a governance or permissions document.

    The permissions CA itself must be the signer; certificates inside the file are not
    trusted. A post-quantum countersignature is checked if it is there. It can be
    stripped without a trace, so with --ca say --require both (or pq) where you expect
    one.
    """
    if ca is None:
        keystore = _settings.open_keystore()
        ca, anchors = keystore.permissions_ca_path, keystore.anchors
        if alt_ca:
            anchors = replace(anchors, countersigner=_certificate(alt_ca))
        demanded = Require(require) if require else None
    else:
        # Who names a countersigner expects its signature.
        demanded = Require(require) if require else None if alt_ca else Require.ANY
        alt_ca = alt_ca or _beside(ca)
        anchors = TrustAnchors(
            identity_cas=(),
            permissions_ca=_certificate(ca),
            countersigner=_certificate(alt_ca) if alt_ca else None,
        )
        _tell_of_version_1(anchors.permissions_ca, ca)
    message = read(file)
    try:
        _refuse_signers(anchors, {PERMISSIONS_CA: ca, PERMISSIONS_ALT_CA: alt_ca or _second(ca)})
        with located(file):
            verified = anchors.signed(message, demanded)
    except VerificationError as error:
        if _settings.settings().json:
            problems = [str(each) for each in error.problems]
            _printing.emit({"ok": False, "file": str(file), "problems": problems}, [])
        raise
    _tell(file, verified, anchors)


def _beside(ca: Path) -> Path | None:
    """The countersigner's certificate, where a keystore has it."""
    beside = _second(ca)
    return beside if beside != ca and is_there(beside) else None


def _second(ca: Path) -> Path:
    return ca.with_name(ca.name.replace(".cert.pem", ".alt.cert.pem"))


def _certificate(path: Path) -> Certificate:
    return only_certificate(read(path), str(path))


def _tell_of_version_1(certificate: Certificate, path: Path) -> None:
    """A trust anchor is a name and a key (RFC 5280 6.1.1 (d)): it need not say what it is."""
    if certificate.version == 1:
        _printing.note(
            f"{path} is a certificate of version 1, which does not say whether it is a CA's:"
            " it is trusted because you name it"
        )


def _refuse_signers(anchors: TrustAnchors, paths: dict[str, Path]) -> None:
    """VerificationError, naming the files, if no document should be signed by these CAs."""
    problems = [
        replace(each, subject=str(paths.get(each.subject, each.subject)))
        for each in anchors.signer_problems(_settings.now())
    ]
    if problems:
        raise VerificationError(*problems)


def _kind(document: bytes) -> str | None:
    """governance or permissions; None where the document is neither, or broken."""
    try:
        return validate(document).value
    except PqsecError:
        return None


def _tell(file: Path, verified: Verified, anchors: TrustAnchors) -> None:
    found = [
        {
            "algorithm": each.algorithm.name,
            "family": each.algorithm.family.value,
            "countersignature": each.countersignature,
            "signed_at": each.signed_at.isoformat() if each.signed_at else None,
        }
        for each in verified.signatures
    ]
    lines = [f"{file}: signed by {anchors.permissions_ca.subject_name}"]
    for each in found:
        kind = "countersignature" if each["countersignature"] else "signature"
        when = f", {each['signed_at']}" if each["signed_at"] else ""
        lines.append(f"  good {kind}: {each['algorithm']} ({each['family']}){when}")
    countersigned = any(each.countersignature for each in verified.signatures)
    if anchors.countersigner and not countersigned:
        _printing.note("there is no countersignature: it was never made, or it was stripped")
    if verified.unchecked:
        _printing.note("a countersignature was not checked: name its certificate with --alt-ca")
    value = {
        "ok": True,
        "file": str(file),
        "kind": _kind(verified.document),
        "signer": anchors.permissions_ca.subject_name,
        "countersigned": countersigned,
    }
    _printing.emit(value | {"signatures": found, "unchecked": verified.unchecked}, lines)
