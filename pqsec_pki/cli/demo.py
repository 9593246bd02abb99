"""pqsec demo: create a secured domain and run its handshake in one command."""

import os
from datetime import timedelta
from itertools import count
from pathlib import Path
from shlex import quote

import click

from pqsec_pki.algorithms import profile_named
from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.cli._handshake_lines import lines_of
from pqsec_pki.cli.ca import profile_option
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import ExistsError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.selfcheck import verify_handshake

_YEAR = timedelta(days=365)


@_help.command(
    examples={
        "Create a domain in pqsec-demo": "pqsec demo",
        "Create one with post-quantum keys only": "pqsec demo quantum --profile pq",
    },
    exit_codes={
        0: "the domain is created, and the handshake succeeds",
        1: "the domain is created, but the handshake fails",
        3: "the folder already has a keystore, or cannot be written",
    },
)
@click.argument("folder", required=False, type=_settings.FOLDER)
@profile_option
@_settings.command_options
def demo(folder: Path | None, profile_name: str) -> None:
    """Create a secured domain with two participants and run their handshake.

    The keystore is written to FOLDER, else to -k, else to pqsec-demo. Its participants are
    /talker and /listener, and its CA keys are not encrypted. The single commands that do the
    same are printed.
    """
    folder = folder or _settings.settings().keystore or Path("pqsec-demo")
    profile = profile_named(profile_name)
    now = _settings.now()
    domains = DomainSet.of(0)
    _refuse_occupied(folder)
    keystore = Keystore.create(
        folder,
        profile,
        name="Demo",
        domains=domains,
        validity=10 * _YEAR,
        passphrase=None,
        gitignore=True,
        now=now,
    )
    specs = [
        _spec("/talker", domains, publish=(ros.topic("/chatter"),)),
        _spec("/listener", domains, subscribe=(ros.topic("/chatter"),)),
    ]
    issue(keystore, keystore.unlock(None), specs, now=now)
    report = verify_handshake(keystore, "/talker", "/listener", now=now)
    value = {"keystore": folder, "profile": profile.name, "handshake": report}
    _printing.emit(
        value, [*_result_lines(keystore), *lines_of(report), "", *_command_lines(keystore)]
    )
    if not report.ok:
        click.get_current_context().exit(1)


def _refuse_occupied(folder: Path) -> None:
    """ExistsError for a folder with a keystore; the hint leaves it as it is."""
    try:
        Keystore.refuse_occupied(folder)
    except ExistsError as error:
        others = (folder.with_name(f"{folder.name}-{number}") for number in count(2))
        other = quote(str(next(each for each in others if not os.path.lexists(each))))
        error.hint = f"`pqsec demo {other}` creates another domain, and leaves this one as it is"
        raise


def _spec(
    name: str, domains: DomainSet, publish: tuple[str, ...] = (), subscribe: tuple[str, ...] = ()
) -> ParticipantSpec:
    """The ROS 2 node `name` with these topics."""
    needs = ros.node_minimum(name)
    return ParticipantSpec(
        name=name,
        domains=domains,
        publish=publish + needs.publish,
        subscribe=subscribe + needs.subscribe,
        validity=_YEAR,
    )


def _result_lines(keystore: Keystore) -> list[str]:
    root, profile = keystore.root, keystore.profile
    second = f" and {profile.alternative_key.name}" if profile.alternative_key else ""
    keys = f"{profile.identity_key.name}{second}"
    return [
        f"Created a secured domain in {root}, profile {profile.name}: {profile.summary}.",
        "",
        f"  {root}/public             identity and permissions CA ({keys})",
        f"  {root}/private            their keys (not encrypted: this is a demo)",
        f"  {root}/enclaves           governance: all authenticated and encrypted on domain 0",
        f"  {root}/enclaves/talker    may publish rt/chatter, and what every ROS 2 node needs",
        f"  {root}/enclaves/listener  may subscribe to rt/chatter, and what every ROS 2 node needs",
        "",
        "Ran the handshake between them, and one encrypted message each way:",
        "",
    ]


def _command_lines(keystore: Keystore) -> list[str]:
    root = keystore.root
    return [
        "The same in single steps:",
        f"  pqsec -k my-domain ca init --profile {keystore.profile.name}",
        "  pqsec -k my-domain issue /talker --ros-node /talker --ros-publish /chatter",
        "  pqsec -k my-domain issue /listener --ros-node /listener --ros-subscribe /chatter",
        "  pqsec -k my-domain verify-handshake /talker /listener",
        f"See also: pqsec inspect {root}/enclaves/talker/cert.pem",
    ]
