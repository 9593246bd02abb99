"""Robots that enrol at a running `pqsec serve` and renew there, against primitives and commits.

All is on this machine: the server's two processes, and the robots as threads of this one, which
make their keys and ask as `pqsec enrol` does. The floor is measured in the same run, in one thread:

- of each robot the raw primitives: a key, a handshake of TLS (both sides; a renewal shows a
  certificate too), the request's signature and its verification, and of certificate and permissions
  the signatures, each verified once. The governance is verified once for all;
- the commits that are needed if all who ask at once get one: robots / robots at once, each as long
  as a change of one line takes at the end, with a ledger of that size. The CA signs the ledger's
  next head in each, and verifies the last one.

An answer follows its commit. `ms` is the time of the clock for each robot, the columns after it are
milliseconds of a processor: of both processes of the server and of the robots, then the floor. `x`
is the time of the clock over that of the floor, `x cpu` all processor time over the floor's.

With --renew-only the fleet gets its first certificates by `pqsec apply`, some of it renews to warm
up, and then all of it renews once. The line after it says whether that took at most what 10,000
robots may take, ten minutes, and how long robots waited for their answers.
Run: python bench/serve.py [--robots 300] [--at-once 32] [--profile pq] [--folder DIR]
         [--renew-only] [--warm-up 200] [file] [postgresql]
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import quantiles
from typing import NamedTuple

from cryptography.hazmat.backends.openssl import backend
from OpenSSL import SSL

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has the other side

from pqsec_pki.algorithms import PrivateKey, private_key_pem, profile_named
from pqsec_pki.certificates import CertificateRequest, certificate_request
from pqsec_pki.documents import DomainSet
from pqsec_pki.domain import deliver_request, read_domain
from pqsec_pki.enrolment import Bundle
from pqsec_pki.est import PEM_FILE, REQUESTS, EstClient, ServerTrust, TlsIdentity
from pqsec_pki.keystore import Entry, Keystore, LedgerAddress, change
from tests.postgres import Cluster
from tests.unit.serving import HOST, Server
from tests.unit.tls_sides import connected

TRIES, COMMITS = 100, 20
REQUEST, CERTIFICATE, DOCUMENT = bytes(2200), bytes(2400), bytes(200)
"""About what a signature of each kind covers."""
LEAST_RATE = 10_000 / 600
"""Renewals a second: 10,000 in ten minutes."""
TICK = os.sysconf("SC_CLK_TCK")
LIMITS = dict.fromkeys(
    ("connections_of_address", "requests_of_address", "requests_of_label"), 10_000_000
)
DOMAIN = """
name: Bench
profile: {profile}
validity: 90d
roles: {{robot: {{publish: [rt$name/pose], subscribe: [rt/cmd]}}}}
participants:
  - {{name: "/fleet/r{{1..{count}}}", role: robot, request: requests/}}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ledgers", nargs="*", help="file [the default], postgresql")
    parser.add_argument("--robots", type=int, default=300)
    parser.add_argument("--at-once", type=int, default=32)
    parser.add_argument("--profile", default="pq")
    parser.add_argument("--folder", help="where to make the keystore; its file system matters")
    parser.add_argument("--renew-only", action="store_true", help="issue the first by apply")
    parser.add_argument("--warm-up", type=int, default=200, help="renewals before those that count")
    options = parser.parse_args()
    print(machine(options.folder or tempfile.gettempdir()))
    print(f"{options.robots} robots, {options.at_once} at once, profile {options.profile}")
    print(HEAD)
    for kind in options.ledgers or ["file"]:
        with tempfile.TemporaryDirectory(dir=options.folder) as folder, ledger_of(kind) as ledger:
            measure(kind, BenchServer(Path(folder), ledger, options), options)


def machine(folder: str) -> str:
    """What the numbers depend on."""
    cpu = Path("/proc/cpuinfo").read_text().partition("model name")[2].splitlines()[0].strip("\t :")
    memory = int(Path("/proc/meminfo").read_text().split()[1]) >> 20
    command = ["stat", "--file-system", "--format=%T", folder]
    file_system = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return (
        f"{len(os.sched_getaffinity(0))} cores of {cpu}, {memory} GB, load"
        f" {os.getloadavg()[0]:.1f}, {folder} on {file_system};"
        f" {platform.system()} {platform.release()}, Python {platform.python_version()},"
        f" {backend.openssl_version_text()}"
    )


@contextmanager
def ledger_of(kind: str) -> Iterator[LedgerAddress | None]:
    """None for the file; else that of a PostgreSQL, as tests run it, but with fsync."""
    if kind == "file":
        yield None
        return
    with Cluster.created() as cluster:
        cluster.stop("fast")
        cluster.start(fsync="on")
        yield cluster.address(cluster.database())


