"""Runs hosts of a real stack until all have met: their credentials, configurations and runs."""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import profile_named
from pqsec_pki.benchmark.mesh_results import HostCredentials, MeshCase, MeshRun, Plugins
from pqsec_pki.credentials import ENCLAVES
from pqsec_pki.documents import DomainSet, Governance, ProtectionKind
from pqsec_pki.handshake import WireVersion
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, sign_governance
from pqsec_pki.plugin import SETTINGS
from pqsec_pki.stacks import Stack
from pqsec_pki.trial import (
    AgentUse,
    HostsSetup,
    Installation,
    TrialPlugin,
    built,
    in_memory,
    plugin,
    run_hosts,
)
from pqsec_pki.vendors import Options, export, write

TOPIC, _DOMAIN = "rt/chatter", 0
_VALIDITY = timedelta(days=1)
_UNSECURED = """<dds><profiles>
<transport_descriptors><transport_descriptor>
<transport_id>udp</transport_id><type>UDPv4</type>
</transport_descriptor></transport_descriptors>
<participant profile_name="host" is_default_profile="true"><rtps>
<userTransports><transport_id>udp</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports>
</rtps></participant></profiles></dds>
"""
"""A configuration of Fast DDS with UDP only, as between machines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshPlan:
    """The measurements to make."""

    installation: Installation
    cases: Sequence[MeshCase]
    rounds: int
    timeout: float
    """Seconds in which all hosts of a run should meet."""
    samples: int
    """Samples that each host then sends."""
    now: datetime


def measured_meshes(
    plan: MeshPlan, each: Callable[[int], None] = lambda _: None
) -> tuple[MeshRun, ...]:
    """Run all cases, then all again, `plan.rounds` times; call `each` with 1 after every one.

    KeyboardInterrupt ends it with the runs that were finished. SegmentError, BuildError, and
    VerificationError if the stack is known to refuse the credentials.
    """
    found: list[MeshRun] = []
    with suppress(KeyboardInterrupt), _prepared(plan) as prepared:
        for number in range(1, plan.rounds + 1):
            for case in plan.cases:
                found.append(prepared.run(case, number))
                each(1)
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Prepared:
    """The peer, the plugin with its agent, and the configurations of all hosts."""

    plan: MeshPlan
    program: Sequence[str]
    plugin: TrialPlugin | None
    environments: Mapping[HostCredentials, Sequence[Mapping[str, str]]]

    def run(self, case: MeshCase, number: int) -> MeshRun:
        before, load = self._agent(), os.getloadavg()[0]
        result = run_hosts(
            HostsSetup(
                program=self.program,
                environments=self.environments[case.credentials][: case.hosts],
                domain=_DOMAIN,
                topic=TOPIC,
                link=case.link,
                timeout=self.plan.timeout,
                samples=self.plan.samples,
            )
        )
        after = self._agent() if case.plugins is Plugins.PQSEC else before
        return MeshRun(
            case=case,
            number=number,
            load=load,
            result=result,
            agent_cpu=sum(taken - before.cpu.get(one, 0.0) for one, taken in after.cpu.items()),
            agent_memory=after.memory if case.plugins is Plugins.PQSEC else 0,
        )

    def _agent(self) -> AgentUse:
        return AgentUse.of(self.plugin) if self.plugin else AgentUse({}, 0)


@contextmanager
def _prepared(plan: MeshPlan) -> Iterator[_Prepared]:
    installation = plan.installation
    kinds = dict.fromkeys(case.credentials for case in plan.cases)
    hosts = max(case.hosts for case in plan.cases)
    with ExitStack() as stack:
        name = stack.enter_context(
            tempfile.TemporaryDirectory(prefix="pqsec-bench-", dir=in_memory())
        )
        program = installation.peer(built(installation))
        ours = None
        if any(plugins is Plugins.PQSEC for plugins, *_ in kinds):
            fastdds = installation if installation.build.stack is Stack.FASTDDS else None
            ours = stack.enter_context(plugin(fastdds=fastdds))
        yield _Prepared(
            plan=plan,
            program=program,
            plugin=ours,
            environments={
                kind: _environments(plan, Path(name), hosts, kind, ours) for kind in kinds
            },
        )


def _environments(
    plan: MeshPlan,
    folder: Path,
    hosts: int,
    kind: HostCredentials,
    ours: TrialPlugin | None,
) -> list[dict[str, str]]:
    """The variables of each host."""
    plugins, profile, version = kind
    if profile is None:
        return [_unsecured(plan.installation, folder)] * hosts
    root = folder / (f"{profile}-{version}" if version is WireVersion.SECOND else profile)
    store = _keystore(root, profile, hosts, plan.now)
    if version is WireVersion.SECOND:
        _set_version(store, version)
    used = ours if plugins is Plugins.PQSEC else None
    places = (folder / f"{plugins}-{profile}-{version}-{number}" for number in range(hosts))
    return [
        _secured(plan, store, _name(number), place, used) for number, place in enumerate(places)
    ]


def _name(number: int) -> str:
    return f"/host{number}"


def _keystore(root: Path, profile: str, hosts: int, now: datetime) -> Keystore:
    """One with so many participants, whose RTPS messages as a whole are not protected.

    With that protection, Cyclone DDS 0.10.2 never repeats a lost final message of a handshake.
    """
    if root.exists():
        return Keystore.open(root)
    domains = DomainSet.of(_DOMAIN)
    store = Keystore.create(
        root,
        profile_named(profile),
        name="Bench",
        domains=domains,
        validity=_VALIDITY,
        passphrase=None,
        now=now,
    )
    authorities = store.unlock(None)
    governance = Governance.protected(domains)
    rules = (replace(governance.domain_rules[0], rtps_protection_kind=ProtectionKind.NONE),)
    sign_governance(store, authorities, replace(governance, domain_rules=rules), now=now)
    spec = ParticipantSpec(
        name="", publish=(TOPIC,), subscribe=(TOPIC,), domains=domains, validity=_VALIDITY
    )
    specs = [replace(spec, name=_name(number)) for number in range(hosts)]
    issue(store, authorities, specs, now=now)
    return store


def _set_version(store: Keystore, version: WireVersion) -> None:
    """Let all hosts use that version of messages, and refuse any other."""
    for name in store.names():
        path = store.folder / ENCLAVES / name.removeprefix("/") / SETTINGS
        path.write_text(f"wire_versions = [{version}]\n")


def _secured(
    plan: MeshPlan, store: Keystore, name: str, place: Path, ours: TrialPlugin | None
) -> dict[str, str]:
    """The variables of a host with what `pqsec export` writes."""
    installation = plan.installation
    options = Options(
        version=installation.version,
        plugins=installation.plugins,
        plugin=ours.folder if ours else None,
        udp_only=True,
    )
    made = export(installation.build.stack, store, name, options, now=plan.now)
    write(made, place)
    return {**made.variables(place), **(ours.environment if ours else {})}


def _unsecured(installation: Installation, folder: Path) -> dict[str, str]:
    if installation.build.stack is not Stack.FASTDDS:
        return {installation.build.variable: ""}
    path = folder / "unsecured.xml"
    path.write_text(_UNSECURED)
    return {installation.build.variable: str(path)}
