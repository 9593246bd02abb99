"""What changes under participants that live: revocations, forks, and agents of other versions."""

import os
import shutil
import subprocess
import sys
import time
from ctypes import CFUNCTYPE, c_void_p
from pathlib import Path

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.lifecycle import renew_list, revoke
from pqsec_pki.plugin import agent_status, stop_agent
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.trial import MissingStackError, find
from tests.interop.conftest import LAB_PROFILES, Lab
from tests.interop.cyclone import Participant, RefusedError, participant
from tests.interop.cyclone_abi import ACCESS_CONTROL, started
from tests.interop.cyclone_types import Byte, Handle
from tests.interop.plugin.processes import DOMAIN, Stage
from tests.interop.plugin.test_plugin_dds import hosted, wait_for
from tests.interop.plugin.test_plugin_robust import (
    HERE,
    SANITIZERS,
    Authentication,
    Listener,
    compiled,
)
from tests.unit.plugin_wire import FILES

pytestmark = pytest.mark.interop

PATIENCE = 120.0
"""Seconds; the library looks every five."""


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


@pytest.fixture
def lab(tmp_path, now):
    """One where everybody has a revocation list, and bob a copy of his files without one."""
    found = Lab.create(tmp_path / "lab", LAB_PROFILES["transition"], now)
    renew_list(found.keystore, found.authorities, now=now)
    return found


@pytest.fixture
def careless(lab, tmp_path):
    folder = shutil.copytree(lab.bob, tmp_path / "careless")
    (folder / "crl.pem").unlink()
    return folder


def take_back(lab, name):
    revoke(lab.keystore, lab.authorities, [name], reason=Reason.KEY_COMPROMISE, now=lab.now)


@pytest.mark.slow
def test_the_stack_is_told_of_a_peer_that_is_revoked(shim, lab, careless):
    told = []
    listen = Listener(
        CFUNCTYPE(Byte, c_void_p, Handle)(lambda plugin, handle: told.append(handle) or 1)
    )
    access_library = shim.folder / "libdds_security_ac.so"
    library = shim.folder / "libdds_security_auth.so"
    with (
        started(library, "authentication", Authentication) as authentication,
        started(access_library, "access_control", ACCESS_CONTROL) as access,
        participant(shim.folder, careless) as bob,
    ):
        authentication.call("set_listener", listen)
        alice = Participant(authentication, access, lab.alice, "")
        for one in (alice, bob):
            one.show(*one.join(0))
        first, other = sorted((alice, bob), key=lambda one: one.guid)
        seen = other.meet(first.guid, first.identity_token)
        known = first.meet(other.guid, other.identity_token, seen.auth_request)
        begun, request = first.request(known)
        answered, reply = other.reply(seen, request)
        other.process(answered, first.process(begun, reply))
        first.secret(begun), other.secret(answered)
        assert told == []
        take_back(lab, "/lab/bob")
        until(lambda: told)
        assert told == [known.handle if first is alice else seen.handle]
        authentication.call("set_listener", None)


@pytest.fixture
def neighbours(requires, tmp_path):
    """A host that prints which peers it meets and loses."""
    try:
        find("cyclonedds")
    except MissingStackError as error:
        requires(None, "Cyclone DDS to compile against", error.hint or str(error))
    return compiled(tmp_path / "neighbours", HERE / "neighbours.c", "-lddsc")


@pytest.fixture
def living(neighbours, shim, plugins, tmp_path):
    """living(enclave) is such a host, half a minute long, whomever it loses."""
    program = neighbours
    (tmp_path / "xml").mkdir()
    stage = Stage(None, shim, plugins, tmp_path / "xml")

    def host(enclave):
        return hosted([program, str(DOMAIN), "30+"], stage.environment(enclave))

    return host


def _have_met(place):
    status = agent_status(place)  # None while the hosts start it
    connections = status.connections if status else ()
    rights = [each["objects"] for each in connections if each["plugin"] == "access_control"]
    return rights == [2, 2]  # its own and its peer's


def test_cyclone_parts_from_a_peer_that_is_revoked_in_mid_session(shim, lab, careless, living):
    """While the peer, whose file names no list, still is there."""
    with living(careless) as bob, living(lab.alice) as alice:
        until(lambda: _have_met(shim.place))
        take_back(lab, "/lab/bob")
        wait_for(alice, "lost")
        assert bob.poll() is None


