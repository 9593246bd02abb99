"""Fast DDS with our plugin fails closed: whatever is missing, no participant runs without security.

Each participant is a process, configured by export, in which one thing is not as it should be.
"""

import json
import os
import re
import shutil
import stat
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pqsec_pki.plugin import AgentFolder, stop_agent
from pqsec_pki.trial import (
    Act,
    Installation,
    Trial,
    TrialPlugin,
    TrialRole,
    built,
    credentialed,
    unauthenticated,
    unique_text,
)
from pqsec_pki.trial.building import run_tool, source
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.fastdds_adapter import (
    ADAPTER,
    RECORD,
    Compilers,
    commands,
    compile_adapter,
    here,
    install,
    installed,
    sources,
)
from pqsec_pki.vendors.fastdds_library import PLUGINS, AdapterError, FastDds, examine, table_of
from pqsec_pki.vendors.own_plugin import PRELOAD
from tests.interop.conftest import TOPIC
from tests.interop.kept import kept
from tests.interop.plugin.conftest import Shim
from tests.interop.plugin.test_plugin_dds import ended, hosted, wait_for
from tests.interop.plugin.test_plugin_impostors import BEHAVIOURS, listening
from tests.interop.plugin.test_plugin_try import ROOTS

pytestmark = pytest.mark.interop

HOST = Path(__file__).with_name("host.c")
DOMAIN, LONGEST = 5, 60.0
AS_NOBODY = ("setpriv", "--reuid=65534", "--clear-groups")
NAMES = ("dds.sec.auth.plugin", "dds.sec.access.plugin", "dds.sec.crypto.plugin")


@dataclass(frozen=True)
class Stage:
    """A participant that would be good, and what runs it."""

    installation: Installation
    plugin: TrialPlugin
    role: TrialRole
    other: TrialRole
    """A peer, that sends."""
    folder: Path

    @property
    def program(self) -> list[str]:
        return self.installation.peer(built(self.installation))

    @property
    def profile(self) -> Path:
        """Its configuration."""
        return Path(self.role.environment[self.installation.build.variable])

    def run(
        self, *, without: str = "", program: list[str] | None = None, **variables: str
    ) -> "Outcome":
        """What came of it: it ends when it is refused, and soon after it has joined."""
        environment = {**os.environ, **self.role.environment, **variables}
        environment.pop(without, None)
        done = subprocess.run(
            [*(program or self.program), Act.RECEIVE.value, str(DOMAIN), TOPIC, "", "0.3"],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=LONGEST,
            check=False,
        )
        return Outcome(done.returncode, done.stdout.decode(errors="replace"))


@dataclass(frozen=True)
class Outcome:
    """How it ended, and what it said."""

    code: int
    log: str

    @property
    def joined(self) -> bool:
        return self.code == 0 and "joined" in self.log.splitlines()


@pytest.fixture
def trial(request, stack_in, plugin_for, labs, now) -> Trial:
    """In Debian 12, or where the parameter says."""
    where = getattr(request, "param", "bookworm")
    return Trial(
        installation=stack_in("fastdds", where),
        keystore=labs("pq").keystore,
        timeout=LONGEST,
        plugin=plugin_for(where),
        now=now,
    )


@pytest.fixture
def stage(trial, tmp_path) -> Stage:
    role = credentialed(trial, "/lab/alice", Act.RECEIVE, tmp_path / "alice", unique_text())
    other = credentialed(trial, "/lab/bob", Act.SEND, tmp_path / "bob", unique_text())
    return Stage(trial.installation, trial.plugin, role, other, tmp_path)


EVERYWHERE = pytest.mark.parametrize("trial", ROOTS, indirect=True)


@pytest.fixture
def copied(stage) -> Path:
    """A copy of the plugin's folder, to be spoilt."""
    return Path(shutil.copytree(stage.plugin.folder, stage.folder / "plugin"))


