"""pqsec status: show participants, their state and expiry."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import click

from pqsec_pki._times import said
from pqsec_pki.cli import _completion, _formats, _help, _pager, _printing, _settings
from pqsec_pki.cli._metrics import ListMetrics, write_metrics
from pqsec_pki.cli._names import named
from pqsec_pki.cli._times import end
from pqsec_pki.documents import MAX_DOMAIN
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import (
    Entry,
    Keystore,
    ListDelivery,
    ParticipantState,
    RobotState,
    State,
    Status,
    faults_of_ledger,
    list_delivery,
    robot_states,
    superseded_certificates,
)
from pqsec_pki.keystore import status as status_of

_HEADERS = ("participant", "state", "until", "profile", "domains", "serial")
_COLUMNS = ("name", "state", "not_after", "profile", "domains", "serial")
_ROBOT_HEADERS = ("robot", "runs", "should run", "changed")
_SUPERSEDED = "superseded"
_ROBOT_COLUMNS = ("robot", "runs", "should_run", "changed", "installed_at")
_ROLES = {
    "identity-ca": "identity CA",
    "permissions-ca": "permissions CA",
    "countersigner": "countersigner",
    "trusted-too": "trusted too",
    "crl": "revocation list",
}


@_help.command(
    examples={
        "Show all participants": "pqsec status",
        "Show all nodes of a robot": "pqsec status '/fleet/*'",
        "Mark what expires within 30 days": "pqsec status --due 30d",
        "List what expired or expires this month, for a spreadsheet": (
            "pqsec status --expires-before 30d --format csv"
        ),
        "Write metrics for Prometheus": "pqsec status --prometheus pqsec.prom",
    },
    exit_codes={
        0: "the state is shown",
        3: "the keystore cannot be read, or the metrics cannot be written",
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--due",
    type=_settings.Duration(),
    help="Mark what expires within this time as due.  [default: a third of its life]",
)
@click.option(
    "--state",
    "states",
    type=click.Choice([state.value for state in State]),
    multiple=True,
    help="Show only participants in this state; repeatable.",
)
@click.option(
    "--domain",
    type=click.IntRange(0, MAX_DOMAIN),
    metavar="ID",
    help="Show only participants that may join this DDS domain.",
)
@click.option(
    "--expires-before",
    type=_settings.When(),
    metavar="WHEN",
    help="Show only what expires before this time: 2027-01-31, or 30d from now.",
)
@_formats.option()
@click.option(
    "--prometheus",
    type=_settings.FILE,
    help="Also write metrics to this file, for the textfile collector; replaces older metrics.",
)
@_pager.option
@_settings.command_options
def status(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    names: tuple[str, ...],
    due: timedelta | None,
    states: tuple[str, ...],
    domain: int | None,
    expires_before: datetime | None,
    form: str,
    prometheus: Path | None,
) -> None:
    """Show each participant's state and expiry, the most urgent first.

    NAME may be a pattern ('/robot1/*') or a group (@hall1); without a NAME, all are
    shown. The data comes from the ledger, not from the files: check those with `pqsec check`.
    A note says if the ledger does not have the lines of the newest head that the CAs signed.

    After `pqsec receipt import`, it also compares the files with those that each robot has
    installed: `robot` is current, outdated, or unknown without a receipt; then follow the numbers
    of the bundles that it runs and should run, and the files that differ. `pqsec bundle
    --outdated` writes what robots lack. It also says which robots do not have the newest
    revocation list, what they accept, and until when.

    `superseded` is the number of earlier certificates that are still valid, with the last end:
    `pqsec revoke NAME --superseded` ends them.
    """
    _formats.chosen(form)
    keystore = _settings.open_keystore().as_found  # `faults_of_ledger` says what is wrong
    chosen = named(keystore, names)
    is_filtered = bool(names or states or domain is not None or expires_before)
    if prometheus and is_filtered:
        raise UsageError("--prometheus shows all: it excludes NAME and filters")
    standing = status_of(keystore, chosen or None, now=_settings.now(), due=due)
    every = None if chosen else standing.participants
    delivery = list_delivery(keystore, now=standing.at, participants=every)
    earlier = superseded_certificates(keystore, now=standing.at)
    standing = standing.only(set(map(State, states)) or None, domain, expires_before)
    robots = robot_states(keystore, standing.participants)
    rows = [_value(each, earlier.get(each.name, ()), robots) for each in standing.participants]
    _note(standing)
    faults, policy = faults_of_ledger(keystore), keystore.approvals
    if prometheus:
        lists = ListMetrics(delivery, sum(map(len, earlier.values())))
        write_metrics(prometheus, keystore, standing, robots, lists, is_whole=not faults)
    _formats.emit(
        form,
        {
            "keystore": keystore.root,
            **standing.to_json(),
            "participants": rows,
            "delivery": delivery,
            "ledger": {"head": standing.head, "faults": faults},
            "approvals": policy.to_json() if policy else None,
        },
        _lines(
            keystore,
            standing,
            robots,
            earlier,
            "none" if is_filtered else "none yet: pqsec issue NAME",
            [
                *([f"approvals        {policy}"] if policy else []),
                *(f"ledger           NOT AS SIGNED: {fault}" for fault in faults),
                *([] if is_filtered else _of_list(delivery)),
            ],
        ),
        columns=(*_COLUMNS, *_ROBOT_COLUMNS, _SUPERSEDED),
        items=rows,
    )


def _lines(  # noqa: PLR0913, PLR0917 -- what there is to tell
    keystore: Keystore,
    standing: Status,
    robots: Mapping[str, RobotState],
    earlier: Mapping[str, Sequence[Entry]],
    nobody: str,
    more: Sequence[str],
) -> Iterator[str]:
    profiles = ", ".join(each.name for each in keystore.profiles)
    yield f"keystore         {keystore.root} (profile {profiles})"
    for term in standing.shared:
        state = "" if term.state is State.VALID else f", {term.state}"
        of_set = f" (set {term.set_name})" if term.set_name else ""
        yield f"{_ROLES[term.kind]:<15}  until {end(term.not_after)}{state}{of_set}"
    counts = [f"{count} {state}" for state, count in standing.counts().items() if count]
    yield f"participants     {', '.join(counts) or nobody}"
    yield from more
    if standing.participants:
        has_receipts = any(each.receipt for each in robots.values())
        has_earlier = any(each.name in earlier for each in standing.participants)
        yield ""
        yield from _printing.table(
            (
                *_HEADERS,
                *([_SUPERSEDED] if has_earlier else ()),
                *(_ROBOT_HEADERS if has_receipts else ()),
            ),
            (
                (
                    *(each.name, each.state, end(each.not_after)),
                    *(each.profile or "-", each.domains or "-", each.serial),
                    *([_earlier(earlier.get(each.name, ()))] if has_earlier else ()),
                    *(_robot(robots[each.name]) if has_receipts else ()),
                )
                for each in standing.participants
            ),
        )


def _value(
    state: ParticipantState, earlier: Sequence[Entry], robots: Mapping[str, RobotState]
) -> dict[str, object]:
    """The participant for --json."""
    return {
        **state.to_json(),
        _SUPERSEDED: [{"serial": each.serial, "not_after": each.ends} for each in earlier],
        **robots[state.name].to_json(),
    }


def _note(standing: Status) -> None:
    """Note which participants have no permissions, and what was signed later than now."""
    if unsigned := [each.name for each in standing.participants if not each.permissions]:
        _printing.note(
            f"no permissions were signed yet for {_printing.few(unsigned)}: `pqsec permit`"
        )
    for what, at in standing.future:
        _printing.note(f"{what} was signed {said(at)}: the clock is behind, or was ahead then")


def _earlier(entries: Sequence[Entry]) -> str:
    return f"{len(entries)}, until {end(max(each.ends for each in entries))}" if entries else "-"


def _of_list(delivery: ListDelivery | None) -> Iterator[str]:
    """Which robots lack the newest list, and what they accept; nothing if all have it."""
    if delivery and delivery.late:
        first, *more = delivery.lines
        yield f"list {delivery.number:<11} {first}"
        yield from (f"{'':<16} {each}" for each in more)


def _robot(robot: RobotState) -> tuple[str, ...]:
    numbers = (f"{each or '-'}" for each in (robot.runs, robot.should_run))
    return (robot.state, *numbers, ", ".join(robot.changed) or "-")
