"""Credentials made by this project, for other implementations to judge, and their tools.

A lab is a keystore with two participants, /lab/alice and /lab/bob: in the folder of each
are the six files that a DDS stack reads.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.algorithms import PROFILES, Family, Profile, profile_named
from pqsec_pki.documents import DomainRange, DomainSet, Grant, Permissions
from pqsec_pki.keystore import Authorities, Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.trial import Installation, MissingStackError, find
from tests.docs.forking import Forks
from tests.interop.cyclone import find_plugins, plugins_of
from tests.interop.est_clients import SUITES, Clients, clients_in, root_of
from tests.interop.fastdds_meeting import Both, meeting
from tests.interop.fastdds_shim import FastDdsShim, build, find_compiler
from tests.interop.nodes import Nodes, compiled
from tests.interop.roots import ROOTS
from tests.interop.ros2 import Ros2
from tests.interop.tokens import SOFTHSM, SPY, Token
from tests.postgres import PROGRAMS, Cluster

YEAR = timedelta(days=365)
DOMAINS = DomainSet.of(DomainRange(first=0, last=10))
TOPIC = "rt/chatter"


def _with_rsa() -> Profile:
    keys = ("identity_key", "permissions_key", "participant_key")
    return profile_named("classical").changed(dict.fromkeys(keys, "rsa-2048"))


LAB_PROFILES = {profile.name: profile for profile in PROFILES} | {"classical rsa": _with_rsa()}
STOCK = [name for name, profile in LAB_PROFILES.items() if profile.runs_in_stock]
"""Profiles that stock stacks must take."""
NOT_STOCK = [name for name in LAB_PROFILES if name not in STOCK]
ML_DSA_ONLY = [name for name in NOT_STOCK if LAB_PROFILES[name].identity_key.family is Family.PQ]


def permissions_of(subject: str, now: datetime, *, domains: DomainSet = DOMAINS) -> bytes:
    """A permissions document for CN=`subject`, from a day before `now`, for 30 days."""
    grant = Grant.least(
        subject_name=f"CN={subject}",
        not_before=now - timedelta(days=1),
        not_after=now + timedelta(days=30),
        domains=domains,
        publish=[TOPIC],
        subscribe=[TOPIC],
    )
    return Permissions(grants=(grant,)).to_xml()


@dataclass(frozen=True)
class Lab:
    """A keystore with two participants, and its CAs unlocked."""

    keystore: Keystore
    authorities: Authorities
    now: datetime

    @classmethod
    def create(cls, root: Path, profile: Profile, now: datetime) -> "Lab":
        options = {"domains": DOMAINS, "validity": 10 * YEAR, "now": now}
        keystore = Keystore.create(root, profile, name="Lab", passphrase=None, **options)
        lab = cls(keystore, keystore.unlock(None), now)
        may = {"publish": (TOPIC,), "subscribe": (TOPIC,), "domains": DOMAINS, "validity": YEAR}
        specs = [ParticipantSpec(name=name, **may) for name in ("/lab/alice", "/lab/bob")]
        issue(keystore, lab.authorities, specs, now=now)
        return lab

    @property
    def alice(self) -> Path:
        return self.keystore.root / "enclaves" / "lab" / "alice"

    @property
    def bob(self) -> Path:
        return self.keystore.root / "enclaves" / "lab" / "bob"

    def sign(self, document: bytes) -> bytes:
        """`document`, signed as the keystore's own documents are."""
        return self.authorities.sign(document, now=self.now)


@pytest.fixture(scope="session")
def labs(tmp_path_factory, now) -> Callable[[str], Lab]:
    """labs("transition") is that profile's lab, made once."""
    folder = tmp_path_factory.mktemp("labs")
    return cache(lambda name: Lab.create(folder / name, LAB_PROFILES[name], now))


