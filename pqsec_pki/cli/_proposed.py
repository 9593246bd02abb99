"""A command that is proposed: its words read again, what it would change, and its run."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import click

from pqsec_pki import _files
from pqsec_pki._times import days, said
from pqsec_pki.access import permissions_diff
from pqsec_pki.approvals import ChangedRights
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.cli import _settings
from pqsec_pki.cli._bundles import load_requests
from pqsec_pki.cli._policy import grants_in
from pqsec_pki.cli._settings import APPROVED
from pqsec_pki.cli.ra import roles_in
from pqsec_pki.cli.sign import document_at
from pqsec_pki.documents import DomainSet, Governance, Grant, Kind, Permissions, lasting
from pqsec_pki.domain import KINDS, CommandReview, Desired, read_domain, rights_words
from pqsec_pki.enrolment import MAX_ARCHIVE, SignRequest, name_asked_for
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.keystore import GROUP, Keystore, key_hashes
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    addable,
    changed_protection,
    removable_set,
    revocable,
)

_ANY = "/NAME"
_AT_APPLY = ("passphrase_file", "no_passphrase")
"""Options that are given to `pqsec apply`."""


def review_of(words: Sequence[str], keystore: Keystore) -> CommandReview:
    """What these words mean in the keystore now; UsageError for what cannot be proposed."""
    context = _parsed(words)
    for option in _AT_APPLY:
        if _is_given(context, option):
            raise UsageError(
                f"--{option.replace('_', '-')} is not proposed: `pqsec apply` takes it"
            )
    params, name = context.params, str(context.info_name)
    if name == "ca rotate" and not params["do"]:
        raise UsageError("only the plan would be shown", hint="propose it with --apply")
    rights = tuple(_rights(name, params, keystore))
    return CommandReview(tuple(words), tuple(_files_of(context)), KINDS[name], rights)


def run(words: Sequence[str], passphrase_file: Path | None, *, no_passphrase: bool) -> int:
    """Run the words as approved, below the current command; returns their exit code."""
    context = _parsed([*words, *_more(_parsed(words), passphrase_file, none=no_passphrase)])
    context.meta[APPROVED] = True
    try:
        with context:
            context.command.invoke(context)
    except click.exceptions.Exit as end:
        return end.exit_code
    finally:
        context.meta[APPROVED] = False
    return 0


def _more(context: click.Context, passphrase_file: Path | None, *, none: bool) -> Iterator[str]:
    """Options that the command also needs when `pqsec apply` runs it."""
    if "yes" in context.params:
        yield "--yes"
    if passphrase_file and "passphrase_file" in context.params:
        yield f"--passphrase-file={passphrase_file}"
    if none and "no_passphrase" in context.params:
        yield "--no-passphrase"


def _parsed(words: Sequence[str]) -> click.Context:
    """The command's context, below the current one: so it has its keystore, and --json."""
    from pqsec_pki.cli import pqsec  # noqa: PLC0415 -- it imports the commands

    above = click.get_current_context()
    before = _settings.keystore_path()
    group: click.Group = pqsec
    context, rest = above, [*words]
    names: list[str] = []
    while True:
        _, command, rest = group.resolve_command(context, rest)
        if command is None or (not rest and isinstance(command, click.Group)):
            raise UsageError("no command is named")
        names.append(str(command.name))
        if not isinstance(command, click.Group):
            break
        group = command
    if " ".join(names) not in KINDS:
        raise UsageError(
            f"`pqsec {' '.join(names)}` cannot be proposed",
            hint=f"these can: {', '.join(KINDS)}",
        )
    context = command.make_context(" ".join(names), rest, parent=above)
    if _settings.keystore_path() != before:
        raise UsageError("a proposed command is for the keystore of this command: leave -k out")
    return context


def _is_given(context: click.Context, option: str) -> bool:
    return context.get_parameter_source(option) is click.core.ParameterSource.COMMANDLINE


def _files_of(context: click.Context) -> Iterator[Path]:
    """Each file that the words name, or that the command takes by default, if it is there."""
    found = dict.fromkeys(
        path
        for parameter in context.command.params
        if isinstance(parameter.type, click.Path) and parameter.name not in _AT_APPLY
        for path in _paths(context.params.get(str(parameter.name)))
    )
    yield from (path for path in found if path.is_file())


def _paths(value: object) -> Iterable[Path]:
    if isinstance(value, Path):
        return [value]
    return [each for each in value if isinstance(each, Path)] if isinstance(value, tuple) else []


def _rights(name: str, params: Mapping[str, Any], keystore: Keystore) -> Iterator[ChangedRights]:
    """What people should see in addition to the command: revoked participants, certified keys."""
    now = _settings.now()
    yield from _members([*params.get("names", ()), *params.get("subjects", ())], keystore)
    match name:
        case "revoke":
            from pqsec_pki.cli.revoke import certificates_in  # noqa: PLC0415 -- only here

            chosen = keystore.named(params["subjects"])
            if not chosen and not params["files"]:
                raise UsageError("nothing to revoke")
            files, only = certificates_in(params["files"]), params["superseded"]
            for each in revocable(keystore, chosen, files, superseded=only, now=now):
                until = said(each.ends)
                yield _change(each.name, f"revoked: serial number {each.serial}, until {until}")
        case "ca rotate" | "ca add-set" | "ca remove-set":
            yield from _of_cas(name, params, keystore)
        case "issue":
            yield from _certified(each for _, each in load_requests(params["requests"]))
            domains = params["domains"]
            on = keystore.domains if domains is None else DomainSet.parse(domains)
            yield from _of_policy(params["policy"], on, params["validity"])
        case "permit" if params["policy"]:
            from pqsec_pki.cli.permit import policy_grants  # noqa: PLC0415 -- only here

            yield from _granted(policy_grants(keystore, params["policy"], params["domains"]))
        case "sign-request sign":
            asked = SignRequest.from_bytes(_files.read(params["file"], limit=MAX_ARCHIVE))
            yield from _certified(asked.requests)
            yield from _requested_rights(asked, now)
        case _:
            yield from _of_file(name, params, keystore)


