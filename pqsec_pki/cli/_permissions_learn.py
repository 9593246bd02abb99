"""pqsec permissions learn: propose permissions from what was seen in a domain."""

from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cli import _policy, _printing, _settings
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.learning import (
    Comparison,
    Learned,
    NotProposed,
    UnreadLine,
    compare,
    document_of,
    propose,
    read_recordings,
)

MOST_UNREAD = 20
"""Lines that are named; the others are mostly similar."""


def add_command(group: click.Group) -> None:
    """Add `learn` to the group."""

    @group.command(
        examples={
            "Propose permissions from a trace of Cyclone DDS": (
                "pqsec permissions learn domain.log -o learned.yaml"
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
        help="Call the participant SEEN (an enclave, node, entity name or process) NAME."
        " Repeatable.",
    )
    @click.option(
        "--domain",
        default=0,
        show_default=True,
        type=int,
        help="The DDS domain of `ros2 node info`, which does not show it.",
    )
    @click.option(
        "--validity",
        type=_settings.Duration(),
        default="1y",
        show_default=True,
        help="Grant the rights for this long: 1y, 26w, 90d or 12h.",
    )
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

        FILE is a trace of Cyclone DDS (category `discovery`), which shows participants of every
        stack, or the output of `ros2 node info`. Each participant gets what it was seen to use,
        and what ROS 2 nodes need to start. With a keystore, the differences to what it grants are
        shown. The keystore is not changed. What was seen may be too much or not enough: review it.
        """
        now = _settings.now()
        recording = read_recordings(files, domain=domain, names=_names(names))
        duration = _policy.duration_text(validity)
        found = propose(recording.participants, validity=duration, now=now)
        keystore = _keystore()
        learned = compare(keystore, found.proposals, now=now) if keystore else None
        left_out = (*recording.left_out, *found.left_out)
        notes = {each.name: [*_notes(each)] for each in learned.comparisons} if learned else {}
        ends = [*_ends(learned, left_out, len(recording.unread))]
        head = [*_head(files), *ends]
        document = document_of(found.proposals, head, notes) if found.proposals else ""
        lines = [f"{name}: {text}" for name, texts in notes.items() for text in texts] + ends
        _put(document, lines, learned, left_out, recording.unread, output=output, force=force)
        _refuse_unread(recording.unread)
        return 0 if learned is None or learned.ok else 1


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


def _ends(learned: Learned | None, left_out: tuple[NotProposed, ...], unread: int) -> Iterator[str]:
    for name in learned.never_seen if learned else ():
        yield f"in the keystore and never seen: {_printing.printable(name)}"
    for each in left_out:
        yield _printing.printable(f"not proposed: {each.what}: {each.reason}")
    if unread:
        yield f"{_printing.counted(unread, 'line')} could not be read"


def _head(files: tuple[Path, ...]) -> Iterator[str]:
    names = " ".join(map(str, files))
    yield f"Proposed by `pqsec permissions learn` from {_printing.printable(names)}."
    yield "It allows what was seen, and what ROS 2 nodes need to start. What was not seen may be"
    yield "needed too, and what was seen may not be needed: review it before you issue it."


def _put(  # noqa: PLR0913 -- the parts of the result
    document: str,
    lines: list[str],
    learned: Learned | None,
    left_out: tuple[NotProposed, ...],
    unread: tuple[UnreadLine, ...],
    *,
    output: Path | None,
    force: bool,
) -> None:
    value: dict[str, object] = {
        "participants": learned.comparisons if learned else None,
        "never_seen": learned.never_seen if learned else None,
        "left_out": [each._asdict() for each in left_out],
        "unread": [each._asdict() for each in unread],
    }
    if output is None or not document:
        text = document or "\n".join([*lines, "no participant to propose permissions for"])
        _printing.emit({"document": document or None, **value}, [text.strip()], verbatim=True)
        return
    _files.write(output, document.encode(), force=force)
    written = f"{output}  ({len(document.encode())} bytes)"
    _printing.emit({"written": output, **value}, [*lines, written])


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