def refused(outcome: Outcome, *words: str) -> bool:
    """Whether its own stack made no participant, with these words, and it did not crash."""
    assert "joined" not in outcome.log.splitlines(), outcome.log
    assert all(each in outcome.log for each in words), outcome.log
    assert "refused participant" in outcome.log, outcome.log
    return outcome.code == 3


@pytest.mark.slow(but=1)
@EVERYWHERE
def test_with_the_plugin_it_joins(stage):
    assert stage.run().joined


@pytest.mark.slow(but=1)
@EVERYWHERE
def test_without_the_preload_library_its_own_plugin_refuses_post_quantum_keys(stage):
    assert refused(stage.run(without="LD_PRELOAD"))


@EVERYWHERE
def test_without_an_adapter_for_this_build_it_is_refused_with_the_way_out(stage, copied):
    build = stage.installation.library.build_id
    (copied / ADAPTER.format(build)).unlink()
    outcome = stage.run(LD_PRELOAD=str(copied / PRELOAD))
    assert refused(outcome, "was not compiled for this build of", "pqsec plugin install fastdds")


def test_a_relative_path_in_ld_preload_is_refused(stage, copied):
    """The adapter would be looked for below whatever folder the process works in."""
    outcome = stage.run(LD_PRELOAD=str(copied.relative_to(stage.folder) / PRELOAD))
    assert refused(outcome, "LD_PRELOAD must name pqsec's plugin by its absolute path")


@EVERYWHERE
def test_an_adapter_of_another_build_under_this_ones_name_is_refused(stage, copied):
    build = stage.installation.library.build_id
    path = copied / ADAPTER.format(build)
    other = build[::-1].encode()
    path.write_bytes(path.read_bytes().replace(build.encode(), other))
    outcome = stage.run(LD_PRELOAD=str(copied / PRELOAD))
    assert refused(outcome, "is for another build than")


@pytest.fixture
def updated(stage) -> Path:
    """The same Fast DDS with another build ID, as after an update."""
    library = stage.installation.library
    path = stage.folder / library.path.name
    octets = library.path.read_bytes()
    build = bytes.fromhex(library.build_id)
    assert octets.count(build) == 1
    path.write_bytes(octets.replace(build, build[::-1]))
    return path


def test_after_an_update_of_fast_dds_it_is_refused_until_installed_again(stage, updated, copied):
    preload = f"{copied / PRELOAD}:{updated}"  # the peer loads that one
    outcome = stage.run(LD_PRELOAD=preload)
    assert refused(outcome, f"was not compiled for this build of {updated}")
    record = copied / RECORD.format(stage.installation.library.build_id)
    record.write_text(json.dumps(json.loads(record.read_text()) | {"library": str(updated)}))
    [found] = installed(copied)
    assert found.problem == "the library was updated since"


@EVERYWHERE
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", ["pqsec", ""])
def test_a_plugin_that_fast_dds_does_not_know_is_refused(stage, name, value):
    """It would run without it, and say nothing."""
    text = stage.profile.read_text()
    before = text.partition(f"<name>{name}</name>")[2].partition("</value>")[0]
    old = before.strip().removeprefix("<value>")
    changed = text.replace(f"<value>{old}</value>", f"<value>{value}</value>")
    if not value:
        changed = text.replace(f"<name>{name}</name>", "<name>role</name>")
    assert changed != text
    stage.profile.write_text(changed)
    said = f"{name} must be {old}" if value else f"{name} is missing"
    assert refused(stage.run(), said)


@EVERYWHERE
def test_a_participant_without_any_security_is_left_alone(stage):
    open_to_all = unauthenticated(stage.installation, Act.RECEIVE, stage.folder)
    assert stage.run(**open_to_all.environment).joined


