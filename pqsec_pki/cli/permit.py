"""pqsec permit: add or remove single rights of participants."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from pqsec_pki.access import (
    TopicRights,
    add_rights,
    allowed_domains,
    permissions_diff,
    remove_rights,
)
from pqsec_pki.cli import _completion, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli._names import admitted
from pqsec_pki.cli._participant_options import note_doubtful_topics, topic_options, topics_of
from pqsec_pki.cli.diff import difference_lines, note_incomplete
from pqsec_pki.documents import DomainSet, Grant
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore, SigningCa
from pqsec_pki.lifecycle import PermissionsChange, changed_permissions, sign_changed
from pqsec_pki.policy import DocumentDifference


@_help.command(
    examples={
        "Allow a ROS 2 node to publish one more topic": (
            "pqsec -k robots permit /talker --ros-publish /status --yes"
        ),
        "Remove a right from all nodes of a robot": (
            "pqsec permit '/fleet/*' --remove --publish rt/chatter --yes"
        ),
    },
    exit_codes={
        0: "the new permissions are signed, or there was nothing to change",
        1: "not changed: a signature is not valid",
        2: "wrong command line; or a rule denies what you add, or still allows what you remove",
        3: "not changed: a participant, the keystore or the passphrase is missing or wrong",
    },
)
@click.argument("names", nargs=-1, required=True, shell_complete=_completion.participants)
@click.option(
    "--add/--remove", default=True, help="Add these rights, or remove them.  [default: add]"
)
@click.option(
    "--domain",
    "domains",
    help="Add the rights on these DDS domains: 0, 0-3 or 0,5.  [default: those of its other"
    " rights]",
)
@topic_options
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_passphrases.option
@_settings.command_options
def permit(
    names: tuple[str, ...],
    domains: str | None,
    passphrase_file: Path | None,
    *,
    add: bool,
    yes: bool,
    **topics: Any,
) -> None:
    """Add or remove single rights of participants; their keys stay.

    NAME may be a pattern ('/robot1/*') or a group (@hall1). The change of rights is shown
    first. Either all participants are changed or none. Robots get the new permissions with
    their next bundle, or by a copy of the enclave.
    """
    publish, subscribe = topics_of(**topics)
    if not publish and not subscribe:
        raise UsageError("no right named", hint="name topics: --publish rt/chatter")
    if domains is not None and not add:
        raise UsageError("--remove and --domain exclude each other: a right is removed everywhere")
    keystore, now = _settings.open_keystore(to_change=True), _settings.now()
    rights = TopicRights(publish=publish, subscribe=subscribe)
    edit = _edit(keystore, rights, domains, add=add)
    found = changed_permissions(keystore, admitted(keystore, names), edit, now=now)
    changes = [each for each in found if each.new != each.old]
    differences = [
        DocumentDifference(f"permissions of {each.name}", permissions_diff(each.old, each.new))
        for each in changes
    ]
    complete = note_incomplete(differences)
    if changes:
        if not yes:
            _ask(changes, differences)
        authorities = _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS)
        sign_changed(keystore, authorities, changes, now=now)
        note_doubtful_topics(keystore, [each.name for each in changes])
    _report(keystore, changes, differences, complete=complete, shown=not yes)


def _edit(
    keystore: Keystore, rights: TopicRights, domains: str | None, *, add: bool
) -> Callable[[Grant], Grant]:
    """The change of a grant. UsageError for what is not a set of domains."""
    wanted = None if domains is None else DomainSet.parse(domains)

    def edited(grant: Grant) -> Grant:
        if not add:
            return remove_rights(grant, rights)
        return add_rights(grant, rights, wanted or allowed_domains(grant) or keystore.domains)

    return edited


def _ask(changes: list[PermissionsChange], differences: list[DocumentDifference]) -> None:
    confirm(
        lambda: _printing.emit(None, difference_lines(differences)),
        "Sign these permissions?",
        what=f"the rights of {_printing.few([each.name for each in changes])} would change",
        hint="--yes makes the change; `pqsec diff` and `pqsec explain` show rights",
    )


def _report(
    keystore: Keystore,
    changes: list[PermissionsChange],
    differences: list[DocumentDifference],
    *,
    complete: bool,
    shown: bool,
) -> None:
    if any(each.config_digest for each in changes):
        _printing.note(
            "these participants are in a domain file: change it there too, or the next `pqsec"
            " apply` restores their rights"
        )
    value = {
        "keystore": str(keystore.root),
        "complete": complete,
        "changed": [each.name for each in changes],
        "changes": [change for each in differences for change in each.to_json()],
    }
    lines = [] if shown else list(difference_lines(differences))
    lines += [f"signed: {each.name}" for each in changes]
    _printing.emit(value, lines if changes else ["nothing to change"])
