"""pqsec requests: decide about robots that asked the server without a token."""

from collections.abc import Collection, Sequence
from pathlib import Path
from shlex import quote

import click

from pqsec_pki._times import said
from pqsec_pki.cli import _formats, _help, _printing, _settings
from pqsec_pki.cli.serve import config_option, trusted_settings
from pqsec_pki.keystore import Entry, Keystore
from pqsec_pki.server import (
    APPROVAL,
    REFUSAL,
    WaitingRequest,
    decide,
    demanded,
    end_of,
    open_approvals,
    read_settings,
    replacing,
)

_COLUMNS = ("name", "sha256", "address", "received", "asked", "replaces")
_ids = click.argument("ids", nargs=-1, required=True, metavar="SHA256...")


@_help.group()
@_settings.command_options
def requests() -> None:
    """Decide about robots that asked the server without a token."""


@requests.command(
    "list",
    examples={"List what waits": "pqsec requests list"},
    exit_codes={
        0: "the requests are listed",
        1: "the configuration is not valid",
        3: "the server's folder or the keystore cannot be read",
    },
)
@config_option
@_formats.option()
@_settings.command_options
def list_(file: Path, form: str) -> None:
    """List the requests that wait, oldest first, and those that were approved.

    A request ends 30 days after its robot last sent it. An approval ends after 30 days if the robot
    did not fetch its certificate.

    Compare the SHA-256 with what the robot shows (`pqsec enrol`, or `pqsec inspect request.csr`):
    any client can send a request for any name. REPLACES is `its key` if the participant has a
    certificate for another key, which an approval replaces.
    """
    _formats.chosen(form)
    settings = read_settings(file)
    keystore, now = Keystore.open(settings.keystore), _settings.now()
    found = settings.waiting(keystore).all()
    with keystore.open_ledger() as ledger:
        approved = open_approvals(ledger, now)
    lines, values = _listed(found, replacing(keystore, found, now=now))
    if approved:
        rows = [(*_sent(each), said(each.made_at), said(end_of(each))) for each in approved]
        lines += ["", *_printing.table(("NAME", "SHA-256", "FROM", "APPROVED", "UNTIL"), rows)]
    value = {"requests": values, "approved": [_approval(each) for each in approved]}
    _formats.emit(form, value, lines, columns=_COLUMNS, items=values)


@requests.command(
    "approve",
    examples={
        "Approve a request, by its SHA-256": "pqsec requests approve 0123456789abcdef",
    },
    exit_codes={
        0: "approved: the robot gets its certificate when it asks again",
        1: "the configuration is not valid",
        3: "the keystore cannot be changed",
    },
)
@_ids
@config_option
@_settings.command_options
def approve(ids: tuple[str, ...], file: Path) -> None:
    """Approve requests. If the robot has a certificate for another key, it is replaced.

    Other requests for the same name are dropped; they wait again if their robots ask again.
    SHA256 are 16 or more digits of the request's SHA-256. The ledger gets the decision, with who
    made it. Where rights that grow need approvals, the requests are put where the domain file names
    them, for `pqsec plan`, and the robots get what the approved plan issues.
    """
    _decide(ids, file, APPROVAL)


@requests.command(
    "refuse",
    examples={
        "Refuse a request": "pqsec requests refuse 0123456789abcdef",
    },
    exit_codes={
        0: "refused: the server never answers this request; a new one may follow",
        1: "the configuration is not valid",
        3: "the keystore cannot be changed",
    },
)
@_ids
@config_option
@_settings.command_options
def refuse(ids: tuple[str, ...], file: Path) -> None:
    """Refuse requests, which are removed; the ledger gets the decision.

    On the robot, `pqsec enrol --force` sends a new request, and so does the next `pqsec renew
    --from`. To end renewals, revoke the participant.
    """
    _decide(ids, file, REFUSAL)


def _decide(ids: tuple[str, ...], file: Path, kind: str) -> None:
    settings = trusted_settings(file)
    keystore = Keystore.open(settings.keystore, to_change=True)
    now = _settings.now()
    done = decide(keystore, settings, ids, kind, now=now)
    word = "approved" if kind == APPROVAL else "refused"
    lines, values = _listed(done, replacing(keystore, done, now=now), word)
    _printing.emit({"requests": values}, lines)
    if kind == APPROVAL and (words := demanded(keystore.approvals)):
        _printing.note(
            f"{words}: now `pqsec plan {quote(str(settings.domain))} -o plan.json --key KEY`"
            " (--new-keys, if a robot has a certificate for another key)"
        )


def _listed(
    found: Sequence[WaitingRequest], replaced: Collection[str], word: str = ""
) -> tuple[list[str], list[dict[str, object]]]:
    """A table of the requests, and their values for programs."""
    rows, values = [], []
    for each in found:
        replaces = each.sha256 in replaced
        key = "its key" if replaces else ""
        row = (each.name, each.sha256, each.address, said(each.received), key)
        rows.append((*row, word) if word else row)
        values.append({**each.to_json(), "replaces": replaces})
    heads = ("NAME", "SHA-256", "FROM", "RECEIVED", "REPLACES", *(("STATE",) if word else ()))
    return list(_printing.table(heads, rows)) if rows else ["no request waits"], values


def _sent(approval: Entry) -> tuple[str, str, str]:
    return approval.name, approval.sha256, approval.details.get("address", "")


def _approval(approval: Entry) -> dict[str, object]:
    values: tuple[object, ...] = (*_sent(approval), approval.made_at, end_of(approval))
    return dict(zip(("name", "sha256", "address", "approved", "until"), values, strict=True))