@EVERYWHERE
@pytest.mark.parametrize("how", ["hangs up", "says nothing"])
def test_an_agent_that_does_not_answer_makes_it_fail(stage, tmp_path_factory, how):
    runtime = tmp_path_factory.mktemp("run")
    runtime.chmod(0o700)
    place = AgentFolder.of({"XDG_RUNTIME_DIR": str(runtime)})
    with listening(Shim(stage.folder, place), BEHAVIOURS[how][0]):
        outcome = stage.run(XDG_RUNTIME_DIR=str(runtime), PQSEC_AGENT_TIMEOUT="500")
    said = "the agent is gone" if how == "hangs up" else "does not answer within 500 ms"
    assert refused(outcome, said)


@pytest.mark.slow
def test_a_host_whose_agent_is_killed_goes_on_and_meets_nobody(stage):
    """It ends by itself, and another gets a new agent."""
    with TemporaryDirectory(prefix="pqsec-run-") as runtime:  # a socket's path must be short
        shim = Shim(stage.folder, AgentFolder.of({"XDG_RUNTIME_DIR": runtime}))
        environments = [
            {**each.environment, "XDG_RUNTIME_DIR": runtime} for each in (stage.role, stage.other)
        ]
        words = [
            [*stage.program, act.value, str(DOMAIN), TOPIC, text, "6"]
            for act, text in ((Act.RECEIVE, ""), (Act.SEND, stage.other.text))
        ]
        try:
            with hosted(words[0], environments[0]) as receiver:
                wait_for(receiver, "joined")
                shim.kill_agent()
                with hosted(words[1], environments[1]) as sender:
                    said = ended(receiver), ended(sender)
        finally:
            stop_agent(shim.place)
    assert "received" not in said[0]
    assert "the agent is gone" in said[0]
    assert "joined" in said[1]


def test_an_agents_folder_that_others_can_enter_is_refused(stage):
    runtime = stage.folder / "run"
    (runtime / "pqsec").mkdir(parents=True)
    (runtime / "pqsec").chmod(0o755)
    outcome = stage.run(XDG_RUNTIME_DIR=str(runtime))
    assert refused(outcome, "is not a folder of this user's alone")


AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root may give a program rights")


@AS_ROOT
@pytest.mark.parametrize("right", ["setuid", "capability"])
def test_a_program_that_has_more_rights_than_its_user_preloads_nothing_and_is_refused(
    stage, privileged, right
):
    outcome = stage.run(program=[*AS_NOBODY, privileged(Path(stage.program[0]), right)])
    assert refused(outcome)
    assert "pqsec:" not in outcome.log


@pytest.fixture
def privileged(tmp_path_factory, requires) -> Callable[[Path, str], str]:
    """privileged(program, "setuid") is a copy of it that runs as its owner for every user;
    with "capability", one that may read and write every file."""

    def copied(program: Path, right: str) -> str:
        open_to_all = tmp_path_factory.mktemp(right)
        for folder in (open_to_all, *open_to_all.parents[:2]):
            folder.chmod(0o755)
        copy = Path(shutil.copy(program, open_to_all / "peer"))
        copy.chmod(0o755 | (stat.S_ISUID if right == "setuid" else 0))
        if right == "capability":
            setcap = requires(shutil.which("setcap"), "setcap", "apt-get install libcap2-bin")
            subprocess.run([setcap, "cap_dac_override+ep", str(copy)], check=True)
        return str(copy)

    return copied


@pytest.fixture(scope="module")
def linked(plugin_for, fastdds_here) -> list[str]:
    """The command of a peer that is linked with our library, before Fast DDS."""
    library = plugin_for("bookworm").folder / PRELOAD
    first = f"-Wl,--no-as-needed,{library},--as-needed"
    words = ["g++", "-O0", first, "-o", "peer", "peer.cpp", "-lfastrtps"]
    return [str(peer(fastdds_here, source("fastdds.cpp"), words) / "peer")]


def peer(fastdds: Installation, program: bytes, *commands: list[str]) -> Path:
    """A folder in which these commands have compiled a peer."""
    header = source("fastdds_host.hpp")

    def make(folder: Path) -> None:
        (folder / "peer.cpp").write_bytes(program)
        (folder / "fastdds_host.hpp").write_bytes(header)
        for command in commands:
            subprocess.run(command, cwd=folder, check=True, capture_output=True)

    inputs = fastdds.library.build, program, header, HOST.read_bytes(), commands
    return kept("peer", inputs, make)


