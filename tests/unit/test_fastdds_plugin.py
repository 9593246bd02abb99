"""What is decided from a library's symbols alone, and what an export with the plugin has.

The libraries are small ones of our own, with the names that Fast DDS has in its tables.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pqsec_pki.errors import FileError, MalformedError, UsageError, shown
from pqsec_pki.plugin.building import SOURCES, CompileError
from pqsec_pki.plugin.calls import CALLS, VERSION
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export
from pqsec_pki.vendors._symbols import read_symbols
from pqsec_pki.vendors.fastdds_adapter import (
    ADAPTER,
    FASTDDS_SOURCES,
    RECORD,
    _run,
    here,
    installed,
)
from pqsec_pki.vendors.fastdds_library import AdapterError, examine, find_fastdds, table_of
from pqsec_pki.vendors.own_plugin import PRELOAD
from pqsec_pki.vendors.ros2 import preflight
from tests.unit.keystores import NOW, TWO, made

SPACE = "_ZN8eprosima8fastrtps4rtps8security"
AUTHENTICATION, ACCESS_CONTROL = (
    f"{SPACE}21SecurityPluginFactory{name}ERKNS1_14PropertyPolicyE"
    for name in ("28create_authentication_plugin", "28create_access_control_plugin")
)
PKIDH, PERMISSIONS = (table_of(2, name) for name in ("5PKIDH", "11Permissions"))
CALLED = f"""
void *one(void) __asm__("{AUTHENTICATION}");
void *two(void) __asm__("{ACCESS_CONTROL}");
void *one(void) {{ return 0; }}
void *two(void) {{ return 0; }}
void *manager(int first) {{ return first ? one() : two(); }}
"""
TABLES = f"""
void slot(void) __asm__("{SPACE}5PKIDH5validEv");
void slot(void) {{}}
static void destroy(void) {{}}
const void *const authentication[] __asm__("{PKIDH}") = {{0, 0, destroy, destroy, slot}};
const void *const access_control[] __asm__("{PERMISSIONS}") = {{0, 0, destroy, destroy, slot}};
"""
HEADER = '#define FASTRTPS_VERSION_STR "2.9.1"\n'
CDR_HEADER = '#define FASTCDR_VERSION_STR "1.0.26"\n'


@pytest.fixture
def compiled(requires, tmp_path) -> Callable[..., Path]:
    """compiled(source, flag...) is a library, with headers of 2.9.1 beside it."""
    compiler = requires(shutil.which("gcc"), "a C compiler", "apt-get install gcc libc6-dev")
    for name, text in (("fastrtps", HEADER), ("fastcdr", CDR_HEADER)):
        (tmp_path / "include" / name).mkdir(parents=True)
        (tmp_path / "include" / name / "config.h").write_text(text)
    (tmp_path / "lib").mkdir()

    def make(source: str, *flags: str, name: str = "libfastrtps.so.2.9.1") -> Path:
        path = tmp_path / "lib" / name
        (tmp_path / "source.c").write_text(source)
        words = ["-shared", "-fPIC", "-O1", "-Wl,--build-id=sha1", *flags, "-o", path]
        command = [compiler, *words, tmp_path / "source.c"]
        subprocess.run(command, check=True, capture_output=True)
        return path

    return make


def test_a_library_that_calls_its_factories_by_name_can_run_the_plugin(compiled, tmp_path):
    found = examine(compiled(CALLED + TABLES))
    assert (found.title, found.generation) == ("Fast DDS 2.9.1", 2)
    assert found.include == (tmp_path / "include",)
    assert not found.by_properties
    assert not found.derived
    assert [sorted(names) for names in found.tables[0]][2:] == [[f"{SPACE}5PKIDH5validEv"]]


ENDPOINTS = {
    "15WriterProxyData": "27PublicationBuiltinTopicData",
    "15ReaderProxyData": "28SubscriptionBuiltinTopicData",
}
CONVERTS = [
    f"_ZN8eprosima7fastdds4rtps21from_proxy_to_builtinERKNS1_{own}ERNS1_{public}E"
    for own, public in ENDPOINTS.items()
]
READS = [
    f"_ZN8eprosima7fastdds4rtps{own}21read_from_cdr_messageEPNS1_12CDRMessage_tESt5arrayIhLm2EE"
    for own in ENDPOINTS
]


def of_3(*functions: str) -> str:
    """The library's source with the names of Fast DDS 3, and these functions."""
    names = "".join(
        f'void each{at}(void) __asm__("{name}"); void each{at}(void) {{}}\n'
        for at, name in enumerate(functions)
    )
    return (CALLED + TABLES).replace("8fastrtps", "7fastdds") + names


