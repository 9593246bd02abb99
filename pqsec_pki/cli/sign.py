"""pqsec sign-governance and sign-permissions: check a document, then sign it."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from pqsec_pki._files import exists, read, refuse_existing
from pqsec_pki._places import refuse_obeyed
from pqsec_pki.access import follows_locale
from pqsec_pki.cli import _help, _passphrases, _printing, _settings
from pqsec_pki.cli._printing import printable
from pqsec_pki.documents import (
    Governance,
    Kind,
    Permissions,
    governance_from_yaml,
    permissions_from_yaml,
)
from pqsec_pki.errors import FileError, InvalidDocumentError, located
from pqsec_pki.keystore import SigningCa
from pqsec_pki.lifecycle import sign_document
from pqsec_pki.policy import locale_doubt


def _options(command: _settings.Command) -> _settings.Command:
    for option in (
        click.option("--force", is_flag=True, help="Replace an existing signed file."),
        click.option(
            "--embed-certificate",
            is_flag=True,
            help="Include the signer's certificate, also if the profile does not.",
        ),
        click.option(
            "-o",
            "--output",
            type=_settings.FILE,
            help="Write to this file. [default: FILE with .p7s]",
        ),
        click.option(
            "--set",
            "profile",
            metavar="PROFILE",
            help="Sign a file outside of the keystore with the CA of this profile.",
        ),
        click.argument("file", type=_settings.FILE),
    ):
        command = option(command)
    return command


@_help.command(
    "sign-governance",
    examples={
        "Sign the governance that you edited": (
            "pqsec sign-governance robots/enclaves/governance.xml --force"
        ),
        "Sign a governance in YAML": "pqsec sign-governance governance.yaml -o signed.p7s",
    },
    exit_codes={
        0: "signed",
        1: "not signed: FILE is not valid",
        3: "not signed: FILE, the keystore or the passphrase is missing or wrong",
    },
)
@_options
@_passphrases.option
@_settings.command_options
def sign_governance(file: Path, **choices: Any) -> None:
    """Check a governance document against its schema, and sign it.

    The keystore's permissions CA signs the content of FILE (XML or YAML), written as XML in one
    form, without comments. If FILE is an XML file in the keystore, it gets that form too. Nothing
    is written if FILE is not valid.
    """
    _sign(Kind.GOVERNANCE, Governance.from_xml, file, **choices)


@_help.command(
    "sign-permissions",
    examples={
        "Sign permissions in YAML": "pqsec sign-permissions talker.yaml",
        "Replace a participant's permissions": (
            "pqsec sign-permissions talker.yaml -o robots/enclaves/talker/permissions.p7s --force"
        ),
    },
    exit_codes={
        0: "signed",
        1: "not signed: FILE is not valid",
        3: "not signed: FILE, the keystore or the passphrase is missing or wrong",
    },
)
@_options
@_passphrases.option
@_settings.command_options
def sign_permissions(file: Path, **choices: Any) -> None:
    """Check a permissions document against its schema, and sign it.

    The keystore's permissions CA signs the content of FILE (XML or YAML), written as XML in one
    form, without comments. If FILE is an XML file in the keystore, it gets that form too. Nothing
    is written if FILE is not valid.
    """
    _sign(Kind.PERMISSIONS, Permissions.from_xml, file, **choices)


def _sign(  # noqa: PLR0913 -- one for each option
    kind: Kind,
    check: Callable[[bytes], Governance | Permissions],
    file: Path,
    *,
    output: Path | None,
    passphrase_file: Path | None,
    embed_certificate: bool,
    force: bool,
    profile: str | None,
) -> None:
    refuse_obeyed([file], "what the CA signs")
    document = document_at(file, kind)
    with located(file):
        value = check(document)
        value.to_xml()  # what it refuses is refused with the file's name
    goal = output or file.with_suffix(".p7s")
    if not force:  # before the passphrase is asked for
        refuse_existing(goal)
    keystore = _settings.open_keystore(to_change=True)
    signed = sign_document(
        keystore,
        kind,
        document,
        goal,
        _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS),
        now=_settings.now(),
        embed_certificate=embed_certificate,
        force=force,
        profile=profile,
    )
    _note_other_xml(goal, document, check, value)
    for pattern in dict.fromkeys(filter(follows_locale, _patterns(value))):
        _printing.note(printable(locale_doubt(pattern)))
    _printing.emit({"signed": goal, "bytes": len(signed)}, [f"{goal}  ({len(signed)} bytes)"])


def document_at(file: Path, kind: Kind) -> bytes:
    """The document in the file as XML; errors name the file."""
    document = read(file)
    with located(file):
        return _rendered(kind, document) if file.suffix in {".yaml", ".yml"} else document


def _note_other_xml(
    goal: Path, document: bytes, check: Callable[[bytes], object], value: object
) -> None:
    """Note that the XML file next to `goal` has another meaning, or lost its comments."""
    beside = goal.with_suffix(".xml")
    if beside == goal or not exists(beside):
        return
    with suppress(FileError, InvalidDocumentError):  # the document is already signed
        found = read(beside)
        if check(found) == value:
            if b"<!--" in document and b"<!--" not in found:
                _printing.note(f"{beside} is now what was signed, so without its comments")
            return
    _printing.note(f"{beside} says something else than what was signed into {goal.name}")


def _patterns(value: Governance | Permissions) -> Iterator[str]:
    """The patterns of topics and partitions."""
    if isinstance(value, Governance):
        for domain_rule in value.domain_rules:
            yield from (each.topic_expression for each in domain_rule.topic_rules)
        return
    for grant in value.grants:
        for rule in grant.rules:
            for criteria in (*rule.publish, *rule.subscribe, *rule.relay):
                yield from (*criteria.topics, *criteria.partitions)


def _rendered(kind: Kind, document: bytes) -> bytes:
    if kind is Kind.GOVERNANCE:
        return governance_from_yaml(document).to_xml()
    return permissions_from_yaml(document, now=_settings.now()).to_xml()
