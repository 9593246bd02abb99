"""verify-handshake of two participants: the report as lines."""

from collections.abc import Iterator, Sequence

from pqsec_pki.cli import _printing
from pqsec_pki.documents import ros
from pqsec_pki.selfcheck import HandshakeReport

_MAX_LISTED = 6
"""The most topics, or domains, in a line."""
_NO_TOPIC = (
    "They share no topic: neither may subscribe to anything that the other may publish,"
    f" {ros.DISCOVERY} aside."
)


def lines_of(report: HandshakeReport) -> list[str]:
    """The report as lines."""
    width = max(len(step.name) for step in report.steps)
    lines = [
        f"{'ok  ' if step.ok else 'FAIL'}  {step.name.ljust(width)}  {step.detail}"
        for step in report.steps
    ]
    if failed := report.failed:
        hint = [f"hint: {failed.hint}"] if failed.hint else []
        return [*lines, "", f"They would not meet: {failed.name} failed.", *hint]
    sizes = ", ".join(f"{name} {size} B" for name, size in report.token_bytes.items())
    return [
        *lines,
        "",
        *_topic_lines(report),
        f"signatures {report.signature}, key agreement {report.key_agreement}",
        f"{sizes}; {report.milliseconds:.1f} ms for both sides",
    ]


def _topic_lines(report: HandshakeReport) -> Iterator[str]:
    """The domain, and the topics that each may send to the other."""
    if report.domain is None:
        return
    others = [str(each) for each in report.shared if each != report.domain]
    also = f"; both may join {_shortened(others)} too" if others else ""
    yield f"They meet on domain {report.domain}{also}."
    for talk in report.talks:
        topics = _shortened(talk.topics) if talk.topics else "no topic"
        yield f"{talk.sender} to {talk.receiver}: {topics}"
    if not any(talk.topics for talk in report.talks):
        yield _NO_TOPIC


def _shortened(names: Sequence[str]) -> str:
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return ", ".join(map(_printing.printable, names[:_MAX_LISTED])) + more
