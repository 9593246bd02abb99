"""pqsec issue: participants of a domain."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki.cli import _common, _policy
from pqsec_pki.documents import DomainSet, Governance, ros
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Issued, Keystore, Wish
from pqsec_pki.keystore import issue as issue_participants
from pqsec_pki.smime import document_in

_ROS = {
    "ros_node": ros.node_minimum,
    "ros_service": ros.service_server,
    "ros_client": ros.service_client,
    "ros_action_server": ros.action_server,
    "ros_action_client": ros.action_client,
}
"""Option -> what it lets a participant publish and subscribe to."""


@click.command()
@click.argument("names", nargs=-1, required=True, metavar="NAME...")
@click.option("--domain", "domains", help="DDS domains: 0, or 0-3, or 0,5. [default: the CA's]")
@click.option("--publish", multiple=True, metavar="TOPIC", help="A DDS topic expression.")
@click.option("--subscribe", multiple=True, metavar="TOPIC", help="A DDS topic expression.")
@click.option("--ros-publish", multiple=True, metavar="TOPIC", help="A ROS 2 topic: /chatter.")
@click.option("--ros-subscribe", multiple=True, metavar="TOPIC", help="A ROS 2 topic.")
@click.option("--ros-service", multiple=True, metavar="NAME", help="A ROS 2 service it serves.")
@click.option("--ros-client", multiple=True, metavar="NAME", help="A ROS 2 service it calls.")
@click.option("--ros-action-server", multiple=True, metavar="NAME", help="An action it serves.")
@click.option("--ros-action-client", multiple=True, metavar="NAME", help="An action it calls.")
@click.option(
    "--ros-node", multiple=True, metavar="NODE", help="What a ROS 2 node needs to start: /talker."
)
@click.option(
    "--policy",
    type=_common.FILE,
    help="Take what each NAME may do from permissions in YAML, or a policy of SROS2.",
)
@click.option("--validity", type=_common.Duration(), default="1y", show_default=True)
@click.option("--force", is_flag=True, help="Replace participants that are there already.")
@_common.passphrase_option
@_common.command_options
def issue(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    names: tuple[str, ...],
    domains: str | None,
    publish: tuple[str, ...],
    subscribe: tuple[str, ...],
    ros_publish: tuple[str, ...],
    ros_subscribe: tuple[str, ...],
    policy: Path | None,
    validity: timedelta,
    passphrase_file: Path | None,
    *,
    force: bool,
    **ros_names: tuple[str, ...],
) -> None:
    """Issue participants: key, certificate and signed permissions.

    NAME is an enclave path such as /talker or /fleet/robot1. Topics are DDS topic
    expressions as they stand on the wire (rt/chatter); --ros-... takes ROS names. Each
    NAME may do what is named here, or in its grant of --policy, and nothing else.
    """
    keystore = _common.open_keystore()
    publish += tuple(map(ros.topic, ros_publish))
    subscribe += tuple(map(ros.topic, ros_subscribe))
    for option, given in ros_names.items():
        for name in given:
            also = _ROS[option](name)
            publish, subscribe = publish + also.publish, subscribe + also.subscribe
    domain_set = keystore.domains if domains is None else DomainSet.parse(domains)
    wishes = [
        Wish(
            name=name,
            domains=domain_set,
            publish=tuple(dict.fromkeys(publish)),
            subscribe=tuple(dict.fromkeys(subscribe)),
            validity=validity,
        )
        for name in names
    ]
    if policy:
        if publish or subscribe:
            raise UsageError("--policy says which topics there are: name none beside it")
        wishes = _policy.granted(wishes, policy, now=_common.now())
    governance = Governance.from_xml(document_in(keystore.governance))
    authorities = _common.unlock(keystore, passphrase_file)
    issued = issue_participants(keystore, authorities, wishes, now=_common.now(), force=force)
    _warn(governance, issued, wishes)
    _tell(keystore, issued)


def _warn(governance: Governance, issued: list[Issued], wishes: list[Wish]) -> None:
    if not any(wish.publish or wish.subscribe or wish.grants for wish in wishes):
        _common.note("no topic was named: the permissions deny everything, even to join")
    if issued[0].shortened:
        end = issued[0].not_after
        _common.note(f"valid until {end:%Y-%m-%d} only, when the identity CA expires")
    wanted = sorted({domain for wish in wishes for domain in wish.domains.ids()})
    ungoverned = [domain for domain in wanted if governance.rule_for(domain) is None]
    if ungoverned:
        _common.note(
            f"the governance does not name domain {', '.join(map(str, ungoverned))}: nobody can"
            " join there until you add it and run `pqsec sign-governance`"
        )


def _tell(keystore: Keystore, issued: list[Issued]) -> None:
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
            }
            for each in issued
        ],
    }
    _common.emit(
        value,
        [f"{each.name}  until {each.not_after:%Y-%m-%d}  {each.folder}" for each in issued],
    )
