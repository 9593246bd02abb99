"""pqsec sign-request: requests to CAs on an offline machine, and their answers."""

import hashlib
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from pqsec_pki import _files
from pqsec_pki.cli import _bundles, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._participant_options import ParticipantOptions, participant_options
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    MAX_ARCHIVE,
    NAMELESS,
    SignRequest,
    accept,
    name_asked_for,
    pins_of,
    sign,
)
from pqsec_pki.errors import UsageError, VerificationError, located

_force = click.option("--force", is_flag=True, help="Replace existing files or participants.")


@_help.group("sign-request")
@_settings.command_options
def sign_request() -> None:
    """Sign requests with CAs on an offline machine."""


@sign_request.command(
    examples={
        "Collect the requests of two robots": (
            "pqsec sign-request export robot2.csr robot3.csr --publish rt/chatter -o fleet.request"
        ),
    },
    exit_codes={
        0: "the file is written",
        1: "a request or the policy is not valid",
        3: "a file cannot be read or written",
    },
)
@click.argument("requests", nargs=-1, required=True, type=_settings.FILE, metavar="CSR...")
@click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="Allow these DDS domains: 0, or 0-3, or 0,5.",
)
@participant_options
@click.option("-o", "--output", type=_settings.FILE, required=True, help="Write to this file.")
@_force
@_settings.command_options
def export(
    requests: tuple[Path, ...], domains: str, output: Path, *, force: bool, **wanted: Any
) -> None:
    """Write requests of robots, and the rights they need, into one file.

    A keystore is not needed. Compare the SHA-256 that is printed with the one that
    `pqsec sign-request sign` prints.
    """
    found = _bundles.load_requests(requests)
    names = []
    for path, request in found:
        with located(path):
            request.verify()
            name = name_asked_for(request)
            if name is None:
                raise VerificationError(NAMELESS)
            names.append(name)
    if len(set(names)) < len(names):
        raise UsageError("two requests have the same name")
    specs = ParticipantOptions.of(**wanted).specs(tuple(names), DomainSet.parse(domains))
    data = SignRequest(tuple(each for _, each in found), tuple(specs)).to_bytes(now=_settings.now())
    _files.write(output, data, force=force)
    sha256 = hashlib.sha256(data).hexdigest()
    value = {"written": output, "names": names, "sha256": sha256}
    _printing.emit(value, [*names, f"{output}  SHA-256 {sha256}"])


@sign_request.command(
    "sign",
    examples={
        "Show what is requested": "pqsec sign-request sign fleet.request --show",
        "Sign it, if all names are of the fleet": (
            "pqsec sign-request sign fleet.request -o fleet.answer --allow-name '/fleet/*'"
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
@click.option("--show", is_flag=True, help="Show what is requested, and sign nothing.")
@_force
@click.option("--after-revocation", is_flag=True, help="Also issue participants that were revoked.")
@_bundles.compromised_option
@_passphrases.option
@_settings.command_options
def sign_(  # noqa: PLR0913 -- one for each option, by name
    file: Path,
    output: Path | None,
    sha256: str | None,
    patterns: tuple[str, ...],
    passphrase_file: Path | None,
    *,
    show: bool,
    force: bool,
    after_revocation: bool,
    compromised_keys: bool,
) -> None:
    """Issue what a request file asks for, and write the answer.

    FILE is from `pqsec sign-request export`. Run this on the machine with the CA keys. What
    was already issued for the same file is not issued again: you can repeat it.
    """
    keystore = _settings.open_keystore(to_change=not show)
    asked = _read(file)
    with located(file):
        if sha256 and sha256.lower() != asked.sha256:
            raise VerificationError(f"its SHA-256 is {asked.sha256}")
        asked.admitted(keystore.profile, patterns)
    if show:
        _show(asked)
        return
    if output is None:
        raise UsageError("no output file named", hint="use -o FILE, or --show to sign nothing")
    if not force:
        _files.refuse_existing(output)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    answer = sign(
        asked,
        keystore,
        authorities,
        now=_settings.now(),
        patterns=patterns,
        force=force,
        after_revocation=after_revocation,
        compromised_keys=compromised_keys,
    )
    with _printing.with_hint("the certificates are issued: run it again with another -o"):
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
@_force
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


def _show(asked: SignRequest) -> None:
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
