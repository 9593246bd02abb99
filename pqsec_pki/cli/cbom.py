"""pqsec cbom: write a cryptographic bill of materials."""

from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cbom import Bill, bill_of
from pqsec_pki.cli import _help, _policy, _printing, _settings
from pqsec_pki.errors import FileError


@_help.command(
    examples={
        "Print the bill of a keystore": "pqsec -k robots cbom",
        "Write the bill of two folders into a file": (
            "pqsec cbom robots/enclaves/talker robots/public -o talker.cdx.json"
        ),
    },
    exit_codes={
        0: "written",
        3: "incomplete: a file cannot be read; or the library for CycloneDX is not installed",
    },
)
@click.argument("paths", nargs=-1, type=_settings.PATH, metavar="[PATH]...")
@click.option("--timestamp", is_flag=True, help="Write the current time into the bill.")
@_policy.output_options
@_settings.command_options
def cbom(paths: tuple[Path, ...], output: Path | None, *, timestamp: bool, force: bool) -> None:
    """Write a cryptographic bill of materials (CBOM) in CycloneDX 1.7.

    It lists the algorithms, certificates, keys and protocols in each PATH: a keystore, a folder,
    or a file; without PATH, in the keystore of -k. No key's bits are in it, and no private
    key is decrypted. The same files give the same bytes, unless --timestamp is given. Nothing
    is verified: use `pqsec check`.
    """
    now = _settings.now()
    named = paths or (_settings.keystore_path(),)
    bill = bill_of(named, now=now, timestamp=now if timestamp else None)
    _put(bill, output, force=force)
    for each in bill.unread:
        _printing.note(f"not in the bill: {each.path}: {each.reason}")
    if bill.unread:
        raise FileError(
            "the bill is incomplete: a file cannot be read",
            hint="the notes above name each file; `pqsec check` has the reasons",
        )


def _put(bill: Bill, output: Path | None, *, force: bool) -> None:
    value: dict[str, object] = {"components": bill.counts, "unread": bill.unread}
    if output is None:
        lines = [bill.document.removesuffix("\n")]
        _printing.emit({"document": bill.document, **value}, lines, verbatim=True)
        return
    _files.write(output, bill.document.encode(), force=force)
    numbers = [f"{kind} {number}" for kind, number in bill.counts.items()]
    _printing.emit({"written": output, **value}, [f"{output}: {', '.join(numbers)}"])
