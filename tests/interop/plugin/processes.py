"""Processes of Cyclone DDS whose configuration loads the plugin, Cyclone's own, or some of both."""

from dataclasses import dataclass
from pathlib import Path

from pqsec_pki.trial import (
    Act,
    Installation,
    TrialRole,
    TrialRun,
    TrialSetup,
    built,
    run_peers,
    unique_text,
)
from tests.interop.conftest import TOPIC
from tests.interop.plugin.conftest import Shim
from tests.interop.strangers import run_strangers

DOMAIN = 3
PATIENCE = 60.0
"""Seconds that two who should meet get."""
REFUSAL = 2.5
"""Those who should not."""

_FILE = """<CycloneDDS><Domain id="any">
<General>
 <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
 <AllowMulticast>false</AllowMulticast>
 <MaxMessageSize>1400B</MaxMessageSize><FragmentSize>1300B</FragmentSize>
</General>
<Discovery>
 <Peers><Peer address="127.0.0.1"/></Peers>
 <ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex>
</Discovery>
<Security>
 <Authentication>
  <Library path="{authentication}" initFunction="init_authentication"
           finalizeFunction="finalize_authentication"/>
  <IdentityCA>file:{folder}/identity_ca.cert.pem</IdentityCA>
  <IdentityCertificate>file:{folder}/cert.pem</IdentityCertificate>
  <PrivateKey>file:{folder}/key.pem</PrivateKey>{crl}
 </Authentication>
 <AccessControl>
  <Library path="{access_control}" initFunction="init_access_control"
           finalizeFunction="finalize_access_control"/>
  <PermissionsCA>file:{folder}/permissions_ca.cert.pem</PermissionsCA>
  <Governance>file:{folder}/governance.p7s</Governance>
  <Permissions>file:{folder}/permissions.p7s</Permissions>
 </AccessControl>
 <Cryptographic>
  <Library path="{own}/libdds_security_crypto.so" initFunction="init_crypto"
           finalizeFunction="finalize_crypto"/>
 </Cryptographic>
</Security>
{internal}
</Domain></CycloneDDS>
"""


@dataclass(frozen=True)
class Stage:
    """Where plugins and peers are, and where configurations are written."""

    installation: Installation
    shim: Shim
    own: Path
    """The folder of Cyclone DDS's own plugins."""
    folder: Path
    most: int = 9
    """The highest index of a participant."""

    @property
    def program(self) -> list[str]:
        """What runs a peer."""
        return self.installation.peer(built(self.installation))

    def environment(
        self, enclave: Path, *, plugins: str = "ours ours", loss: float = 0
    ) -> dict[str, str]:
        """`plugins` says of authentication and access control whose they are, or that only
        their names are given; `loss` is the part of packets that get lost, of 1."""
        names = {"authentication": "auth", "access_control": "ac"}
        paths = {
            what: {
                "ours": str(self.shim.folder / "libpqsec_dds.so"),
                "cyclones": str(self.own / f"libdds_security_{names[what]}.so"),
                "named": f"dds_security_{names[what]}",  # as rmw_cyclonedds has it
            }[whose]
            for what, whose in zip(names, plugins.split(), strict=True)
        }
        lossy = (
            f"<Internal><Test><XmitLossiness>{int(loss * 1000)}</XmitLossiness></Test></Internal>"
        )
        crl = f"<CRL>file:{enclave}/crl.pem</CRL>" if (enclave / "crl.pem").exists() else ""
        internal = lossy if loss else ""
        text = _FILE.format(
            folder=enclave, own=self.own, internal=internal, crl=crl, most=self.most, **paths
        )
        path = self.folder / f"{len(list(self.folder.iterdir()))}.xml"
        path.write_text(text)
        return {"CYCLONEDDS_URI": path.as_uri(), "LD_LIBRARY_PATH": str(self.shim.folder)}

    def sender(self, enclave: Path, **choices) -> TrialRole:
        """One that sends a text which is nowhere by chance."""
        environment = self.environment(enclave, **choices)
        return TrialRole(name="sender", act=Act.SEND, text=unique_text(), environment=environment)

    def receiver(self, enclave: Path, **choices) -> TrialRole:
        environment = self.environment(enclave, **choices)
        return TrialRole(name="receiver", act=Act.RECEIVE, environment=environment)

    def run_peers(
        self, *roles: TrialRole, topic: str = TOPIC, seconds: float = PATIENCE
    ) -> TrialRun:
        """How it went."""
        scene = TrialSetup(program=self.program, domain=DOMAIN, topic=topic, timeout=seconds)
        return run_peers(scene, roles)

    def run_strangers(self, *roles: TrialRole, said: str = "") -> TrialRun:
        """How it went with some that should not meet, and when a log had `said`."""
        return run_strangers(self.run_peers, roles, (REFUSAL, PATIENCE), said)


def met(trial_run: TrialRun) -> bool:
    """Whether the second got what the first sent, and nobody could read it on the way."""
    sender, receiver, *others = trial_run.outcomes
    log = "\n".join(each.log for each in trial_run.outcomes)
    wire = trial_run.wire
    assert not any(each.signal for each in trial_run.outcomes), log
    assert wire is None or (wire.packets and not wire.readable), log
    assert not any(each.received for each in others), log
    return receiver.received == sender.role.text


def logs(trial_run: TrialRun) -> str:
    return "\n".join(each.log for each in trial_run.outcomes)
