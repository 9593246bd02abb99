"""pqsec permissions learn: propose permissions from what was seen in a domain."""

from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki import _files, learning
from pqsec_pki.cli import _help, _policy, _printing, _settings
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.learning import Comparison, Learned, UnreadLine, read_recordings

MOST_UNREAD = 20
"""Lines that are named; the others are mostly similar."""


@_help.command(
    examples={
        "Propose permissions from a trace of Cyclone DDS": (
            "pqsec permissions learn domain.log -o learned.yaml"
        ),
        "Propose them from what Fast DDS Monitor saved": (
            "pqsec permissions learn monitor.json --validity 90d"
        ),
        "Compare what nodes were seen to use with what is granted": (
            "pqsec -k robots permissions learn monday.txt tuesday.txt"
        ),
    },
    exit_codes={
        0: "proposed; with a keystore: everything that was seen is granted",
        1: "something that was seen is not granted in the keystore",
        3: "a file cannot be read or written; or a line cannot be read: it is left out",
    },
)
@click.argument("files", nargs=-1, required=True, type=_settings.FILE, metavar="FILE...")
@click.option(
    "--name",
    "names",
    multiple=True,
    metavar="SEEN=NAME",
    help="Call the participant SEEN (an enclave, node, entity name or process) NAME. Repeatable.",
)
@click.option(
    "--domain",
    default=0,
    show_default=True,
    type=int,
    help="The DDS domain, where FILE does not show it: `ros2 node info`, or a discovery server.",
)
@_policy.validity_option
@_policy.output_options
@_settings.command_options
def learn(  # noqa: PLR0913 -- one for each option, by name
    files: tuple[Path, ...],
    names: tuple[str, ...],
    domain: int,
    validity: timedelta,
    output: Path | None,
    *,
    force: bool,
) -> int:
    """Propose permissions from what was seen in a domain without security.

    FILE is a trace of Cyclone DDS (category `discovery`) or a dump of Fast DDS Monitor, which show
    participants of every stack, or the output of `ros2 node info`. Each participant gets what it
    was seen to use, and what ROS 2 nodes need to start. With a keystore, the differences to what
    it grants are shown. The keystore is not changed. What was seen may be too much or not enough:
    review it.
    """
    now = _settings.now()
    recording = read_recordings(files, domain=domain, names=_names(names))
    duration = _policy.duration_text(validity)
    found = learning.learn(recording, _keystore(), validity=duration, now=now)
    _put(found, files, output, force=force)
    _refuse_unread(found.unread)
    return 0 if found.ok else 1


def _names(given: tuple[str, ...]) -> dict[str, str]:
    pairs = [each.rpartition("=") for each in given]
    for text, (seen, _, name) in zip(given, pairs, strict=True):
        if not seen or not name.startswith("/"):
            raise UsageError(f"--name {text}: write SEEN=/NAME", hint="such as --name camera=/arm")
    return {seen: name for seen, _, name in pairs}


def _keystore() -> Keystore | None:
    try:
        _settings.keystore_path()
    except UsageError:
        return None
    return _settings.open_keystore()


def _notes(comparison: Comparison) -> Iterator[str]:
    if not comparison.known:
        yield "not in the keystore"
        return
    differ = comparison.not_granted or comparison.never_seen
    if not differ:
        yield "granted as proposed"
    yield from (
        f"seen and not granted: {_printing.printable(each)}" for each in comparison.not_granted
    )
    yield from (
        f"granted and never seen: {_printing.printable(each)}" for each in comparison.never_seen
    )
    if not comparison.complete:
        yield "there may be more differences: too many patterns overlap"


def _ends(found: Learned) -> Iterator[str]:
    for name in found.differences.never_seen if found.differences else ():
        yield f"in the keystore and never seen: {_printing.printable(name)}"
    for each in found.left_out:
        yield _printing.printable(f"not proposed: {each.what}: {each.reason}")
    if found.unread:
        yield f"{_printing.counted(len(found.unread), 'line')} could not be read"


def _head(files: tuple[Path, ...]) -> Iterator[str]:
    names = " ".join(map(str, files))
    yield f"Proposed by `pqsec permissions learn` from {_printing.printable(names)}."
    yield "It allows what was seen, and what ROS 2 nodes need to start. What was not seen may be"
    yield "needed too, and what was seen may not be needed: review it before you issue it."


def _put(found: Learned, files: tuple[Path, ...], output: Path | None, *, force: bool) -> None:
    """Write or print the document, with what there is to say of each participant beside it."""
    comparisons = found.differences.comparisons if found.differences else ()
    notes = {each.name: [*_notes(each)] for each in comparisons}
    ends = [*_ends(found)]
    lines = [f"{name}: {text}" for name, texts in notes.items() for text in texts] + ends
    document = found.document([*_head(files), *ends], notes)
    if output is None or not document:
        text = document or "\n".join([*lines, "no participant to propose permissions for"])
        value = {"document": document or None, **found.to_json()}
        _printing.emit(value, [text.strip()], verbatim=True)
        return
    _files.write(output, document.encode(), force=force)
    written = f"{output}  ({len(document.encode())} bytes)"
    _printing.emit({"written": output, **found.to_json()}, [*lines, written])


def _refuse_unread(unread: tuple[UnreadLine, ...]) -> None:
    for each in unread[:MOST_UNREAD]:
        _printing.note(f"not read: {each}")
    if unread:
        more = len(unread) - MOST_UNREAD
        raise FileError(
            f"{_printing.counted(len(unread), 'line')} cannot be read: the proposal may lack rights"
            + (f"; {more} of them are not named" if more > 0 else ""),
            hint="the notes above name each line",
        )
