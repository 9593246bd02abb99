"""pqsec verify: who signed this document?"""

from pathlib import Path

import click

from pqsec_pki._files import read
from pqsec_pki.certificates import Certificate, verify_validity
from pqsec_pki.cli import _common
from pqsec_pki.errors import located
from pqsec_pki.keystore import load_certificate
from pqsec_pki.smime import Require, Verified
from pqsec_pki.smime import verify as verify_signed


@click.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--ca",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The permissions CA's certificate. [default: the keystore's]",
)
@click.option(
    "--alt-ca",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The countersigner's certificate. [default: *.alt.cert.pem beside the CA's]",
)
@click.option(
    "--require",
    type=click.Choice(["classical", "pq", "both"]),
    help="Refuse a file without such a signature.",
)
@_common.command_options
def verify(file: Path, ca: Path | None, alt_ca: Path | None, require: str | None) -> None:
    """Check that the permissions CA signed FILE.

    The CA itself must be the signer; certificates inside the file are not trusted. A
    post-quantum countersignature is checked if it is there. It can be stripped without
    a trace, so say --require both (or pq) where you expect one.
    """
    ca = ca or _common.open_keystore().permissions_ca_path
    beside = ca.with_name(ca.name.replace(".cert.pem", ".alt.cert.pem"))
    if alt_ca is None and beside != ca and beside.exists():
        alt_ca = beside
    certificate = _current(ca)
    second = _current(alt_ca) if alt_ca else None
    with located(file):
        verified = verify_signed(
            read(file),
            certificate,
            alternative_ca=second,
            require=Require(require) if require else Require.ANY,
        )
    _tell(file, verified, certificate, second)


def _current(path: Path) -> Certificate:
    certificate = load_certificate(path)
    with located(path):
        verify_validity(certificate, now=_common.now())
    return certificate


def _tell(
    file: Path, verified: Verified, certificate: Certificate, second: Certificate | None
) -> None:
    found = [
        {
            "algorithm": each.algorithm.name,
            "family": each.algorithm.family.value,
            "countersignature": each.countersignature,
            "signed_at": each.signed_at.isoformat() if each.signed_at else None,
        }
        for each in verified.signatures
    ]
    lines = [f"{file}: signed by {certificate.subject_name}"]
    for each in found:
        kind = "countersignature" if each["countersignature"] else "signature"
        when = f", {each['signed_at']}" if each["signed_at"] else ""
        lines.append(f"  good {kind}: {each['algorithm']} ({each['family']}){when}")
    countersigned = any(each.countersignature for each in verified.signatures)
    if second and not countersigned:
        _common.note("there is no countersignature: it was never made, or it was stripped")
    if verified.unchecked:
        _common.note("a countersignature was not checked: name its certificate with --alt-ca")
    value = {"ok": True, "file": str(file), "signer": certificate.subject_name}
    _common.emit(value | {"signatures": found, "unchecked": verified.unchecked}, lines)
