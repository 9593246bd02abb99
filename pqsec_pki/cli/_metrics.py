"""The metrics of `status --prometheus`, in Prometheus' text format 0.0.4.

Names and labels are stable: alert rules use them. A participant's profile, domains and state are
labels of pqsec_participant_info, not of its expiry, so that a series of the expiry goes on when
they change. `keystore` is a label of all, so that one collector may read the files of several.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_there, read, write
from pqsec_pki.errors import ExistsError
from pqsec_pki.keystore import Keystore, ListDelivery, RobotState, State, Status

_FIRST_LINE = "# HELP pqsec_not_after_seconds When it ends, as Unix time.\n"

Sample = tuple[dict[str, str], int]
"""Labels and value."""


@dataclass(frozen=True, slots=True)
class ListMetrics:
    """How far the newest revocation list got, and how much it does not end."""

    delivery: ListDelivery | None
    superseded: int
    """How many certificates were replaced and are still valid."""

    def lines(self, root: str) -> Iterator[str]:
        """The metrics; those of a list only if there is one."""
        yield from _metric(
            "superseded_certificates",
            "How many certificates were replaced, and are neither expired nor revoked.",
            [({"keystore": root}, self.superseded)],
        )
        if self.delivery:
            yield from _metric(
                "revocation_list_robots",
                "How many robots have the newest revocation list, lack it, or sent no receipt.",
                _robots(root, self.delivery),
            )
            until = self.delivery.until
            yield from _metric(
                "revoked_accepted_until_seconds",
                "Until when robots may accept revoked certificates, as Unix time; 0 if none does.",
                [({"keystore": root}, int(until.timestamp()) if until else 0)],
            )


def _robots(root: str, delivery: ListDelivery) -> Iterator[Sample]:
    lacking = len(delivery.late) - delivery.without_receipt
    counts = {
        "has": delivery.robots - len(delivery.late),
        "lacks": lacking,
        "unknown": delivery.without_receipt,
    }
    for list_, count in counts.items():
        yield {"keystore": root, "list": list_}, count


def write_metrics(  # noqa: PLR0913 -- what there is to write
    path: Path,
    keystore: Keystore,
    standing: Status,
    robots: Mapping[str, RobotState],
    lists: ListMetrics,
    *,
    is_whole: bool,
) -> None:
    """Write the metrics to `path`, atomically. ExistsError if it is another kind of file."""
    if is_there(path) and not read(path).startswith(_FIRST_LINE.encode()):
        raise ExistsError(
            f"{path} exists and is not a metrics file of pqsec", hint="choose another file"
        )
    lines = [*_lines(keystore, standing, robots, is_whole), *lists.lines(_root(keystore))]
    write(path, "".join(lines).encode(), force=True)


def _root(keystore: Keystore) -> str:
    """The label of all metrics."""
    return str(keystore.root.resolve())


def _lines(
    keystore: Keystore,
    standing: Status,
    robots: Mapping[str, RobotState],
    is_whole: bool,  # noqa: FBT001 -- used here only
) -> Iterator[str]:
    root = _root(keystore)
    yield from _metric("not_after_seconds", "When it ends, as Unix time.", _ends(root, standing))
    yield from _metric(
        "participant_info",
        "State, profile and domains of a participant, and what its robot runs; always 1.",
        _participants(root, standing, robots),
    )
    yield from _metric(
        "participants",
        "How many participants have this state, profile and domains.",
        _counts(root, keystore, standing),
    )
    yield from _metric(
        "ledger_whole",
        "Whether the ledger has all lines of which the CAs signed a head.",
        [({"keystore": root}, int(is_whole))],
    )
    yield from _metric(
        "clock_right",
        "Whether nothing is signed later than now, as with a clock that was ahead.",
        [({"keystore": root}, int(not standing.future))],
    )
    now = int(standing.at.timestamp())
    yield from _metric(
        "status_seconds", "When these metrics were made, as Unix time.", [({"keystore": root}, now)]
    )


def _ends(root: str, standing: Status) -> Iterator[Sample]:
    """What ends, of all sets of credentials; those of further ones have the label `set`."""
    for term in standing.shared:
        labels = {"keystore": root, "kind": term.kind, "name": term.name}
        yield _of_set(labels, term.set_name), int(term.not_after.timestamp())
    for person in standing.participants:
        labels = {"keystore": root, "kind": "participant", "name": person.name}
        yield labels, int(person.not_after.timestamp())
        for each in person.further:
            yield _of_set(labels, each.set_name), int(each.not_after.timestamp())


def _of_set(labels: dict[str, str], set_name: str) -> dict[str, str]:
    return {**labels, "set": set_name} if set_name else labels


def _participants(
    root: str, standing: Status, robots: Mapping[str, RobotState]
) -> Iterator[Sample]:
    for each in standing.participants:
        labels = {
            "keystore": root,
            "name": each.name,
            "state": each.state,
            "profile": each.profile or "",
            "domains": each.domains or "",
            "robot": robots[each.name].state,
        }
        yield labels, 1


def _counts(root: str, keystore: Keystore, standing: Status) -> Iterator[Sample]:
    """All states for each profile and domains, also with 0: an alert on a number then ends."""
    found = Counter(
        (each.profile or "", each.domains or "", each.state) for each in standing.participants
    )
    kinds = {(keystore.profile.name, str(keystore.domains))} | {key[:2] for key in found}
    for profile, domains in sorted(kinds):
        for state in State:
            labels = {"state": state.value, "profile": profile, "domains": domains}
            yield {"keystore": root, **labels}, found[profile, domains, state]


def _metric(name: str, words: str, samples: Iterable[Sample]) -> Iterator[str]:
    yield f"# HELP pqsec_{name} {words}\n# TYPE pqsec_{name} gauge\n"
    for labels, value in samples:
        written = ",".join(f'{key}="{_label(text)}"' for key, text in labels.items())
        yield f"pqsec_{name}{{{written}}} {value}\n"


def _label(text: str) -> str:
    """The text, escaped. A path that is not UTF-8 has `\\xff` for a byte."""
    text = text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
