"""pqsec permit: add or remove single rights of participants."""

from collections.abc import Callable, Iterable
from datetime import timedelta
from pathlib import Path
from shlex import quote
from typing import Any

import click

from pqsec_pki.access import (
    TopicRights,
    add_grant,
    add_rights,
    allowed_domains,
    permissions_diff,
    remove_rights,
)
from pqsec_pki.cli import _completion, _help, _passphrases, _policy, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli._names import admitted
from pqsec_pki.cli._participant_options import (
    note_doubtful_topics,
    note_ros_names,
    topic_options,
    topics_of,
)
from pqsec_pki.cli._removal import Removal, note_not_granted
from pqsec_pki.cli.diff import difference_lines, note_incomplete
from pqsec_pki.documents import DomainSet, Grant
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Keystore, SigningCa, list_delivery
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    PermissionsChange,
    changed_permissions,
    earlier_ends,
    sign_changed,
)
from pqsec_pki.policy import DocumentDifference

_EVERYBODY = ("/**",)


@_help.command(
    examples={
        "Allow a ROS 2 node to publish one more topic": (
            "pqsec -k robots permit /talker --ros-publish /status --yes"
        ),
        "Remove a right from all nodes of a robot": (
            "pqsec permit '/fleet/*' --remove --publish rt/chatter --yes"
        ),
        "Allow what was seen in a recording, each participant what it used": (
            "pqsec permit --policy learned.yaml --yes"
        ),
    },
    exit_codes={
        0: "the new permissions are signed, or there was nothing to change",
        1: "not changed: a signature is not valid",
        2: "wrong command line; or a rule denies what you add, or still allows what you remove",
        3: "not changed: a participant, the keystore or the passphrase is missing or wrong",
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
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
@click.option(
    "--policy",
    type=_settings.FILE,
    help="Add the rights of each NAME in permissions in YAML or an SROS2 policy.",
)
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_passphrases.option
@_settings.command_options
def permit(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    domains: str | None,
    policy: Path | None,
    passphrase_file: Path | None,
    *,
    add: bool,
    yes: bool,
    **topics: Any,
) -> None:
    """Add or remove single rights of participants; their keys stay.

    NAME may be a pattern ('/robot1/*') or a group (@hall1). With --policy, such as a proposal of
    `pqsec permissions learn`, each participant gets what the file grants to its name. Without a
    NAME, these are all participants of the file that the keystore has. The permissions keep their
    validity.

    The change of rights is shown first. Either all participants are changed or none. Robots get
    the new permissions with their next bundle, or by a copy of the enclave. What was signed before
    stays valid if somebody puts it back: --remove says until when, and how to end it now.
    """
    if add:
        note_ros_names(topics["publish"], topics["subscribe"])
    publish, subscribe = topics_of(**topics)
    rights = TopicRights(publish=publish, subscribe=subscribe)
    _refuse_mixed(names, rights, domains, policy, add=add)
    keystore, now = _settings.open_keystore(to_change=True), _settings.now()
    if policy:
        grants = policy_grants(keystore, policy, domains)
        chosen, edit = _in_policy(keystore, names, policy, grants), _granting(grants)
    else:
        chosen, edit = admitted(keystore, names), _edit(keystore, rights, domains, add=add)
    found = changed_permissions(keystore, chosen, edit, now=now)
    changes = [each for each in found if each.new != each.old]
    differences = [
        DocumentDifference(f"permissions of {each.name}", permissions_diff(each.old, each.new))
        for each in changes
    ]
    complete = note_incomplete(differences)
    if policy:
        _note_validity(policy, grants, found)
    if not add:
        note_not_granted(topics, [one for each in found if each.old for one in each.old.grants])
    removal = None if add else Removal(keystore.root, {}, None)
    if changes:
        if not yes:
            _ask(changes, differences)
        authorities = _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS)
        with keystore.hold():  # so that the ledger, as it is then, is not read again
            sign_changed(keystore, authorities, changes, now=now)
            if removal:
                earlier = earlier_ends(keystore, changes, now=now)
                removal = Removal(keystore.root, earlier, list_delivery(keystore, now=now))
        note_doubtful_topics(keystore, [each.name for each in changes])
    _report(keystore, changes, differences, removal, complete=complete, shown=not yes)


def _refuse_mixed(
    names: tuple[str, ...],
    rights: TopicRights,
    domains: str | None,
    policy: Path | None,
    *,
    add: bool,
) -> None:
    """UsageError for options that have no meaning together, or none at all."""
    if domains is not None and not add:
        raise UsageError("--remove and --domain exclude each other: a right is removed everywhere")
    if policy:
        if any(rights):
            raise UsageError("--policy and topics exclude each other")
        if not add:
            raise UsageError("--policy adds rights: it excludes --remove")
        if domains is not None and policy.suffix != ".xml":
            raise UsageError(f"{policy} has the domains of its rights: it excludes --domain")
    elif not any(rights):
        raise UsageError("no right named", hint="name topics: --publish rt/chatter")
    elif not names:
        raise UsageError("no participant named", hint="give names, or --policy FILE")


def policy_grants(keystore: Keystore, policy: Path, domains: str | None) -> tuple[Grant, ...]:
    """What the policy grants; that of SROS2 on these domains, or those of the keystore."""
    where = keystore.domains if domains is None else DomainSet.parse(domains)
    day = timedelta(days=1)  # grants keep their validity
    spec = ParticipantSpec(name="/any", domains=where, validity=day)
    return _policy.grants_in(policy, spec, _settings.now())


def _in_policy(
    keystore: Keystore, names: tuple[str, ...], policy: Path, grants: Iterable[Grant]
) -> list[str]:
    """The participants of the keystore among the names that the policy has grants for."""
    granted, there = dict.fromkeys(each.name for each in grants), set(keystore.names())
    both = [name for name in granted if name in there]
    if not both:
        raise KeystoreError(
            f"no participant in {policy} is in the keystore",
            hint=f"`pqsec issue --policy {quote(str(policy))}` issues them",
        )
    found = admitted(keystore, names or _EVERYBODY, both)
    if lacking := [name for name in found if name not in granted]:
        raise UsageError(
            f"{policy} has no grant for {_printing.few(lacking)}",
            hint=f"it has {_printing.few(list(granted))}",
        )
    absent = [name for name in granted if name not in there and name != _policy.UNNAMED]
    if absent and not names:
        _printing.note(f"not in the keystore: {_printing.few(absent)}: `pqsec issue --policy`")
    return found


def _granting(grants: Iterable[Grant]) -> Callable[[str, Grant], Grant]:
    """The change of a grant that adds those for the name."""
    every = tuple(grants)

    def edited(name: str, grant: Grant) -> Grant:
        for more in every:
            if more.name == name:
                grant = add_grant(grant, more)
        return grant

    return edited


def _edit(
    keystore: Keystore, rights: TopicRights, domains: str | None, *, add: bool
) -> Callable[[str, Grant], Grant]:
    """The change of a grant. UsageError for what is not a set of domains."""
    wanted = None if domains is None else DomainSet.parse(domains)

    def edited(_: str, grant: Grant) -> Grant:
        if not add:
            return remove_rights(grant, rights)
        return add_rights(grant, rights, wanted or allowed_domains(grant) or keystore.domains)

    return edited


def _note_validity(
    policy: Path, grants: Iterable[Grant], found: Iterable[PermissionsChange]
) -> None:
    """Note that rights end later than the policy says: it changes no validity."""
    if policy.suffix == ".xml":
        return  # SROS2 policies have none
    ends = {each.name: each.not_after for each in grants}
    later = [
        each.name
        for each in found
        if any(grant.not_after > ends.get(each.name, grant.not_after) for grant in each.new.grants)
    ]
    if later:
        _printing.note(
            f"{policy} has a shorter validity than the permissions of {_printing.few(later)}, which"
            " stays: `pqsec renew --validity` changes it"
        )


def _ask(changes: list[PermissionsChange], differences: list[DocumentDifference]) -> None:
    confirm(
        lambda: _printing.emit(None, difference_lines(differences)),
        "Sign these permissions?",
        what=f"the rights of {_printing.few([each.name for each in changes])} would change",
        hint="--yes makes the change; `pqsec diff` and `pqsec explain` show rights",
    )


def _report(  # noqa: PLR0913 -- what there is to tell
    keystore: Keystore,
    changes: list[PermissionsChange],
    differences: list[DocumentDifference],
    removal: Removal | None,
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
        **(removal.to_json() if removal else {}),
    }
    lines = [] if shown else list(difference_lines(differences))
    lines += [f"signed: {each.name}" for each in changes] or ["nothing to change"]
    _printing.emit(value, [*lines, *(removal.lines if removal else ())])
