"""pqsec verify-handshake: would these two authenticate each other?"""

import click

from pqsec_pki.algorithms import KEY_AGREEMENTS, Profile
from pqsec_pki.cli import _common
from pqsec_pki.errors import UnknownAlgorithmError, UsageError
from pqsec_pki.selfcheck import Report, meet


@click.command("verify-handshake")
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@click.option("--kem", metavar="NAME", help="Another key agreement than the profile's.")
@click.option(
    "--domain", type=click.IntRange(0, 230), help="The domain they meet on. [default: the CA's]"
)
@_common.command_options
def verify_handshake(first: str, second: str, kem: str | None, domain: int | None) -> None:
    """Run the authentication handshake between two participants.

    All three messages between A and B, in memory: both certificate chains, both
    permissions documents, and the key exchange up to one encrypted message each way.
    Exit 1, with the failing step, if they would not meet.
    """
    keystore = _common.open_keystore()
    if kem:
        _warn_of_a_weaker(kem, keystore.profile)
    report = meet(
        keystore,
        first,
        second,
        agreement=KEY_AGREEMENTS.named(kem) if kem is not None else keystore.profile.key_agreement,
        domain=keystore.domains.ids()[0] if domain is None else domain,
        now=_common.now(),
    )
    _common.emit(report.to_json(), lines_of(report))
    if not report.ok:
        click.get_current_context().exit(1)


def _warn_of_a_weaker(kem: str, profile: Profile) -> None:
    try:
        profile.changed({"key_agreement": kem})
    except UnknownAlgorithmError:
        raise
    except UsageError as error:
        _common.note(f"{error}; trying it all the same")


def lines_of(report: Report) -> list[str]:
    """The report for a person."""
    width = max(len(step.name) for step in report.steps)
    lines = [
        f"{'ok  ' if step.ok else 'FAIL'}  {step.name.ljust(width)}  {step.detail}"
        for step in report.steps
    ]
    failed = next((step for step in report.steps if not step.ok), None)
    if failed:
        hint = [f"hint: {failed.hint}"] if failed.hint else []
        return [*lines, "", f"They would not meet: {failed.name} failed.", *hint]
    sizes = ", ".join(f"{name} {size} B" for name, size in report.token_bytes.items())
    return [
        *lines,
        "",
        f"signatures {report.signature}, key agreement {report.key_agreement}",
        f"{sizes}; {report.milliseconds:.1f} ms for both sides",
    ]
