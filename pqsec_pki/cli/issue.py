"""pqsec issue: participants of a domain."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from pqsec_pki.algorithms import SealingPublicKey
from pqsec_pki.cli import _bundles, _passphrases, _printing, _settings
from pqsec_pki.cli._participant_options import ParticipantOptions, participant_options
from pqsec_pki.credentials import ENCLAVES, GOVERNANCE
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import PqsecError, UsageError, located
from pqsec_pki.keystore import Issued, Keystore, ParticipantSpec
from pqsec_pki.keystore import issue as issue_participants
from pqsec_pki.smime import document_in


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--domain", "domains", help="DDS domains: 0, or 0-3, or 0,5. [default: the CA's]")
@participant_options
@click.option(
    "--csr",
    "requests",
    multiple=True,
    type=_settings.FILE,
    metavar="FILE",
    help="Certify the keys of this request, made on the robot, and write a bundle for it.",
)
@click.option(
    "--allow-name",
    "patterns",
    multiple=True,
    metavar="PATTERN",
    help="With --csr: names that requests may have, such as '/fleet/*'; else they are NAME...",
)
@_bundles.folder_option
@_bundles.seal_option
@click.option("--force", is_flag=True, help="Replace participants that are there already.")
@click.option("--after-revocation", is_flag=True, help="Also those that were revoked.")
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
    compromised_keys: bool,
    **how: Any,
) -> None:
    """Issue participants: key, certificate and signed permissions.

    NAME is an enclave path such as /talker or /fleet/robot1. Topics are DDS topic
    expressions as they stand on the wire (rt/chatter); --ros-... takes ROS names. Each
    NAME may do what is named here, or in its grant of --policy, and nothing else; without
    a NAME, everybody in --policy is issued. With --csr the keys were made elsewhere, and
    the answers are bundles for `pqsec install`.
    """
    wanted = ParticipantOptions.of(**how)
    if not requests:
        _refuse_without_requests(patterns, folder, seal_for)
        names = names or _everybody(wanted)
    keystore = _settings.open_keystore(to_change=True)
    asked = _bundles.read_requests(requests, keystore.profile, names, patterns)
    domain_set = keystore.domains if domains is None else DomainSet.parse(domains)
    specs = wanted.specs(tuple(asked) or names, domain_set)
    specs = [_bundles.with_keys(spec, asked) for spec in specs]
    goals = _bundles.goals(asked, folder, force=force)
    with located(_governance(keystore)):
        governance = Governance.from_xml(document_in(keystore.governance))
    recipient = _bundles.recipient(seal_for)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    issued = issue_participants(
        keystore,
        authorities,
        specs,
        now=_settings.now(),
        force=force,
        after_revocation=after_revocation,
        compromised_keys=compromised_keys,
    )
    _warn(governance, specs)
    tell_of_governance(keystore)
    for name, goal in goals.items():
        _answer(keystore, name, goal, recipient, force=force)
    tell(keystore, issued, goals)


def _refuse_without_requests(patterns: tuple[str, ...], *others: Path | None) -> None:
    if patterns or any(others):
        raise UsageError("--allow-name, --bundles and --seal-for are for requests: --csr FILE")


def _everybody(wanted: ParticipantOptions) -> tuple[str, ...]:
    """Whom the policy is about; UsageError if there is none."""
    if not wanted.policy:
        raise UsageError(
            "name at least one participant", hint="or a --policy, or a request: --csr FILE"
        )
    return wanted.everybody


def _answer(
    keystore: Keystore, name: str, goal: Path, recipient: SealingPublicKey | None, *, force: bool
) -> None:
    bundle = Bundle.of(keystore, [name], now=_settings.now())
    with _printing.advising(
        f"{name} is issued all the same: `pqsec bundle {name}` makes its bundle"
    ):
        _bundles.write(bundle, goal, recipient, force=force)


def _warn(governance: Governance, specs: list[ParticipantSpec]) -> None:
    if not any(spec.publish or spec.subscribe or spec.grants for spec in specs):
        _printing.note("no topic was named: the permissions deny everything, even to join")
    wanted = sorted({domain for spec in specs for domain in spec.domains.ids()})
    ungoverned = [domain for domain in wanted if governance.rule_for(domain) is None]
    if ungoverned:
        _printing.note(
            f"the governance does not name domain {', '.join(map(str, ungoverned))}: nobody can"
            " join there until you add it and run `pqsec sign-governance`"
        )


def tell_of_governance(keystore: Keystore) -> None:
    """Of a governance with which none of its participants would start, once for all of them."""
    path = _governance(keystore)
    try:
        keystore.anchors.signed(keystore.governance)
    except PqsecError as error:
        _printing.note(
            f"{path}: the permissions CA did not sign it as it is ({error}), and no participant"
            " starts with it: put back what was signed, or look through governance.xml and"
            f" `pqsec -k {keystore.root} sign-governance {path.with_suffix('.xml')} --force`"
        )


def _governance(keystore: Keystore) -> Path:
    return keystore.root / ENCLAVES / GOVERNANCE


def tell(
    keystore: Keystore, issued: list[Issued], bundles: Mapping[str, Path] | None = None
) -> None:
    """What was made, one line for each participant; where its bundle is, if it has one."""
    bundles = bundles or {}
    if issued and issued[0].shortened:
        end = issued[0].not_after
        _printing.note(f"valid until {end:%Y-%m-%d} only, when the identity CA expires")
    value = {
        "keystore": str(keystore.root),
        "issued": [
            {
                "name": each.name,
                "folder": str(each.folder),
                "serial": each.serial,
                "not_after": each.not_after.isoformat(),
                "certificate_bytes": each.certificate_size,
                "permissions_bytes": each.permissions_size,
                **({"bundle": str(bundles[each.name])} if each.name in bundles else {}),
            }
            for each in issued
        ],
    }
    places = {each.name: bundles.get(each.name, each.folder) for each in issued}
    _printing.emit(
        value,
        [f"{each.name}  until {each.not_after:%Y-%m-%d}  {places[each.name]}" for each in issued],
    )