@pytest.fixture(scope="session")
def other_labs(tmp_path_factory, now) -> Callable[[str], Lab]:
    """Labs of somebody else: same names, same algorithms, other keys."""
    folder = tmp_path_factory.mktemp("other-labs")
    return cache(lambda name: Lab.create(folder / name, LAB_PROFILES[name], now))


@pytest.fixture
def enclave(tmp_path) -> Callable[..., Path]:
    """enclave(folder, **{"key.pem": bytes}) is a copy of the folder with files replaced."""
    count = iter(range(100))

    def copy(original: Path, replaced: dict[str, bytes]) -> Path:
        folder = tmp_path / f"enclave{next(count)}"
        shutil.copytree(original, folder)
        for name, content in replaced.items():
            (folder / name).write_bytes(content)
        return folder

    return copy


@pytest.fixture
def put(tmp_path) -> Callable[[str, bytes], Path]:
    """put(name, content) is the path of a file with that content."""

    def write(name: str, content: bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return write


@dataclass(frozen=True)
class OpenSSL:
    """An openssl command."""

    path: str
    version: tuple[int, int]

    @classmethod
    def at(cls, path: str) -> "OpenSSL | None":
        text = subprocess.run([path, "version"], capture_output=True, text=True, check=True).stdout
        found = re.match(r"OpenSSL (\d+)\.(\d+)", text)
        return cls(path, (int(found[1]), int(found[2]))) if found else None

    def __call__(self, *arguments: str | Path, stdin: bytes = b"") -> bytes:
        """Its output; AssertionError with its words if it fails."""
        done = self._run(arguments, stdin)
        assert done.returncode == 0, f"{arguments}: {done.stderr.decode()}"
        return done.stdout

    def refuses(self, *arguments: str | Path) -> str:
        """Its words on refusing; AssertionError if it does not."""
        done = self._run(arguments, b"")
        assert done.returncode != 0, f"{arguments}: accepted"
        return done.stderr.decode()

    def _run(self, arguments, stdin: bytes) -> subprocess.CompletedProcess[bytes]:
        command = [self.path, *map(str, arguments)]
        return subprocess.run(command, input=stdin, capture_output=True, timeout=300, check=False)


@pytest.fixture(scope="session")
def plugins(requires) -> Path:
    """The folder of Cyclone DDS's security plugins."""
    remedy = "apt-get install libddsc0debian"
    return requires(find_plugins(), "Cyclone DDS's security plugins", remedy)


@pytest.fixture(scope="session")
def plugins_11(requires) -> Path:
    """The folder of the plugins of Cyclone DDS 11.0."""
    remedy = "PQSEC_CYCLONEDDS_11 names the prefix of a build of 11.0 with security"
    prefix = requires(os.environ.get("PQSEC_CYCLONEDDS_11"), "Cyclone DDS 11.0", remedy)
    return plugins_of(Path(prefix), "11.0")


@pytest.fixture(scope="session")
def cluster(requires) -> Iterator[Cluster]:
    """A PostgreSQL server, for tests with a database each."""
    requires(PROGRAMS, "PostgreSQL", "apt-get install postgresql")
    with Cluster.created() as made:
        yield made


@pytest.fixture(scope="session")
def fastdds(requires) -> FastDdsShim:
    """Fast DDS's security plugins, behind a shim that is compiled for them."""
    remedy = "apt-get install --no-install-recommends g++ libfastrtps-dev"
    compiler = requires(find_compiler(), "g++ with Fast DDS's headers", remedy)
    return build(compiler)


@pytest.fixture(scope="session")
def stack_in(requires) -> Callable[[str, str], Installation]:
    """stack_in("fastdds", "trixie") is the Fast DDS that is there."""

    def of(stack: str, where: str) -> Installation:
        try:
            return find(stack, ROOTS[where])
        except MissingStackError as error:
            return requires(None, f"{stack} of {where}", f".ci/trixie, or {error.hint}")

    return of


@pytest.fixture(scope="module")
def selected(request) -> Callable[[str], set]:
    """selected("name") is the set of values that the tests of the module, of those that this run
    has selected, have for `name`: what a fixture begins for all of them at once is begun for these.
    """

    def values(argument: str) -> set:
        tests = [item for item in request.session.items if item.path == request.path]
        parameters = [item.callspec.params for item in tests if hasattr(item, "callspec")]
        return {each[argument] for each in parameters if argument in each}

    return values


@pytest.fixture
def meet_fastdds(fastdds, labs, enclave) -> Callable[..., Both]:
    """meet_fastdds(profile, we=name) lets us and Fast DDS meet in that lab; bob will begin.

    `ours` and `theirs` are files in place of the lab's.
    """
    with ExitStack() as stack:

        def meet(profile="transition", *, we, theirs=(), **options) -> Both:
            peer = "bob" if we == "alice" else "alice"
            here, there = (labs(profile).alice.with_name(name) for name in (we, peer))
            both = meeting(fastdds, here, enclave(there, dict(theirs)), **options)
            return stack.enter_context(both)

        yield meet


@pytest.fixture(scope="session")
def ros2(requires) -> Ros2:
    """ROS 2's client library for Python."""
    return requires(Ros2.find(), "ROS 2's wheels", "run .ci/ros2, or set PQSEC_ROS2")


@pytest.fixture(scope="session")
def nodes(requires, ros2, plugins, tmp_path_factory) -> Nodes:
    """Real nodes on Cyclone DDS."""
    remedy = "apt-get install --no-install-recommends g++ cyclonedds-dev cyclonedds-tools"
    folder = tmp_path_factory.mktemp("nodes")
    return Nodes(ros2, requires(compiled(ros2, folder), "g++ and idlc", remedy), folder)


@pytest.fixture(scope="session")
def openssl(requires) -> OpenSSL:
    """The system's OpenSSL, which the system's DDS stacks use too."""
    path = requires(shutil.which("openssl"), "openssl", "apt-get install openssl")
    return requires(OpenSSL.at(path), "openssl", "what is installed is something else")


@pytest.fixture(scope="session")
def forks() -> Iterator[Forks]:
    """Runs pqsec in forks of one process. Each is new to a token's library."""
    with Forks.started("pkcs11") as found:
        yield found


@pytest.fixture
def token(requires, tmp_path, forks) -> Token:
    """A new token of SoftHSM."""
    requires(SOFTHSM if SOFTHSM.exists() else None, "SoftHSM", "apt-get install softhsm2")
    requires(SPY, "OpenSC", "apt-get install opensc opensc-pkcs11")
    return Token.softhsm(tmp_path, forks)


@pytest.fixture(scope="session")
def openssl35(requires) -> OpenSSL:
    """An OpenSSL that knows ML-DSA."""
    cached = Path.home() / ".cache" / "pqsec-ci" / "openssl35" / "openssl"
    places = [os.environ.get("PQSEC_OPENSSL35"), shutil.which(cached), shutil.which("openssl")]
    tools = [OpenSSL.at(place) for place in places if place]
    good = [tool for tool in tools if tool and tool.version >= (3, 5)]
    remedy = "run .ci/openssl35, or set PQSEC_OPENSSL35 to the command"
    return requires(good[0] if good else None, "OpenSSL 3.5", remedy)


@pytest.fixture
def any_openssl(request, openssl, openssl35) -> OpenSSL:
    """The one or the other: parametrise it, indirectly, with "system" and "3.5"."""
    return {"system": openssl, "3.5": openssl35}[request.param]


@pytest.fixture(params=SUITES)
def est_clients(request, requires) -> Iterator[Clients]:
    """EST clients of others, and a server."""
    suite = request.param
    remedy = f"run .ci/est-clients {suite}"
    with clients_in(requires(root_of(suite), f"EST clients of Debian {suite}", remedy)) as found:
        yield found