def _added(profile: str, keystore: Keystore, now: datetime) -> Iterator[ChangedRights]:
    """Who gets a certificate of the new set, and who does not."""
    found = addable(keystore, now=now)
    yield ChangedRights((), (f"new CAs of a set of profile {profile}",))
    if found.issued:
        yield ChangedRights(found.issued, (f"a certificate of set {profile}, valid as the first",))
    for name, why in found.left.items():
        yield _change(name, f"no certificate of set {profile}: {why}")


def _of_file(name: str, params: Mapping[str, Any], keystore: Keystore) -> Iterator[ChangedRights]:
    """What is in the document that is signed, or in the roles of the domain file."""
    match name:
        case "sign-permissions":
            found = document_at(params["file"], Kind.PERMISSIONS)
            yield from _granted(Permissions.from_xml(found).grants)
        case "sign-governance":
            wanted = Governance.from_xml(document_at(params["file"], Kind.GOVERNANCE))
            yield ChangedRights((), tuple(rights_words(changed_protection(keystore, wanted))))
        case "ra add":
            yield from _of_roles(read_domain(params["file"]), params["roles"])


def _of_roles(desired: Desired, labels: tuple[str, ...]) -> Iterator[ChangedRights]:
    """What a registration authority may give, to a participant with a name of its grant."""
    for label in roles_in(desired, labels):
        role = desired.roles[label]
        for each in _granted([role.grant(_ANY, role.domains or desired.domains, {})]):
            yield replace(each, names=(shown(f"role {label}"),))


def _of_cas(name: str, params: Mapping[str, Any], keystore: Keystore) -> Iterator[ChangedRights]:
    """What becomes of the CAs, or of a set of credentials."""
    if name == "ca rotate":
        from pqsec_pki.cli.rotate import steps_of  # noqa: PLC0415 -- only here

        root = f"{keystore.root}/"
        steps = (step.replace(root, "") for step in steps_of(keystore, params))
        yield ChangedRights((), tuple(steps))
    elif name == "ca add-set":
        yield from _added(params["profile_name"], keystore, _settings.now())
    else:
        gone = removable_set(keystore, params["profile"], now=_settings.now())
        words = f"remove the set of credentials of profile {gone.profile}"
        yield ChangedRights(gone.participants, (words,))


def _members(names: Iterable[str], keystore: Keystore) -> Iterator[ChangedRights]:
    """The members of each group: groups change without a line in the ledger."""
    for name in names:
        if name.startswith(GROUP):
            yield ChangedRights(tuple(keystore.named([name])), (f"members of {shown(name)}",))


def _of_policy(
    path: Path | None, domains: DomainSet, validity: timedelta
) -> Iterator[ChangedRights]:
    """What a policy gives to each name in it: it may include other files."""
    if path is None:
        return
    spec = ParticipantSpec(name="/any", domains=domains, validity=validity)
    yield from _granted(grants_in(path, spec, _settings.now()))


def _granted(grants: Iterable[Grant]) -> Iterator[ChangedRights]:
    for grant in grants:
        difference = permissions_diff(None, Permissions(grants=(grant,)))
        words = [*rights_words(difference)]
        if not difference.complete:  # other rules, of a file that is included, may have these words
            rules = hashlib.sha256(repr((grant.rules, grant.default)).encode()).hexdigest()
            words.append(f"rules with SHA-256 {rules}")
        yield ChangedRights((shown(grant.name),), tuple(words))


def _requested_rights(asked: SignRequest, now: datetime) -> Iterator[ChangedRights]:
    """What each participant of a sign request gets: what it asks for, or the role of an order."""
    for spec in asked.specs:
        yield _change(spec.name, f"a certificate that is valid for {days(spec.validity)}")
    if order := asked.order:
        for each in order.items:
            yield _change(each.name, f"the role {each.role} of the grant {order.grant}")
        return
    for spec in asked.specs:
        begin, end = lasting(now, spec.validity)
        least = Grant.least(
            name=spec.name,
            subject_name=f"CN={spec.name}",
            not_before=begin,
            not_after=end,
            domains=spec.domains,
            publish=spec.publish,
            subscribe=spec.subscribe,
        )
        yield from _granted(spec.grants or (least,))


def _certified(requests: Iterable[CertificateRequest]) -> Iterator[ChangedRights]:
    for each in requests:
        for one in each.sets:
            hashes = key_hashes(one.public_key, one.alternative_key)
            yield _change(
                name_asked_for(each) or shown(each.subject_name),
                f"a certificate for the key with SHA-256 {hashes}",
            )


def _change(name: str, words: str) -> ChangedRights:
    return ChangedRights((shown(name),), (shown(words, len(words)),))
