"""The results of meshes: times, counts and losses, as JSON and as rows of CSV."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.benchmark.environment import Environment
from pqsec_pki.handshake import WireVersion
from pqsec_pki.trial import HostsRun, Link

MESH_COLUMNS = (
    *("stack", "version", "plugins", "profile", "hosts", "loss", "delay_ms", "mtu"),
    *("run", "host", "measure", "value", "wire_version"),
)
MET = "met_s"
"""The measure of one host and one other."""
_MILLI = 1000


class Plugins(StrEnum):
    """Whose security plugins a stack runs."""

    PQSEC = "pqsec"
    STOCK = "stock"
    """The stack's own."""
    NONE = "none"
    """No security."""


HostCredentials = tuple[Plugins, str | None, WireVersion | None]
"""The plugins, the profile and the version of messages of all hosts of a case."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshCase:
    """The parameters of one case, which runs several times."""

    plugins: Plugins
    profile: str | None
    """None without security."""
    hosts: int
    link: Link
    wire_version: WireVersion | None
    """The version of the messages between pqsec's plugins; None with other plugins."""

    @property
    def credentials(self) -> HostCredentials:
        """The credentials of its hosts, which cases with other links share."""
        return self.plugins, self.profile, self.wire_version

    def __str__(self) -> str:
        second = self.wire_version is WireVersion.SECOND
        kind = f"{self.plugins}, version {self.wire_version}" if second else self.plugins
        return f"{self.profile or 'unsecured'} ({kind}), {self.hosts} hosts"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshRun:
    """One run of a case."""

    case: MeshCase
    number: int
    load: float
    """Processes that ran or waited for a processor in the minute before."""
    result: HostsRun
    agent_cpu: float
    """Seconds of the processor that pqsec's agent took."""
    agent_memory: int
    """Kilobytes of the agent and its workers after the run."""

    @property
    def complete(self) -> bool:
        """Whether all hosts met all others."""
        return self.result.complete == self.case.hosts

    @property
    def full(self) -> float | None:
        """Seconds until the last host had met all others; None if that did not happen."""
        ends = [each.met[-1] for each in self.result.hosts if each.met]
        return max(ends) if self.complete else None

    @property
    def meetings(self) -> list[float]:
        """Seconds until each host had met one other, two, ...; of all hosts."""
        return [when for each in self.result.hosts for when in each.met]

    @property
    def totals(self) -> dict[str, int | float | None]:
        """The numbers of the whole run, by measure."""
        result, counts = self.result, self.result.counts
        kernels = [each.kernel for each in result.hosts]
        return {
            "complete": result.complete,
            "full_s": self.full,
            "datagrams": sum(each.get("OutDatagrams", 0) for each in kernels),
            "frames": counts["frames"],
            "frame_bytes": counts["bytes"],
            "fragments": counts["fragments"],
            "deliveries": counts["deliveries"],
            "lost": counts["lost"],
            "buffer_errors": sum(each.get("RcvbufErrors", 0) for each in kernels),
            "queue_drops": sum(each.get("QueueDrops", 0) for each in kernels),
            "reassembly_failures": sum(each.get("ReasmFails", 0) for each in kernels),
            "handshake_messages": counts["handshake_messages"],
            "handshake_repeats": counts["handshake_repeats"],
            "samples_lost": result.samples_lost,
            "killed": sum(each.signal is not None for each in result.hosts),
            "hosts_cpu_s": sum(each.cpu for each in result.hosts),
            "agent_cpu_s": self.agent_cpu,
            "agent_kb": self.agent_memory,
            "switch_cpu_s": counts["cpu"],
            "load": self.load,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredMeshes:
    """Runs in one stack."""

    stack: str
    version: str
    runs: Sequence[MeshRun]

    def to_json(self) -> dict[str, object]:
        """For --json."""
        return {
            "stack": self.stack,
            "stack_version": self.version,
            "runs": [
                {
                    **self._key(run),
                    "run": run.number,
                    **run.totals,
                    "joined_s": [each.joined for each in run.result.hosts],
                    MET: [each.met for each in run.result.hosts],
                    "log": next((each.log for each in run.result.hosts if each.log), ()),
                }
                for run in self.runs
            ],
        }

    def rows(self, environment: Environment) -> Iterator[dict[str, object]]:
        """One for each measured value, with the keys MESH_COLUMNS; the environment is first."""
        for name, value in asdict(environment).items():
            yield {"stack": self.stack, "measure": f"environment.{name}", "value": value}
        for run in self.runs:
            own = self._key(run) | {"run": run.number}
            for name, number in run.totals.items():
                yield own | {"measure": name, "value": number}
            for host, each in enumerate(run.result.hosts):
                yield own | {"host": host, "measure": "joined_s", "value": each.joined}
                yield from (own | {"host": host, "measure": MET, "value": at} for at in each.met)

    def _key(self, run: MeshRun) -> dict[str, object]:
        case = run.case
        return {
            "stack": self.stack,
            "version": self.version,
            "plugins": case.plugins.value,
            "profile": case.profile,
            "hosts": case.hosts,
            "loss": case.link.loss,
            "delay_ms": case.link.delay * _MILLI,
            "mtu": case.link.mtu,
            "wire_version": case.wire_version,
        }