@pytest.mark.parametrize(
    ("functions", "derived"), [(CONVERTS, False), (READS, True), ([*CONVERTS, *READS], False)]
)
def test_what_is_known_of_an_endpoint_follows_from_what_the_library_exports(
    compiled, tmp_path, functions, derived
):
    """Not from its version, which is another here."""
    (tmp_path / "include/fastdds").mkdir()
    header = tmp_path / "include/fastdds/config.hpp"
    header.write_text('#define FASTDDS_VERSION_STR "3.9.0"\n')
    found = examine(compiled(of_3(*functions), name="libfastdds.so.3.9.0"))
    assert (found.generation, found.derived) == (3, derived)


@pytest.mark.parametrize("functions", [[], CONVERTS[:1], READS[1:], [CONVERTS[0], READS[1]]])
def test_a_library_that_describes_endpoints_in_another_way_is_refused(compiled, functions):
    with pytest.raises(AdapterError, match="in a way that pqsec does not know") as refusal:
        examine(compiled(of_3(*functions), name="libfastdds.so.3.9.0"))
    assert "report this one" in refusal.value.hint


REFUSED = {
    "not Fast DDS": ("void other(void) {}", (), "does not export the functions"),
    "hidden": (CALLED + TABLES, ("-fvisibility=hidden",), "does not export the functions"),
    "protected": (CALLED + TABLES, ("-fvisibility=protected",), "does not export the functions"),
    "symbolic": (CALLED + TABLES, ("-Wl,-Bsymbolic",), "directly"),
    "symbolic functions": (CALLED + TABLES, ("-Wl,-Bsymbolic-functions",), "directly"),
    "without tables": (CALLED, (), "hides the names"),
    "nameless slots": (
        CALLED + TABLES.replace("void slot(void) {}", "static void slot(void) {}", 1).replace(
            "void slot(void) __asm__", "extern void other(void) __asm__", 1
        ),
        ("-s",),
        "hides the names",
    ),
    "no build ID": (CALLED + TABLES, ("-Wl,--build-id=none",), "has no build ID"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_library_in_which_the_plugin_cannot_run_is_refused_with_the_reason(compiled, case):
    source, flags, words = REFUSED[case]
    with pytest.raises(AdapterError, match=words) as refusal:
        examine(compiled(source, *flags))
    assert refusal.value.hint


def test_headers_of_another_version_are_refused(compiled, tmp_path):
    path = compiled(CALLED + TABLES)
    header = tmp_path / "include/fastrtps/config.h"
    header.write_text(HEADER.replace("2.9.1", "2.10.0"))
    with pytest.raises(AdapterError, match=r"only headers of 2\.10\.0 are there") as refusal:
        examine(path)
    assert "libfastrtps-dev" in refusal.value.hint
    header.unlink()
    with pytest.raises(
        AdapterError, match="headers of Fast DDS, and they are not there"
    ) as refusal:
        examine(path)
    assert "that has fastrtps/config.h: --include DIR" in refusal.value.hint


def test_of_several_libraries_one_must_be_named(compiled, tmp_path):
    with pytest.raises(AdapterError, match="not installed") as refusal:
        find_fastdds(tmp_path)
    assert "--library" in refusal.value.hint
    path = compiled(CALLED + TABLES)
    goal = tmp_path / "opt/ros/humble/lib"
    goal.mkdir(parents=True)
    shutil.copy(path, goal)
    (goal / "libfastrtps.so").symlink_to(path.name)
    assert find_fastdds(tmp_path) == goal / path.name
    other = tmp_path / "usr/lib"
    other.mkdir(parents=True)
    shutil.copy(path, other)
    with pytest.raises(UsageError, match="several Fast DDS"):
        find_fastdds(tmp_path)


def test_symbols_are_those_that_binutils_read(compiled, requires):
    requires(shutil.which("nm"), "binutils", "apt-get install binutils")
    path = compiled(CALLED + TABLES)
    said = subprocess.run(["nm", "-D", path], capture_output=True, text=True, check=True).stdout
    defined = re.findall(r"(?m)^[0-9a-f]+ [A-Z] (\S+)", said)
    found = read_symbols(path)
    assert found.exported == set(defined)
    assert {AUTHENTICATION, ACCESS_CONTROL} <= found.called
    assert not found.is_symbolic
    assert read_symbols(compiled(CALLED, "-Wl,-Bsymbolic")).is_symbolic


def test_a_broken_library_is_refused_not_followed(compiled, tmp_path):
    """Every cut, and each byte of its header set to all ones."""
    octets = compiled(CALLED + TABLES).read_bytes()
    broken = [octets[:size] for size in range(0, len(octets), 97)]
    broken += [octets[:at] + b"\xff" + octets[at + 1 :] for at in range(64)]
    path = tmp_path / "broken.so"
    for each in broken:
        path.write_bytes(each)
        try:
            read_symbols(path, [PKIDH])
        except MalformedError:
            continue


def test_the_adapter_asks_with_the_kinds_that_the_agent_knows():
    asked = []
    for plugin in ("authentication", "access_control"):
        text = (FASTDDS_SOURCES / f"{plugin}.cpp").read_text()
        found = re.findall(r'link_\.ask\(exception, "(\w+)",\s*"([^"]*)"', text)
        table = {name: f"{call.takes}>{call.gives}" for name, call in CALLS[plugin].items()}
        assert len(found) == text.count("link_.ask(")
        assert set(found) <= set(table.items())
        asked += [name for name, _ in found]
    # Fast DDS has no topics of its own to check, and no listener that 2.9 or 3.1 would call.
    every = {name for plugin in ("authentication", "access_control") for name in CALLS[plugin]}
    without = {name for name in every if "topic" in name} | {"find_revoked"}
    assert set(asked) == every - without


def test_the_preload_library_needs_libc_alone_and_compiles_without_a_warning(requires, tmp_path):
    compiler = requires(shutil.which("gcc"), "a C compiler", "apt-get install gcc libc6-dev")
    goal = tmp_path / PRELOAD
    strict = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-Wl,-z,defs"]
    command = [compiler, *strict, "-shared", "-fPIC", "-o", goal, FASTDDS_SOURCES / "preload.c"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    said = subprocess.run(["readelf", "-d", goal], capture_output=True, text=True, check=True)
    needed = re.findall(r"\(NEEDED\).*\[(.*)\]", said.stdout)
    assert set(needed) <= {"libc.so.6", "libdl.so.2"}


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    return made(tmp_path_factory.mktemp("k") / "k", "pq", names=TWO)


@pytest.fixture
def folder(compiled, tmp_path) -> Path:
    """A folder with the plugin for a library that is there; nothing here loads it."""
    return _put(tmp_path / "plugin", compiled(CALLED + TABLES))


def _put(folder: Path, library: Path) -> Path:
    folder.mkdir()
    build = examine(library).library.build_id
    record = {"library": str(library), "build": build, "version": [2, 9, 1]}
    record |= {"protocol": VERSION, "python": sys.executable}
    (folder / PRELOAD).touch()
    (folder / ADAPTER.format(build)).touch()
    (folder / RECORD.format(build)).write_text(json.dumps(record))
    return folder


def exported(keystore, plugin: Path, **options):
    chosen = Options(plugin=plugin, **options)
    return export(stack_named("fastdds"), keystore, "/talker", chosen, now=NOW)


def test_an_export_preloads_the_library_and_keeps_the_names_that_fail_closed(keystore, folder):
    made = exported(keystore, folder)
    assert made.environment["LD_PRELOAD"] == str(folder / PRELOAD)
    assert "FASTDDS_DEFAULT_PROFILES_FILE" in made.environment
    text = made.files["fastdds.xml"]
    for name in ("builtin.PKI-DH", "builtin.Access-Permissions", "builtin.AES-GCM-GMAC"):
        assert f"<value>{name}</value>" in text
    assert "preferred_key_agreement" not in text  # the agent decides, and refuses that
    assert made.warnings == ()
    assert "setuid" in str(made.notes)


def test_an_export_for_a_library_that_was_updated_is_refused(keystore, folder, compiled):
    compiled(CALLED + TABLES + "int newer;")
    [found] = installed(folder)
    assert found.problem == "the library was updated since"
    with pytest.raises(FileError, match="the library was updated since") as refusal:
        exported(keystore, folder)
    assert "pqsec plugin install fastdds" in refusal.value.hint


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("protocol", VERSION - 1, "pqsec was updated since"),
        ("python", "/nowhere/python", "/nowhere/python is gone"),
        ("library", "/nowhere/libfastrtps.so", "/nowhere/libfastrtps.so"),
        ("library", "/no\0where", "null"),  # byte, or character
    ],
)
def test_what_must_be_installed_again_is_told(folder, name, value, words):
    [path] = folder.glob("*.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    [found] = installed(folder)
    assert words in found.problem


def test_a_record_that_nests_without_end_is_left_out(folder):
    [path] = folder.glob("*.json")
    path.write_text("[" * 100_000)
    assert installed(folder) == []


def test_an_export_for_another_version_or_without_any_is_refused(keystore, folder, tmp_path):
    assert exported(keystore, folder, version="2.9.1")
    with pytest.raises(FileError, match=r"not for the Fast DDS 3\.1\.2"):
        exported(keystore, folder, version="3.1.2")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(FileError, match="not installed") as refusal:
        exported(keystore, empty)
    assert "pqsec plugin install fastdds" in refusal.value.hint


@pytest.mark.parametrize("name", ["a b", "a:b", "a$ORIGIN"])
def test_a_folder_that_the_loader_cannot_be_told_of_is_refused(keystore, compiled, tmp_path, name):
    folder = _put(tmp_path / name, compiled(CALLED + TABLES))
    with pytest.raises(UsageError, match="preloads nothing"):
        exported(keystore, folder)


def test_ros_2_preloads_it_under_rmw_fastrtps(keystore, folder):
    shell = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    chosen = Options(plugin=folder, rmw="fastrtps", anyway=True)
    made = export(stack_named("ros2"), keystore, "/talker", chosen, now=NOW)
    derived = Options(plugin=folder, environment=shell, anyway=True)
    assert export(stack_named("ros2"), keystore, "/talker", derived, now=NOW) == made
    assert [
        replace(derived, **each).runs_in for each in ({"rmw": "cyclonedds"}, {"at": folder})
    ] == [
        "cyclonedds",
        "cyclonedds",
    ]
    assert made.environment["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    script = str(made.files["ros2.sh"])
    command = ["sh", "-euc", f'{script}\nprintf %s "$LD_PRELOAD"']
    for before, after in (("", ""), ("/other.so", ":/other.so")):
        environment = {"PATH": os.environ["PATH"]} | ({"LD_PRELOAD": before} if before else {})
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout == f"{folder / PRELOAD}{after}"
    assert "CYCLONEDDS_URI" not in script
    assert "not run" in str(made.notes)


@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds", "ros2"])
def test_a_middleware_is_chosen_only_for_ros_2_with_the_plugin(keystore, folder, stack):
    plugin = None if stack == "ros2" else folder
    with pytest.raises(UsageError, match="--rmw is for ros2 with --plugin"):
        export(
            stack_named(stack),
            keystore,
            "/talker",
            Options(plugin=plugin, rmw="fastrtps"),
            now=NOW,
        )


@pytest.mark.parametrize("rmw", [None, "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"])
def test_the_check_of_a_shell_knows_what_is_preloaded(keystore, folder, rmw):
    variables = {"LD_PRELOAD": f"/other.so:{folder / PRELOAD}"}
    variables |= {"RMW_IMPLEMENTATION": rmw} if rmw else {}
    found = {each.what: each for each in preflight(keystore, "/talker", variables, now=NOW)}
    assert found["RMW_IMPLEMENTATION"].ok is (rmw != "rmw_cyclonedds_cpp")
    assert any("PQS6" in what for what in found) is (rmw == "rmw_cyclonedds_cpp")
    if rmw == "rmw_cyclonedds_cpp":
        assert "--rmw fastrtps" in found["RMW_IMPLEMENTATION"].fix


BROKEN = """
#include "of_another_build.h"
"""
UNDEFINED = "void nowhere(void); void nobody(void); int main(void) { nowhere(); nobody(); }"


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (BROKEN, ["fatal error", "of_another_build.h"]),
        (UNDEFINED, ["undefined reference", "nowhere", "nobody"]),
        ("int main(void) { return wrong }", ["'wrong' undeclared", "expected ';'"]),
    ],
)
def test_what_a_compiler_says_of_errors_reaches_the_user_as_one_line(
    requires, tmp_path, monkeypatch, source, words
):
    requires(shutil.which("c++"), "a C++ compiler", "apt-get install g++")
    monkeypatch.setenv("LC_ALL", "C")
    (tmp_path / "source.c").write_text(source)
    with pytest.raises(CompileError, match=r"^the compiler says: ") as refusal:
        here().run([here().c, "source.c"], tmp_path)
    said = str(refusal.value)
    assert shown(said, len(said)) == said, "no line breaks, and nothing else that is not printable"
    assert [each for each in words if each not in said] == []
    assert len(said) < 1600


def test_a_command_that_cannot_be_run_is_named(tmp_path):
    """As the probe in a folder that is mounted with noexec."""
    (tmp_path / "probe").touch()
    with pytest.raises(CompileError, match=r"^\./probe cannot be run: .*[Pp]ermission") as refusal:
        _run(["./probe"], tmp_path)
    assert refusal.value.output is None


def test_a_compiler_that_writes_without_end_is_cut(tmp_path):
    with pytest.raises(CompileError) as refusal:
        here().run([sys.executable, "-c", f"raise SystemExit({'error: x' * 10**6!r})"], tmp_path)
    assert len(str(refusal.value)) < 1600


def test_the_sources_are_beside_those_of_the_shim():
    assert {path.name for path in FASTDDS_SOURCES.iterdir()} >= {"preload.c", "agent.hpp"}
    assert SOURCES.is_dir()