@pytest.mark.slow
def test_a_program_that_is_linked_with_it_needs_no_preloading(stage, linked):
    assert stage.run(without="LD_PRELOAD", program=linked).joined


@pytest.mark.slow(but=1)
@AS_ROOT
@pytest.mark.parametrize("right", ["setuid", "capability"])
def test_with_more_rights_it_runs_that_plugin_which_is_refused_the_agent(
    stage, linked, privileged, right
):
    """Who starts it may not run the agent of root, or has no folder for one."""
    program = privileged(Path(linked[0]), right)
    outcome = stage.run(without="LD_PRELOAD", program=[*AS_NOBODY, program])
    assert refused(outcome, "pqsec: ")


@pytest.fixture(scope="module")
def opened(fastdds_here) -> Callable[[str], list[str]]:
    """opened("deep") is what runs a peer in a library that is opened so."""
    program = source("fastdds.cpp").replace(b"int main(", b'extern "C" int run(')
    library = ["g++", "-O0", "-shared", "-fPIC", "-o", "libpeer.so", "peer.cpp", "-lfastrtps"]
    folder = peer(fastdds_here, program, library, ["gcc", "-o", "host", str(HOST), "-ldl"])
    return lambda how: [str(folder / "host"), how, str(folder / "libpeer.so")]


@pytest.mark.slow
def test_it_runs_in_a_library_that_was_opened_locally(stage, opened):
    """As ROS 2 opens its middleware."""
    assert stage.run(program=opened("local")).joined


@pytest.mark.slow
def test_a_library_that_binds_to_itself_first_gets_its_own_plugin_which_refuses(stage, opened):
    assert refused(stage.run(program=opened("deep")))


@EVERYWHERE
def test_each_function_that_the_preload_library_names_is_one_of_fast_dds(stage):
    """A letter too many, and the loader would silently never find it."""
    library = stage.installation.library.path
    space = b"8fastrtps" if "fastrtps" in library.name else b"7fastdds"
    octets = (stage.plugin.folder / PRELOAD).read_bytes()
    named = {each.decode() for each in re.findall(rb"_ZN8eprosima%s\w+" % space, octets)}
    assert len(named) == 10
    missing = named - read_symbols(library, ()).exported
    is_old = space == b"8fastrtps"
    # 2.9 does not wait for a second announcement.
    assert [each for each in missing if not (is_old and "PDP" in each)] == []


AUTHENTICATION = """validate_local_identity validate_remote_identity begin_handshake_request
begin_handshake_reply process_handshake get_shared_secret set_listener get_identity_token
return_identity_token return_handshake_handle get_identity_handle return_identity_handle
return_sharedsecret_handle set_permissions_credential_and_token
get_authenticated_peer_credential_token return_authenticated_peer_credential_token
check_guid_comes_from"""
ACCESS_CONTROL = """validate_local_permissions get_permissions_token return_permissions_token
get_permissions_credential_token return_permissions_credential_token get_permissions_handle
return_permissions_handle validate_remote_permissions check_create_participant
check_remote_participant check_create_datawriter check_create_datareader check_remote_datawriter
check_remote_datareader get_participant_sec_attributes get_datawriter_sec_attributes
get_datareader_sec_attributes"""
"""In the order in which later versions declare them; some have MORE."""
MORE = " get_participant_guid set_event_resource"


