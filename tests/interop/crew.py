"""Participants of a ROS 2 domain, as a policy in YAML names them, and their exports."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import permissions_from_yaml
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export, write
from tests.interop.conftest import YEAR, Lab

POLICY = b"""
grants:
  - {name: /talker, nodes: [{node: /talker, publish: [chatter]}]}
  - {name: /listener, nodes: [{node: /listener, subscribe: [chatter]}]}
  - {name: /stranger, nodes: [{node: /stranger, subscribe: [gossip]}]}
  - name: /robot/base
    nodes:
      - {node: /robot/drive, publish: [odom]}
      - {node: imu, namespace: /robot/sensors, publish: [~/raw]}
      - /robot/watchdog
  - {name: /clocked, nodes: [{node: /clocked, use_sim_time: true}]}
  - {name: /managed, nodes: [{node: /managed, lifecycle: true}]}
  - {name: /cook, nodes: [{node: /cook, action_servers: [/cook]}]}
  - {name: /guest, nodes: [{node: /guest, action_clients: [/cook]}]}
  - name: /desk
    publish: [ros_discovery_info, rt/rosout, rt/parameter_events, "rr/_ros2cli_*"]
    subscribe: [ros_discovery_info, rt/chatter, "rq/_ros2cli_*"]
  - {name: /tuner, nodes: [{node: /tuner, parameters_of: [/talker]}]}
"""


@dataclass(frozen=True)
class Crew:
    """A keystore with those participants, and the scripts that start them."""

    lab: Lab
    folder: Path

    @classmethod
    def create(cls, folder: Path, profile: Profile, now: datetime, policy: bytes = POLICY):
        lab = Lab.create(folder / "it's a $k", profile, now)
        crew = cls(lab, folder)
        crew.issue(policy)
        return crew

    @property
    def keystore(self) -> Keystore:
        return self.lab.keystore

    def issue(self, policy: bytes) -> None:
        """Make the participants that the policy names; existing ones get its present rights."""
        specs = [
            ParticipantSpec(
                name=grant.name, domains=_domains(grant), validity=YEAR, grants=(grant,)
            )
            for grant in permissions_from_yaml(policy, now=self.lab.now).grants
        ]
        issue(self.keystore, self.lab.authorities, specs, now=self.lab.now, force=True)

    def script(self, name: str, **options) -> Path:
        """The export's; what would be refused is written all the same."""
        options = {"anyway": True, **options}
        stack = stack_named("ros2")
        made = export(stack, self.keystore, name, Options(**options), now=self.lab.now)
        folder = self.folder / f"scripts{name}"
        folder.parent.mkdir(parents=True, exist_ok=True)
        write(made, folder, force=True)
        return folder / made.main


def _domains(grant):
    return grant.rules[0].domains