class BenchServer(Server):
    """A server for many robots, with any ledger."""

    def __init__(self, folder: Path, ledger: LedgerAddress | None, options) -> None:
        self._ledger = ledger
        super().__init__(
            folder,
            datetime.now(UTC),
            options.profile,
            robots=options.robots,
            renew="any-time",
            limits=LIMITS,
        )

    def create(self, profile: str, now: datetime, robots: int = 1) -> None:
        text = DOMAIN.format(profile=profile, count=robots)
        (self.folder / "domain.yaml").write_text(text)
        Keystore.create(
            self.root,
            profile_named(profile),
            name="Bench",
            domains=DomainSet.of(0),
            validity=timedelta(days=3650),
            passphrase=None,
            ledger=self._ledger,
            now=now,
        )

    def processes(self) -> dict[str, int]:
        """The signer and the front."""
        signer = self.process.pid
        children = Path(f"/proc/{signer}/task/{signer}/children").read_text().split()
        return {"signer": signer, "front": int(children[0])}


class Robot:
    """Asks for a certificate, and keeps the newest."""

    def __init__(self, name: str, server: BenchServer, trust: ServerTrust) -> None:
        self.name, self._url, self._trust = name, f"https://{HOST}:{server.port}", trust
        self._profile = server.keystore.profile
        self._identity: TlsIdentity | None = None
        self.waited = 0.0
        """Seconds until the last answer."""

    def request(self) -> tuple[PrivateKey, CertificateRequest]:
        """A new key, and a request for it."""
        key = self._profile.participant_key.generate()
        second = self._profile.alternative_key
        return key, certificate_request(self.name, key, second.generate() if second else None)

    def has(self, certificate: bytes, key: PrivateKey) -> None:
        """It shows these from now on."""
        self._identity = TlsIdentity(certificate, private_key_pem(key))

    def ask(self, token=None) -> None:
        """Enrol with a token, or renew."""
        key, made = self.request()
        client = EstClient(
            server=self._url,
            trust=self._trust,
            identity=None if token else self._identity,
            secret=(token.id, token.secret) if token else None,
        )
        start = time.perf_counter()
        answer = client.post(REQUESTS, made.pem, PEM_FILE)
        self.waited = time.perf_counter() - start
        self.has(Bundle.from_bytes(answer.body).enclaves[self.name]["cert.pem"], key)


class Spent(NamedTuple):
    """Seconds: of the clock, and of a processor by the processes."""

    wall: float
    signer: float
    front: float
    robots: float


def spent(server: BenchServer, action: Callable[[], object]) -> Spent:
    """What `action` takes."""
    names = server.processes()
    before, own, start = cpu(names), time.process_time(), time.perf_counter()
    action()
    wall, own, after = time.perf_counter() - start, time.process_time() - own, cpu(names)
    return Spent(wall, **{each: after[each] - before[each] for each in names}, robots=own)


def cpu(processes: dict[str, int]) -> dict[str, float]:
    """Seconds of a processor that each, and those that it waited for, has had."""
    found = {}
    for name, pid in processes.items():
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        found[name] = sum(map(int, fields[11:15])) / TICK
    return found


class Floor(NamedTuple):
    """Seconds of the clock and of a processor, for each robot."""

    wall: float
    cpu: float


@contextmanager
def timed(times: list[Floor], count: float) -> Iterator[None]:
    """Add what one of `count` takes in the block."""
    wall, own = time.perf_counter(), time.process_time()
    yield
    found = time.perf_counter() - wall, time.process_time() - own
    times.append(Floor(*(each / count for each in found)))


_COLUMNS = ("each s", "ms", "signer", "front", "robots", "prims", "commits", "x", "x cpu")
HEAD = f"{'ledger':<20} {'seconds':>8}" + "".join(f"{each:>8}" for each in _COLUMNS)


def measure(kind: str, server: BenchServer, options) -> None:
    """Let all enrol, unless `pqsec apply` did it, and then renew."""
    trust = ServerTrust(pins=server.pins())
    robots = [Robot(f"/fleet/r{each + 1}", server, trust) for each in range(options.robots)]
    if options.renew_only:
        apply(server, robots)
    found = {}
    with server.running():
        if options.renew_only:
            all_ask(robots[: options.warm_up], options)
        else:
            token = server.token("/fleet/*", uses=len(robots))
            found["enrolled"] = spent(server, lambda: all_ask(robots, options, token))
        found["renewed"] = spent(server, lambda: all_ask(robots, options))
    refuse_missing(server, 2 * len(robots) + options.renew_only * len(robots[: options.warm_up]))
    commits = commit(server.keystore, options.at_once)
    for what, each in found.items():
        raw = primitives(server, shows=what == "renewed")
        show((kind, what), each, count=len(robots), raw=raw, commits=commits)
    if options.renew_only:
        show_target(found["renewed"], [each.waited for each in robots])


