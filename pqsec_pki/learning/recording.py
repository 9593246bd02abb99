"""Reads what was recorded in a domain, names the participants, and merges those of one name."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import MalformedError, UsageError, located, meant, shown
from pqsec_pki.keystore import regular_name
from pqsec_pki.learning.cyclone_trace import IS_LINE, CycloneTrace
from pqsec_pki.learning.fastdds_dump import participants_in
from pqsec_pki.learning.node_info import IS_NODE, NodeInfo
from pqsec_pki.learning.seen import NotProposed, SeenParticipant, UnreadLine

MAX_RECORDING = 64 << 20
"""Bytes of one file: the lines about 1,500 nodes. A trace of one small node has 150 kB."""
MAX_LINE = 2048
"""Characters: Cyclone DDS cuts longer lines (log.c), and names of ROS 2 have 255 at most."""
MAX_ENDPOINTS = 500_000
"""Different ones of all files: 10,000 nodes of fifty each."""
MAX_NAME = 64
"""Characters: the name is a certificate's CN (RFC 5280, ub-common-name)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """The content of all files."""

    participants: tuple[SeenParticipant, ...]
    """One for each name, sorted."""
    left_out: tuple[NotProposed, ...]
    unread: tuple[UnreadLine, ...]


def read_recordings(
    paths: Sequence[Path], *, domain: int = 0, names: Mapping[str, str] | None = None
) -> Recording:
    """Read traces of Cyclone DDS, dumps of Fast DDS Monitor and outputs of `ros2 node info`.

    `domain` is that of the outputs. `names` gives a participant another name: the key is its
    name, or its label if it has no name. FileError if a file cannot be read; MalformedError if
    it is of no such kind or shows nothing; UsageError for a key that no participant has.
    """
    DomainSet.of(domain)
    trace = CycloneTrace()  # of all files: one may go on where another ended
    nodes: list[SeenParticipant] = []
    unread: list[UnreadLine] = []
    for path in paths:
        with located(path):
            found, lines = _read(path, trace, domain)
        nodes += found
        unread += lines
    seen = [*trace.participants(), *nodes]
    if sum(len(each.endpoints) for each in seen) > MAX_ENDPOINTS:
        raise MalformedError(f"more than {MAX_ENDPOINTS} endpoints in all files")
    given = names or {}
    _refuse_unknown(given, seen)
    named = [replace(each, name=_name(each, given)) for each in seen]
    left_out = tuple(dict.fromkeys(NotProposed(*out) for each in named if (out := _left_out(each))))
    return Recording(
        participants=tuple(_merged([each for each in named if not _left_out(each)])),
        left_out=left_out,
        unread=tuple(unread),
    )


def _read(
    path: Path, trace: CycloneTrace, domain: int
) -> tuple[list[SeenParticipant], list[UnreadLine]]:
    """Read a file into `trace`; or the nodes that it shows. And the lines that are not read."""
    text = read(path, limit=MAX_RECORDING).decode(errors="surrogateescape")
    if text.lstrip().startswith("{"):
        return participants_in(text, domain), []
    lines = text.split("\n")
    first = next((each for each in lines if each.strip()), "")
    if IS_LINE.fullmatch(first):
        before = trace.needed
        unread = [*_added(trace, path, lines)]
        if trace.needed == before and not unread:
            hint = "Cyclone DDS writes them for the tracing category `discovery`"
            raise MalformedError("no line is about a participant or an endpoint", hint=hint)
        return [], unread
    if IS_NODE.fullmatch(first):
        info = NodeInfo(domain)
        unread = [*_added(info, path, lines)]
        if reason := info.unfinished:
            unread.append(UnreadLine(path, len(lines), reason))
        return info.participants(), unread
    kinds = (
        "is not a trace of Cyclone DDS, a dump of Fast DDS Monitor or output of `ros2 node info`"
    )
    raise MalformedError(kinds if first else "is empty")


def _added(
    reader: CycloneTrace | NodeInfo, path: Path, lines: Sequence[str]
) -> Iterator[UnreadLine]:
    for number, line in enumerate(lines, start=1):
        if not line:
            continue
        if len(line) > MAX_LINE:
            yield UnreadLine(path, number, f"longer than {MAX_LINE} characters")
            continue
        try:
            reader.add(line)
        except MalformedError as error:
            yield UnreadLine(path, number, str(error))


def _refuse_unknown(names: Mapping[str, str], seen: Sequence[SeenParticipant]) -> None:
    there = {each.name or each.label for each in seen} - {""}
    for name in names:
        if name not in there:
            hint = meant(name, there)
            raise UsageError(f"no participant '{shown(name)}' was seen", hint=hint or None)


def _name(participant: SeenParticipant, names: Mapping[str, str]) -> str:
    return names.get(participant.name or participant.label, participant.name)


def _left_out(participant: SeenParticipant) -> tuple[str, str] | None:
    """What the participant is called, and why nothing can be proposed for it."""
    name, label = participant.name, participant.label
    if not name:
        # Any participant chooses its own label, and people paste this into a shell.
        way = f": name it with --name {shlex.quote(f'{label}=/NAME')}" if label else ""
        return label or "a participant", f"it has no enclave and no ROS 2 node{way}"
    if name.rpartition("/")[2].startswith("_"):
        return name, "it is a hidden node, as tools are"
    if not participant.endpoints:
        return name, "none of its topics was seen"
    try:
        regular = regular_name(name)
    except UsageError as error:
        return name, f"{error}; name it with --name"
    if len(regular) > MAX_NAME:
        return name, f"its name has more than {MAX_NAME} characters: name it with --name"
    return None


def _merged(seen: Sequence[SeenParticipant]) -> Iterator[SeenParticipant]:
    by_name: dict[str, list[SeenParticipant]] = {}
    for each in seen:
        by_name.setdefault(regular_name(each.name), []).append(each)
    for name, alike in sorted(by_name.items()):
        yield SeenParticipant(
            name=name,
            label=alike[0].label,
            nodes=tuple(dict.fromkeys(node for each in alike for node in each.nodes)),
            endpoints=frozenset().union(*(each.endpoints for each in alike)),
        )