@pytest.mark.slow
@pytest.mark.parametrize("more", ["", MORE], ids=["no more", "two more"])
def test_an_adapter_that_is_told_of_other_functions_has_them_in_their_order(stack_in, more):
    """With the public headers of 3.1.2, and not run: test_fastdds_versions.py runs such versions.

    They tell their plugins of a participant by a PropertyPolicy."""
    installation = stack_in("fastdds", "trixie")
    stack = replace(
        examine(installation.library.path, installation.root),
        by_properties=True,
        more_functions=bool(more),
    )
    compilers = Compilers(c="gcc", cxx="g++", run=lambda words, folder: None)
    with TemporaryDirectory(dir=installation.root / "tmp") as name:
        folder = Path(name)
        for path in sources():
            shutil.copy(path, folder)
        place = f"/{folder.relative_to(installation.root)}"
        for words in commands(stack, compilers):
            assert run_tool(words[0], installation.tool(tuple(words), place)) == (0, "")
        names = [table_of(3, each) for each in PLUGINS.values()]
        adapter = folder / ADAPTER.format(stack.library.build_id)
        tables = read_symbols(adapter, names).tables
    for table, expected in zip(names, (AUTHENTICATION + more, ACCESS_CONTROL), strict=True):
        slots, functions = tables[table][2:], expected.split()  # after the destructors
        assert len(slots) == len(functions)
        for slot, function in zip(slots, functions, strict=True):
            assert any(f"{len(function)}{function}E" in each for each in slot), (slot, function)
        assert not any("RTPSParticipantAttributes" in each for slot in slots for each in slot)
        assert any("PropertyPolicy" in each for each in slots[0])


MOVED = {
    "the topic of a writer": ("WriterProxyData.h", "string_255 m_topicName;"),
    "the topic of a reader": ("ReaderProxyData.h", "string_255 m_topicName;"),
    "the partitions of a writer": ("WriterProxyData.h", "WriterQos m_qos;"),
}
"""A header of Fast DDS 2, and the member before which another build of the library has one more."""


@pytest.fixture(scope="module")
def of_another_build(fastdds_here, tmp_path_factory) -> Callable[[str], FastDds]:
    """of_another_build(what) is this machine's library with headers in which that has moved."""

    @cache
    def made(what: str) -> FastDds:
        include = tmp_path_factory.mktemp("include")
        for folder in ("/usr/include", *Path("/usr/include").glob("*-linux-gnu*")):
            for name in ("fastrtps", "fastdds"):
                if (Path(folder) / name).is_dir():
                    shutil.copytree(Path(folder) / name, include / name, dirs_exist_ok=True)
        header, member = MOVED[what]
        path = include / "fastdds/rtps/builtin/data" / header
        text = path.read_text()
        assert text.count(member) == 1
        at = text.rindex("\n", 0, text.index(member))
        path.write_text(f"{text[:at]}\n    char moved_[64];{text[at:]}")
        return examine(fastdds_here.library.path, include=[include])

    return made


def test_a_library_without_the_functions_is_not_fast_dds(library, tmp_path):
    other = tmp_path / "libfastrtps.so.2.9.1"
    other.write_bytes(library("libfastrtps.so.2.9", build="00ff"))
    with pytest.raises(AdapterError, match="does not export the functions"):
        examine(other)


@pytest.mark.slow
@pytest.mark.parametrize("what", MOVED)
def test_an_adapter_that_does_not_find_what_was_announced_is_not_installed(
    of_another_build, tmp_path, what
):
    """It compiles, and its functions are those of the library."""
    with pytest.raises(AdapterError, match="does not find the topics of endpoints in") as refusal:
        install(of_another_build(what), tmp_path / "plugin", here())
    assert "--include DIR, --library PATH" in refusal.value.hint
    assert not (tmp_path / "plugin").exists()


@pytest.mark.slow
def test_an_adapter_that_does_not_find_what_was_announced_makes_no_participant(
    stage, copied, of_another_build, tmp_path_factory
):
    """Put there by hand, without the probe of an installation."""
    folder = tmp_path_factory.mktemp("compiled")
    compile_adapter(of_another_build("the topic of a writer"), folder, here())
    adapter = ADAPTER.format(stage.installation.library.build_id)
    shutil.copy(folder / adapter, copied)
    outcome = stage.run(LD_PRELOAD=str(copied / PRELOAD))
    assert refused(outcome, "does not find the topics of endpoints in", "plugin install fastdds")