def apply(server: BenchServer, robots: list[Robot]) -> None:
    """Give each robot its first certificate."""
    members = read_domain(server.folder / "domain.yaml").members
    keys = {}
    for each in robots:
        keys[each.name], made = each.request()
        deliver_request(members[each.name], made)
    server.cli("apply", "domain.yaml", "--yes")
    for each in robots:
        path = server.root / "enclaves" / each.name[1:] / "cert.pem"
        each.has(path.read_bytes(), keys[each.name])


def all_ask(robots: list[Robot], options, token=None) -> None:
    """Each once, so many at once as the options say."""
    with ThreadPoolExecutor(options.at_once) as pool:
        for _ in pool.map(lambda each: each.ask(token), robots):
            pass


def refuse_missing(server: BenchServer, wanted: int) -> None:
    """Every request has a certificate of its own."""
    lines = server.keystore.ledger()
    serials = {each.serial for each in lines if each.kind == "participant"}
    if len(serials) != wanted:
        raise SystemExit(f"{len(serials)} certificates for {wanted} requests")


def show_target(found: Spent, waited: list[float]) -> None:
    """Whether 10,000 would have taken at most ten minutes."""
    rate = len(waited) / found.wall
    cuts = quantiles(waited, n=100, method="inclusive")
    print(f"  {rate:.1f} renewals a second: {'at least' if rate >= LEAST_RATE else 'NOT'}", end="")
    print(f" the {LEAST_RATE:.1f} of 10,000 in ten minutes ({10_000 / rate:.0f} s);", end="")
    print(f" robots waited {cuts[49]:.2f} s (median), {cuts[98]:.2f} s (99 %), {max(waited):.2f} s")


def show(titles: tuple[str, str], found: Spent, *, count: int, raw: Floor, commits: Floor) -> None:
    wall, *each = (1000 * seconds / count for seconds in found)
    floor = 1000 * (raw.wall + commits.wall)
    processors = 1000 * (raw.cpu + commits.cpu)
    columns = (count / found.wall, wall, *each, 1000 * raw.cpu, 1000 * commits.cpu)
    print(f"{titles[0]:<11}{titles[1]:<9} {found.wall:8.1f}", end="")
    print("".join(f"{column:8.2f}" for column in columns), end="")
    print(f"{wall / floor:8.2f}{sum(each) / processors:8.2f}")


def primitives(server: BenchServer, *, shows: bool) -> Floor:
    """Those of one robot, in one thread; `shows`: it shows a certificate in TLS."""
    profile, authorities = server.keystore.profile, server.keystore.unlock(None)
    kinds = [kind for kind in (profile.participant_key, profile.alternative_key) if kind]
    identity, permissions = authorities.identity, authorities.permissions
    there = context(server, SSL.TLS_SERVER_METHOD)
    here = context(server, SSL.TLS_CLIENT_METHOD, own=shows)
    times: list[Floor] = []
    with timed(times, TRIES):
        for _ in range(TRIES):
            for kind in kinds:
                key = kind.generate()
                key.public_key.verify(key.sign(REQUEST), REQUEST)
            for signer, content in ((identity, CERTIFICATE), (permissions, DOCUMENT)):
                signer.key.public_key.verify(signer.key.sign(content), content)
            connected(there, here)
    return times[0]


def context(server: BenchServer, method: int, *, own: bool = True) -> SSL.Context:
    """For one side of TLS that verifies nothing but the other's possession of its key."""
    made = SSL.Context(method)
    made.set_min_proto_version(SSL.TLS1_3_VERSION)
    made.set_session_cache_mode(SSL.SESS_CACHE_OFF)
    made.set_options(SSL.OP_NO_TICKET)
    made.set_verify(SSL.VERIFY_PEER, lambda *_: True)
    if own:
        made.use_certificate_chain_file(str(server.folder / "0.pem"))
        made.use_privatekey_file(str(server.folder / "0.key"))
    return made


def commit(keystore: Keystore, shared_by: int) -> Floor:
    """A change of one line, and the head over it."""
    times: list[Floor] = []
    authorities = keystore.unlock(None)
    with timed(times, COMMITS * shared_by):
        for number in range(COMMITS):
            at = datetime.now(UTC).isoformat(timespec="seconds")
            with change(keystore.root, authorities) as transaction:
                transaction.record(Entry(at, "receipt", "/bench", None, f"{number:064x}", None))
    return times[0]


if __name__ == "__main__":
    main()
