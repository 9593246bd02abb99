"""pqsec sign-request: requests to CAs on an offline machine, and their answers."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki._files import is_there
from pqsec_pki.cli import _bundles, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._sign_request_export import export, force_option
from pqsec_pki.domain import OrderedIssue, ordered_issue, perform_order
from pqsec_pki.enrolment import MAX_ARCHIVE, SignRequest, accept, pins_of, same_answers, sign
from pqsec_pki.errors import UsageError, VerificationError, located
from pqsec_pki.keystore import Keystore


@_help.group("sign-request")
@_settings.command_options
def sign_request() -> None:
    """Sign requests with CAs on an offline machine."""


sign_request.add_command(export)


@sign_request.command(
    "sign",
    examples={
        "Show what is requested": "pqsec sign-request sign fleet.request --show",
        "Sign it, if all names are of the fleet": (
            "pqsec sign-request sign fleet.request -o fleet.answer --allow-name '/fleet/*'"
        ),
        "Perform what a registration authority ordered, in a script": (
            "pqsec sign-request sign order -o answer --ra-only"
        ),
    },
    exit_codes={
        0: "the answer is written; with --show, the request is shown",
        1: "nothing is issued: FILE, a name or a key is not allowed",
        3: "FILE, the keystore or the passphrase is missing or wrong",
    },
)
@click.argument("file", type=_settings.FILE)
@click.option("-o", "--output", type=_settings.FILE, help="Write the answer to this file.")
@click.option("--sha256", metavar="HASH", help="Refuse FILE if its SHA-256 is different.")
@click.option(
    "--allow-name",
    "patterns",
    multiple=True,
    metavar="PATTERN",
    help="Refuse names that do not match, for example '/fleet/*'; repeatable.",
)
@click.option(
    "--ra-only",
    is_flag=True,
    help="Refuse FILE unless a registration authority ordered it: for use without a human.",
)
@click.option(
    "--anchor",
    type=_settings.FOLDER,
    metavar="DIR",
    help="For an order: refuse it if the ledger lacks lines of the heads in DIR, from `pqsec log"
    " --anchor`.",
)
@click.option("--show", is_flag=True, help="Show what is requested, and sign nothing.")
@force_option
@click.option("--after-revocation", is_flag=True, help="Also issue participants that were revoked.")
@_bundles.compromised_option
@_passphrases.option
@_settings.command_options
def sign_(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    file: Path,
    output: Path | None,
    sha256: str | None,
    patterns: tuple[str, ...],
    anchor: Path | None,
    passphrase_file: Path | None,
    *,
    ra_only: bool,
    show: bool,
    force: bool,
    after_revocation: bool,
    compromised_keys: bool,
) -> None:
    """Issue what a request file asks for, and write the answer.

    FILE is from `pqsec sign-request export`. Run this on the machine with the CA keys. What
    was already issued for the same file is not issued again: you can repeat it. If a
    registration authority ordered it, its grant decides, and the ledger records the order.
    """
    keystore = _settings.open_keystore(to_change=not show)
    asked = _read(file)
    allowed = {
        "force": force,
        "after_revocation": after_revocation,
        "compromised_keys": compromised_keys,
    }
    with located(file):
        _refuse_other(asked, sha256, ra_only=ra_only, allowed=any(allowed.values()))
        asked.admitted(keystore.profiles, patterns)
        by = _order_of(asked, keystore, anchor)
    if show:
        _show(asked, by)
        return
    if output is None:
        raise UsageError("no output file named", hint="use -o FILE, or --show to sign nothing")
    if not force and not (by and by.done):
        with _printing.with_hint("choose another place with -o"):
            _files.refuse_existing(output)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    if by:
        answer = perform_order(asked, keystore, authorities, now=_settings.now(), anchors=anchor)
    else:
        now = _settings.now()
        answer = sign(asked, keystore, authorities, now=now, patterns=patterns, **allowed)
    with _printing.with_hint("the certificates are issued: run it again with another -o"):
        if not (by and _is_answered(output, answer)):
            _files.write(output, answer, force=force)
    names = [spec.name for spec in asked.specs]
    value = {"answer": output, "names": names, "request_sha256": asked.sha256}
    _printing.emit(value, [*names, f"{output}  answers SHA-256 {asked.sha256}"])


@sign_request.command(
    "import",
    examples={
        "Write a bundle for each robot": (
            "pqsec sign-request import fleet.answer --request fleet.request --bundles bundles"
        ),
    },
    exit_codes={
        0: "all bundles are written",
        1: "no bundle is written: the answer is not valid",
        3: "a file cannot be read or written",
    },
)
@click.argument("answer", type=_settings.FILE)
@click.option(
    "--request",
    "file",
    type=_settings.FILE,
    required=True,
    help="Check that it answers this exported file.",
)
@click.option(
    "--ca-fingerprint",
    "fingerprints",
    multiple=True,
    metavar="ROLE:SHA256",
    help="Check that the bundles are from these CAs; one option for each.",
)
@_bundles.folder_option
@force_option
@_settings.command_options
def import_(
    answer: Path,
    file: Path,
    fingerprints: tuple[str, ...],
    folder: Path | None,
    *,
    force: bool,
) -> None:
    """Check an answer, and write one bundle for each robot.

    You can repeat it: existing bundles do not change.
    """
    asked = _read(file)
    data = _files.read(answer, limit=MAX_ARCHIVE)
    with located(answer):
        found = accept(
            data,
            asked,
            folder or Path(),
            pins=pins_of(fingerprints),
            now=_settings.now(),
            force=force,
        )
    value = {
        "bundles": [
            {"name": each.name, "path": str(each.path), "already": each.already} for each in found
        ]
    }
    words = {True: "  (already there)", False: ""}
    _printing.emit(value, [f"{each.name}  {each.path}{words[each.already]}" for each in found])


def _read(path: Path) -> SignRequest:
    data = _files.read(path, limit=MAX_ARCHIVE)
    with located(path):
        return SignRequest.from_bytes(data)


def _refuse_other(asked: SignRequest, sha256: str | None, *, ra_only: bool, allowed: bool) -> None:
    """VerificationError if it is not the file that is expected, or not an order.

    UsageError for an order, if options allow what no order has.
    """
    if asked.order and allowed:
        raise UsageError(
            "an order enrols new participants with new keys, and nothing else",
            hint="--force, --after-revocation and --reuse-compromised-key are for other requests",
        )
    if sha256 and sha256.lower() != asked.sha256:
        raise VerificationError(f"its SHA-256 is {asked.sha256}")
    if ra_only and not asked.order:
        raise VerificationError("no registration authority ordered this")


def _order_of(asked: SignRequest, keystore: Keystore, anchors: Path | None) -> OrderedIssue | None:
    if not asked.order:
        return None
    return ordered_issue(asked, keystore, now=_settings.now(), anchors=anchors)


def _is_answered(output: Path, answer: bytes) -> bool:
    """Whether an earlier answer with the same files is there."""
    return is_there(output) and same_answers(_files.read(output, limit=MAX_ARCHIVE), answer)


def _show(asked: SignRequest, by: OrderedIssue | None) -> None:
    if asked.order and by:
        rows = [(each.name, each.role, _length(each.validity)) for each in asked.order.items]
        value = {
            "sha256": asked.sha256,
            "ordered_by": by.authority,
            "done": by.done,
            "participants": [each.to_json() for each in asked.order.items],
        }
        done = ", and performed" if by.done else ""
        lines = [
            *_printing.table(("participant", "role", "for"), rows),
            f"ordered by {by.authority}{done}; grant {asked.order.grant}",
            f"SHA-256 {asked.sha256}",
        ]
        _printing.emit(value, lines)
        return
    _show_specs(asked)


def _show_specs(asked: SignRequest) -> None:
    rows = [
        (
            spec.name,
            str(spec.domains),
            _topics(spec.publish),
            _topics(spec.subscribe),
            "policy" if spec.grants else "-",
            _length(spec.validity),
        )
        for spec in asked.specs
    ]
    headers = ("participant", "domains", "publish", "subscribe", "by", "for")
    documents = [spec.policy.decode() for spec in asked.specs if spec.policy]
    policies = [line for each in documents for line in each.splitlines()]
    lines = [*_printing.table(headers, rows), *policies, f"SHA-256 {asked.sha256}"]
    _printing.emit(asked.to_json(), lines)


def _length(validity: timedelta) -> str:
    hours = validity // timedelta(hours=1)
    return f"{hours}h" if hours % 24 else f"{hours // 24}d"


def _topics(expressions: tuple[str, ...]) -> str:
    """The topics in full: the operator decides by them."""
    return " ".join(expressions) or "-"
