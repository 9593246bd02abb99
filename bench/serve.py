"""Robots that enrol at a running `pqsec serve` and renew there, against primitives and commits.

All is on this machine: the server's two processes, and the robots as threads of this one, which
make their keys and ask as `pqsec enrol` does. The floor is measured in the same run, in one thread:

- of each robot the raw primitives: a key, a handshake of TLS (both sides; a renewal shows a
  certificate too), the request's signature and its verification, the signatures of certificate and
  permissions, and one verification of each signature in the bundle;
- the commits that are needed if all who ask at once get one: robots / robots at once, each as long
  as a change of one line takes at the end, with a ledger of that size.

An answer follows its commit. `ms` is the time of the clock for each robot, the columns after it are
milliseconds of a processor: of both processes of the server and of the robots, then the floor. `x`
is the time of the clock over that of the floor, `x cpu` all processor time over the floor's.
Run: python bench/serve.py [--robots 300] [--at-once 32] [--profile pq] [--folder DIR]
         [file] [postgresql]
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple

from OpenSSL import SSL

from pqsec_pki.algorithms import private_key_pem, profile_named
from pqsec_pki.certificates import certificate_request
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import Bundle
from pqsec_pki.est import PEM_FILE, REQUESTS, EstClient, ServerTrust, TlsIdentity
from pqsec_pki.keystore import Entry, Keystore, LedgerAddress, change
from tests.postgres import Cluster
from tests.unit.serving import HOST, Server
from tests.unit.tls_sides import connected

TRIES, COMMITS = 100, 20
REQUEST, CERTIFICATE, DOCUMENT = bytes(2200), bytes(2400), bytes(200)
"""About what a signature of each kind covers."""
SIGNED_IN_BUNDLE = 3
"""Certificate, permissions, governance."""
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
    options = parser.parse_args()
    print(f"{len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f};", end=" ")
    print(f"{options.robots} robots, {options.at_once} at once, profile {options.profile}")
    print(HEAD)
    for kind in options.ledgers or ["file"]:
        with tempfile.TemporaryDirectory(dir=options.folder) as folder, ledger_of(kind) as ledger:
            measure(kind, BenchServer(Path(folder), ledger, options), options)


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

    def ask(self, token=None) -> None:
        """Enrol with a token, or renew."""
        key = self._profile.participant_key.generate()
        second = self._profile.alternative_key
        made = certificate_request(self.name, key, second.generate() if second else None)
        client = EstClient(
            server=self._url,
            trust=self._trust,
            identity=None if token else self._identity,
            secret=(token.id, token.secret) if token else None,
        )
        answer = client.post(REQUESTS, made.pem, PEM_FILE)
        files = Bundle.from_bytes(answer.body).enclaves[self.name]
        self._identity = TlsIdentity(files["cert.pem"], private_key_pem(key))


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
    """Let all enrol, and then renew."""
    with server.running():
        trust = ServerTrust(pins=server.pins())
        count = options.robots
        robots = [Robot(f"/fleet/r{each + 1}", server, trust) for each in range(count)]
        token = server.token("/fleet/*", uses=count)

        def all_ask(token=None) -> None:
            with ThreadPoolExecutor(options.at_once) as pool:
                for _ in pool.map(lambda each: each.ask(token), robots):
                    pass

        enrolled, renewed = spent(server, lambda: all_ask(token)), spent(server, all_ask)
    lines = server.keystore.ledger()
    serials = {each.serial for each in lines if each.kind == "participant"}
    if len(serials) != 2 * count:
        raise SystemExit(f"{len(serials)} certificates for {2 * count} requests")
    commits = commit(server.root, options.at_once)
    for what, found, shows in (("enrolled", enrolled, False), ("renewed", renewed, True)):
        raw = primitives(server, shows=shows)
        show((kind, what), found, count=count, raw=raw, commits=commits)


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
            signature = identity.key.sign(CERTIFICATE)
            permissions.key.sign(DOCUMENT)
            for _ in range(SIGNED_IN_BUNDLE):
                identity.key.public_key.verify(signature, CERTIFICATE)
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


def commit(root: Path, shared_by: int) -> Floor:
    """A change of one line."""
    times: list[Floor] = []
    with timed(times, COMMITS * shared_by):
        for number in range(COMMITS):
            at = datetime.now(UTC).isoformat(timespec="seconds")
            with change(root) as transaction:
                transaction.record(Entry(at, "receipt", "/bench", None, f"{number:064x}", None))
    return times[0]


if __name__ == "__main__":
    main()