NOT_MADE = 3
PLAIN = "<CycloneDDS><Domain id='any'><General><AllowMulticast>false</AllowMulticast></General>"


def _all_properties(shim, own, enclave):
    """What an application gives Cyclone DDS, which takes all or nothing from its file."""
    libraries = {
        "auth": (shim.folder / "libpqsec_dds.so", "authentication"),
        "access": (shim.folder / "libpqsec_dds.so", "access_control"),
        "crypto": (own / "libdds_security_crypto.so", "crypto"),
    }
    for kind, (path, name) in libraries.items():
        yield f"dds.sec.{kind}.library.path", str(path)
        yield f"dds.sec.{kind}.library.init", f"init_{name}"
        yield f"dds.sec.{kind}.library.finalize", f"finalize_{name}"
    for name, file in FILES.items():
        yield name, f"file:{enclave / file}"


def test_cyclone_passes_on_the_properties_of_an_application_and_none_is_passed_over(
    neighbours, shim, lab, plugins
):
    """A list by another stack's name counts: bob's takes bob back. A name that nobody knows ends
    it."""
    take_back(lab, "/lab/bob")
    there = f"file:{lab.bob / 'crl.pem'}"
    found = {}
    for name, value in {
        "role": "camera",
        "org.eclipse.cyclonedds.sec.auth.crl": there,
        "dds.sec.auth.builtin.PKI-DH.identity_crl": there,
        "dds.sec.auth.crl": there,
        "dds.sec.auth.crll": there,
        "pqsec.typo": "",
    }.items():
        pairs = [*_all_properties(shim, plugins, lab.bob), (name, value)]
        words = [word for pair in pairs for word in pair]
        done = subprocess.run(
            [neighbours, str(DOMAIN), "0", *words],
            env=os.environ | {"CYCLONEDDS_URI": f"{PLAIN}</Domain></CycloneDDS>"},
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        words = "revoked", "did you mean", "is unknown"
        found[name] = done.returncode, *(word for word in words if word in done.stderr)
    revoked = (NOT_MADE, "revoked")
    assert found == {
        "role": (0,),
        "org.eclipse.cyclonedds.sec.auth.crl": revoked,
        "dds.sec.auth.builtin.PKI-DH.identity_crl": revoked,
        "dds.sec.auth.crl": revoked,
        "dds.sec.auth.crll": (NOT_MADE, "did you mean", "is unknown"),
        "pqsec.typo": (NOT_MADE, "is unknown"),
    }


def test_a_host_that_forks_keeps_its_thread_and_the_child_needs_none(requires, tmp_path):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    sources = (
        "-I",
        SOURCES,
        HERE / "fork.c",
        *(SOURCES / f"{each}.c" for each in ("watch", "wire", "frames")),
    )
    program = compiled(tmp_path / "fork", *SANITIZERS, *sources)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "both\n", "")


def test_a_child_of_a_host_has_a_connection_of_its_own(shim, labs):
    """And what it does or how it ends leaves the parent's participant as it is."""
    lab = labs("pq")
    with participant(shim.folder, lab.alice) as one:
        child = os.fork()
        if child == 0:
            good = False
            try:
                with pytest.raises(RefusedError, match="agent was lost"):
                    one.meet(one.guid, one.identity_token)
                with participant(shim.folder, lab.bob) as other:
                    good = bool(other.join(0))
            finally:
                os._exit(not good)
        assert os.waitpid(child, 0)[1] == 0
        assert one.join(0)


def test_an_agent_of_another_version_is_refused_with_the_way_out_and_left_alone(shim, labs):
    stop_agent(shim.place)
    script = Path(__file__).with_name("other_version.py")
    other = subprocess.Popen([sys.executable, script, str(shim.place.socket)])
    try:
        until(lambda: agent_status(shim.place))
        with (
            pytest.raises(RefusedError, match=r"pqsec plugin install.*pqsec agent stop"),
            participant(shim.folder, labs("pq").alice),
        ):
            pass
        assert agent_status(shim.place).process == other.pid
        assert stop_agent(shim.place)
        assert other.wait(PATIENCE) == 0
    finally:
        other.kill()
        other.wait()
    with participant(shim.folder, labs("pq").alice) as one:
        assert one.join(0)
