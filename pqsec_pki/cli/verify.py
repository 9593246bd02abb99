"""pqsec verify: check the signatures of a document."""

import os
from dataclasses import replace
from pathlib import Path
from shlex import quote

import click

from pqsec_pki._files import is_there, read
from pqsec_pki._times import exact
from pqsec_pki.certificates import Certificate
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.credentials import (
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    TrustAnchors,
)
from pqsec_pki.documents import validate
from pqsec_pki.errors import PqsecError, UsageError, VerificationError, located
from pqsec_pki.keystore import load_certificate, one_set
from pqsec_pki.report import refuse_changed, signature_path
from pqsec_pki.smime import FoundSignature, Require, Verified


@_help.command(
    examples={
        "Check a document of the keystore": "pqsec verify robots/enclaves/talker/permissions.p7s",
        "Check it with the CA certificate alone, and demand both signatures": (
            "pqsec verify permissions.p7s --ca robots/public/permissions_ca.cert.pem --require both"
        ),
        "Check a signed report, which is beside its signature": "pqsec verify june.html.p7s",
    },
    exit_codes={
        0: "the CA signed the document, or the report",
        1: "the signature is not valid, or one is missing",
        3: "a file or the keystore cannot be read",
    },
)
@click.argument("file", type=_settings.FILE)
@click.option(
    "--ca",
    type=_settings.FILE,
    help="Trust this permissions CA certificate. [default: the keystore's]",
)
@click.option(
    "--alt-ca",
    type=_settings.FILE,
    help="Trust this countersigner certificate. [default: *.alt.cert.pem next to the CA's]",
)
@click.option(
    "--require",
    type=click.Choice([each.value for each in Require]),
    help="Refuse a file without this kind of signature. [default: as the keystore's CAs sign;"
    " both with --alt-ca; any with --ca]",
)
@click.option(
    "--set",
    "profile",
    metavar="PROFILE",
    help="Trust the permissions CA of this profile. [default: of the set that has the file]",
)
@_settings.command_options
def verify(
    file: Path, ca: Path | None, profile: str | None, alt_ca: Path | None, require: str | None
) -> None:
    """Check who signed a governance or permissions document.

    FILE can also be the signature that `pqsec report --sign` writes: the report, which must be
    beside it, is checked too.

    The permissions CA itself must be the signer; certificates inside the file are not
    trusted. A post-quantum countersignature is checked if there is one. It can be removed
    without a trace: with --ca, use --require both (or pq) if you expect one.
    """
    # Without a keystore, --alt-ca means that a countersignature is expected.
    demanded = Require(require) if require else Require.ANY if ca and not alt_ca else None
    if ca and profile:
        raise UsageError("--ca and --set exclude each other")
    anchors, paths = _of_files(ca, alt_ca) if ca else _of_keystore(file, profile, alt_ca)
    message = read(file)
    try:
        _refuse_signers(anchors, paths)
        with located(file):
            verified = anchors.signed(message, demanded)
        report = refuse_changed(verified.document, file)
    except VerificationError as error:
        if _settings.settings().json:
            problems = [str(each) for each in error.problems]
            _printing.emit({"ok": False, "file": str(file), "problems": problems}, [])
        beside = signature_path(file)
        if is_there(beside):
            error.hint = f"the signature is in another file: `pqsec verify {quote(str(beside))}`"
        raise
    _print_signatures(report or file, verified, anchors, is_report=report is not None)


def _of_keystore(
    file: Path, profile: str | None, alt_ca: Path | None
) -> tuple[TrustAnchors, dict[str, Path]]:
    """The CAs of that set of the keystore, and the files of those that sign documents.

    Without `profile`, of the set that has the file. UsageError for a file elsewhere, if there are
    several sets: a signature of the weakest would do.
    """
    keystore = _settings.open_keystore(instead="the signer's certificate: --ca FILE")
    if profile is None and (place := Path(os.path.realpath(file))).is_relative_to(
        os.path.realpath(keystore.root)
    ):
        own = (
            each
            for each in keystore.sets[1:]
            if place.is_relative_to(os.path.realpath(each.folder))
        )
        keystore = next(own, keystore)
    else:
        keystore = one_set(keystore, profile)
    anchors = keystore.anchors
    if alt_ca:
        anchors = replace(anchors, countersigner=load_certificate(alt_ca))
    return anchors, _paths(keystore.permissions_ca_path, alt_ca)


def _of_files(ca: Path, alt_ca: Path | None) -> tuple[TrustAnchors, dict[str, Path]]:
    """The CAs in these files, and the files."""
    alt_ca = alt_ca or _beside(ca)
    anchors = TrustAnchors(
        identity_cas=(),
        permissions_ca=load_certificate(ca),
        countersigner=load_certificate(alt_ca) if alt_ca else None,
    )
    _note_version_1(anchors.permissions_ca, ca)
    return anchors, _paths(ca, alt_ca)


def _paths(ca: Path, alt_ca: Path | None) -> dict[str, Path]:
    return {PERMISSIONS_CA: ca, PERMISSIONS_ALT_CA: alt_ca or _second(ca)}


def _beside(ca: Path) -> Path | None:
    """The path of the countersigner's certificate next to `ca`, if it exists."""
    beside = _second(ca)
    return beside if beside != ca and is_there(beside) else None


def _second(ca: Path) -> Path:
    return ca.with_name(ca.name.replace(".cert.pem", ".alt.cert.pem"))


def _note_version_1(certificate: Certificate, path: Path) -> None:
    """Note a version 1 CA. A trust anchor is a name and a key only (RFC 5280 6.1.1 (d))."""
    if certificate.version == 1:
        _printing.note(
            f"{path} is a version 1 certificate, which does not state whether it is a CA: it is"
            " trusted because you named it"
        )


def _refuse_signers(anchors: TrustAnchors, paths: dict[str, Path]) -> None:
    """VerificationError, with the files, if these CAs may not sign documents."""
    problems = [
        replace(each, subject=str(paths.get(each.subject, each.subject)))
        for each in anchors.signer_problems(_settings.now())
    ]
    if problems:
        raise VerificationError(*problems)


def _kind(document: bytes) -> str | None:
    """governance or permissions; None if the document is neither or not valid."""
    try:
        return validate(document).value
    except PqsecError:
        return None


def _print_signatures(
    file: Path, verified: Verified, anchors: TrustAnchors, *, is_report: bool
) -> None:
    lines = [f"{file}: signed by {anchors.permissions_ca.subject_name}"]
    lines += map(_line, verified.signatures)
    countersigned = any(each.countersignature for each in verified.signatures)
    if anchors.countersigner and not countersigned:
        _printing.note("there is no countersignature: it was never made, or it was removed")
    if verified.unchecked:
        _printing.note("a countersignature was not checked: name its certificate with --alt-ca")
    value = {
        "ok": True,
        "file": str(file),
        "kind": "report" if is_report else _kind(verified.document),
        "signer": anchors.permissions_ca.subject_name,
        "countersigned": countersigned,
        "signatures": verified.signatures,
        "unchecked": verified.unchecked,
    }
    _printing.emit(value, lines)


def _line(found: FoundSignature) -> str:
    kind = "countersignature" if found.countersignature else "signature"
    when = f", {exact(found.signed_at)}" if found.signed_at else ""
    return f"  good {kind}: {found.algorithm.name} ({found.algorithm.family.value}){when}"
