"""pqsec issue: issue participants."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any

import click

from pqsec_pki import enrolment
from pqsec_pki._times import said
from pqsec_pki.algorithms import SealingPublicKey
from pqsec_pki.approvals import Covered
from pqsec_pki.cli import (
    _bundles,
    _completion,
    _help,
    _key_uris,
    _passphrases,
    _printing,
    _settings,
)
from pqsec_pki.cli._names import admitted, named
from pqsec_pki.cli._participant_options import (
    ParticipantOptions,
    note_doubtful_topics,
    participant_options,
)
from pqsec_pki.cli._superseded import note_superseded
from pqsec_pki.credentials import ENCLAVES, GOVERNANCE, PERMISSIONS
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.errors import PqsecError, UsageError, located
from pqsec_pki.keystore import Authorities, Keystore, ListDelivery, SigningCa, is_several
from pqsec_pki.lifecycle import Issued, ParticipantSpec, PublicKeys
from pqsec_pki.lifecycle import issue as issue_participants
from pqsec_pki.smime import document_in


@_help.command(
    examples={
        "Issue a ROS 2 node that publishes one topic": (
            "pqsec -k robots issue /camera --ros-node /camera --ros-publish /image"
        ),
        "Issue every participant of a policy": "pqsec issue --policy permissions.yaml",
        "Certify a robot's own keys, and write a bundle for it": (
            "pqsec issue --csr robot2.csr /fleet/robot2 --publish rt/chatter"
        ),
    },
    exit_codes={
        0: "all participants are issued",
        1: "no participant is issued: a request, key or document is not valid",
        3: "no participant is issued: the keystore, a file or the passphrase is missing or wrong",
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--domain", "domains", help="Allow these DDS domains: 0, 0-3 or 0,5. [default: the keystore's]"
)
@participant_options
@click.option(
    "--csr",
    "requests",
    multiple=True,
    type=_settings.FILE,
    metavar="FILE",
    help="Certify the keys of the requests in this file from a robot, and write bundles for it.",
)
@click.option(
    "--allow-name",
    "patterns",
    multiple=True,
    metavar="PATTERN",
    help="With --csr: allow names like '/fleet/*' in requests, instead of NAME... only.",
)
@_key_uris.participant_options
@_bundles.folder_option
@_bundles.seal_option
@click.option("--force", is_flag=True, help="Replace existing participants.")
@click.option("--after-revocation", is_flag=True, help="Also issue participants that were revoked.")
@click.option(
    "--certificate-only",
    is_flag=True,
    help="Leave the permissions to `pqsec permit`: no key of the permissions CA is needed.",
)
@_bundles.compromised_option
@_passphrases.option
@_settings.command_options
def issue(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    names: tuple[str, ...],
    domains: str | None,
    requests: tuple[Path, ...],
    patterns: tuple[str, ...],
    folder: Path | None,
    seal_for: Path | None,
    passphrase_file: Path | None,
    *,
    force: bool,
    after_revocation: bool,
    certificate_only: bool,
    compromised_keys: bool,
    **how: Any,
) -> None:
    """Issue participants: key, certificate and signed permissions.

    NAME is an enclave path such as /talker or /fleet/robot1. Topics are DDS topic
    expressions (rt/chatter), or ROS 2 names in the --ros-... options. Each NAME gets the
    rights of these options, or of its grant in --policy, and no others. Without a NAME,
    every name in --policy is issued. A pattern ('/robot1/*') or group (@hall1) is
    what it stands for in --policy, or, to replace them with --force, in the keystore. With
    --csr the keys stay on the robot, and bundles for `pqsec install` are written. With
    --participant-key-uri the key of one NAME is used from a token, or generated there.
    """
    wanted = ParticipantOptions.of(**how)
    if certificate_only:
        _refuse_rights(wanted, domains, folder, seal_for)
    if not requests:
        _refuse_without_requests(patterns, folder, seal_for)
        names = names or _policy_names(wanted)
    keystore = _settings.open_keystore(to_change=True)
    keystore.refuse_unapproved(Covered.GROW)
    keys = _requested(keystore, requests, names, patterns) if requests else {}
    names = tuple(keys) or _matching(keystore, wanted, names, after_revocation)
    _refuse_one_key(names, requests)
    into = (folder or Path()) if requests and not certificate_only else None
    domain_set = keystore.domains if domains is None else DomainSet.parse(domains)
    specs = [replace(spec, keys=keys.get(spec.name)) for spec in wanted.specs(names, domain_set)]
    if into:  # refused before the passphrase is asked for
        enrolment.bundle_paths(names, into, force=force)
    governance = _read_governance(keystore)
    to = (into, _bundles.recipient(seal_for)) if into else None
    issued, bundles = _made(
        keystore,
        _unlocked(keystore, passphrase_file, certificate_only=certificate_only),
        specs,
        to,
        certificate_only=certificate_only,
        now=_settings.now(),
        force=force,
        after_revocation=after_revocation,
        compromised_keys=compromised_keys,
    )
    if certificate_only:
        _note_rights(issued)
    else:
        _warn(governance, specs)
    note_doubtful_topics(keystore, [spec.name for spec in specs if spec.has_rights])
    note_unsigned_governance(keystore)
    if force:
        note_superseded(keystore, [each.name for each in issued], _settings.now())
    print_issued(keystore, issued, bundles)


def _requested(
    keystore: Keystore,
    requests: tuple[Path, ...],
    names: tuple[str, ...],
    patterns: tuple[str, ...],
) -> dict[str, PublicKeys]:
    """The keys that are to be certified, by name."""
    found = [request for _, request in _bundles.load_requests(requests)]
    return enrolment.validate_csrs(found, keystore.profiles, names=names, patterns=patterns)


def _made(
    keystore: Keystore,
    authorities: Authorities,
    specs: list[ParticipantSpec],
    to: tuple[Path, SealingPublicKey | None] | None,
    *,
    certificate_only: bool,
    **choices: Any,
) -> "tuple[list[Issued], list[enrolment.IssuedBundle]]":
    """What was issued; and the bundles, if there is a folder for them and who opens them."""
    if to is None:
        signs = not certificate_only
        return _issued(keystore, authorities, specs, sign_permissions=signs, **choices), []
    folder, recipient = to
    bundles = enrolment.issue_with_bundles(
        keystore, authorities, specs, folder, recipient=recipient, **choices
    )
    return [each.issued for each in bundles], bundles


def _unlocked(
    keystore: Keystore, passphrase_file: Path | None, *, certificate_only: bool
) -> Authorities:
    cas = (SigningCa.IDENTITY,) if certificate_only else ()
    return _passphrases.unlock(keystore, passphrase_file, *cas)


def _refuse_rights(wanted: ParticipantOptions, domains: str | None, *bundles: Path | None) -> None:
    if wanted.publish or wanted.subscribe or wanted.policy or domains is not None:
        raise UsageError(
            "--certificate-only and rights exclude each other",
            hint="give the rights where the permissions CA's key is: `pqsec permit`",
        )
    if any(bundles):
        raise UsageError(
            "--certificate-only writes no bundles: they need permissions",
            hint="write them when the permissions are signed: `pqsec bundle`",
        )


def _note_rights(issued: Sequence[Issued]) -> None:
    """Permissions name a subject and no key, so those of an earlier certificate are still good."""
    had = [each.name for each in issued if (each.folder / PERMISSIONS).exists()]
    if had:
        _printing.note(
            f"the permissions that were signed before stay: {_printing.few(had)}; `pqsec permit"
            " --remove`, where the permissions CA's key is, takes rights away"
        )


def _issued(
    keystore: Keystore, authorities: Authorities, specs: list[ParticipantSpec], **choices: Any
) -> list[Issued]:
    """What was issued, with keys in tokens if there are URIs for them."""
    uris = _key_uris.given_for_participant()
    with _key_uris.participants_own(keystore.profile, uris) as outside:
        specs = [
            replace(each, outside=outside, leaves_token=_key_uris.IN_FILE in uris.values())
            for each in specs
        ]
        return issue_participants(keystore, authorities, specs, **choices)


def _refuse_one_key(names: tuple[str, ...], requests: tuple[Path, ...]) -> None:
    """UsageError if one key is named for several, or beside the keys of requests."""
    uris = _key_uris.given_for_participant()
    if uris and requests:
        raise UsageError("--csr has the key already: leave its URI out")
    if len(names) > 1 and set(uris.values()) - {_key_uris.IN_FILE}:
        raise UsageError(
            f"one key is named for {len(names)} participants",
            hint="issue them one by one, each with a URI of its own",
        )


def _refuse_without_requests(patterns: tuple[str, ...], *others: Path | None) -> None:
    if patterns or any(others):
        raise UsageError("--allow-name, --bundles and --seal-for need requests: --csr FILE")


def _policy_names(wanted: ParticipantOptions) -> tuple[str, ...]:
    """The names in the policy. UsageError without --policy."""
    if not wanted.policy:
        raise UsageError("no participant named", hint="give names, or --policy FILE, or --csr FILE")
    return wanted.policy_names


def _matching(
    keystore: Keystore,
    wanted: ParticipantOptions,
    names: tuple[str, ...],
    revoked_too: bool,  # noqa: FBT001 -- of the command
) -> tuple[str, ...]:
    """The names; for a pattern or group those in the policy, or else in the keystore."""
    if not any(map(is_several, names)):
        return names
    if wanted.policy:
        return tuple(named(keystore, names, wanted.policy_names, where=f"in {wanted.policy}"))
    return tuple(admitted(keystore, names, revoked_too=revoked_too))


def _warn(governance: Governance, specs: list[ParticipantSpec]) -> None:
    if not any(spec.has_rights for spec in specs):
        _printing.note("no topic named: the permissions deny everything, also joining the domain")
    wanted = sorted({domain for spec in specs for domain in spec.domains.ids()})
    ungoverned = [domain for domain in wanted if governance.rule_for(domain) is None]
    if ungoverned:
        _printing.note(
            f"the governance does not name domain {', '.join(map(str, ungoverned))}: no participant"
            " can join it until you add it and run `pqsec sign-governance`"
        )


def note_unsigned_governance(keystore: Keystore) -> None:
    """Print one note if the governance is not signed: no participant would start with it."""
    path = _governance(keystore)
    try:
        keystore.anchors.signed(keystore.governance)
    except PqsecError as error:
        _printing.note(
            f"{path}: not signed by the permissions CA ({error}), and no participant starts with"
            " it: restore the signed file, or review governance.xml and"
            f" `pqsec -k {quote(str(keystore.root))} sign-governance"
            f" {quote(str(path.with_suffix('.xml')))} --force`"
        )


def _governance(keystore: Keystore) -> Path:
    return keystore.folder / ENCLAVES / GOVERNANCE


def _read_governance(keystore: Keystore) -> Governance:
    with located(_governance(keystore)):
        return Governance.from_xml(document_in(keystore.governance))


def print_issued(
    keystore: Keystore,
    issued: Sequence[Issued],
    bundles: "Sequence[enrolment.IssuedBundle]" = (),
    *,
    delivery: ListDelivery | None = None,
) -> None:
    """Print one line for each issued participant, with the path of its folder or bundle.

    Then which robots lack the newest revocation list, if there is one and it is asked for.
    """
    if issued and issued[0].shortened:
        end = issued[0].not_after
        _printing.note(f"valid only until {said(end)}, when the identity CA expires")
    found = bundles or issued
    rows = [each.row for each in bundles] or [each.row for one in issued for each in one.sets]
    value: dict[str, object] = {"keystore": keystore.root, "issued": found}
    value |= {"delivery": delivery} if delivery else {}
    late = delivery.lines if delivery and delivery.late else ()
    _printing.emit(value, [*map("  ".join, rows), *late])
