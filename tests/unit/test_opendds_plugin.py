"""pqsec's plugin for OpenDDS, as far as it can be tested without OpenDDS."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pqsec_pki.errors import FileError, PqsecError, UsageError, VerificationError
from pqsec_pki.plugin.building import SOURCES, CompileError
from pqsec_pki.plugin.calls import VERSION
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export
from pqsec_pki.vendors.fastdds_adapter import Compilers
from pqsec_pki.vendors.fastdds_library import AdapterError
from pqsec_pki.vendors.opendds_adapter import (
    OPENDDS_LINK,
    OPENDDS_RECORD,
    OPENDDS_SOURCES,
    compile_opendds,
    install_opendds,
    installed_opendds,
)
from pqsec_pki.vendors.opendds_library import find_opendds
from pqsec_pki.vendors.own_plugin import OPENDDS
from pqsec_pki.vendors.plugin_files import installed_plugins, remove_plugins
from tests.unit.keystores import NOW, TWO, made

VALUES = Path(__file__).with_name("opendds_values.cpp")
FACTORY = "void *_make_BuiltInPluginLoader(void *gone) { return gone; }\n"
GENERATED = "dds/DdsSecurityCoreC.h"
HEADERS = (
    *("dds/DCPS/security/framework/SecurityRegistry.h", GENERATED),
    *("ACE_wrappers/ace/Service_Object.h", "ACE_wrappers/TAO/tao/LocalObject.h"),
)

SAID = """\
same 1 left 0
class DDS:Auth:PKI-DH:1.0 text the text size 3 last 255
empty 1
different 1
setting dds.sec.auth.identity_ca=file:ca.pem
partitions 2 [floor1] []
tags level=high
topics DCPSParticipantsSecure Square
numbers 0 1 2 again 1
back 1 1 unknown 1 1
dropped 1 found 0 left 1 never again 3
known 0 1 a reason other 0 later 1 over 0
full: first 0 last 1
too large 0
governing 11 11 12 99
peer 31 0
dropped 21 0
"""


@pytest.mark.slow
def test_values_handles_and_refusals(requires, tmp_path):
    """The C++ that has no type of OpenDDS: to the agent's octets and back, and what is kept."""
    cxx = requires(shutil.which("c++"), "a C++ compiler", "apt-get install g++")
    cc = requires(shutil.which("cc"), "a C compiler", "apt-get install gcc")
    checks = ("-O0", "-fsanitize=address,undefined", "-Wall", "-Wextra", "-Werror")
    folders = (f"-I{OPENDDS_SOURCES}", f"-I{SOURCES}")
    subprocess.run(
        [cc, "-std=c11", *checks, "-c", SOURCES / "wire.c"], cwd=tmp_path, check=True, timeout=120
    )
    program = [cxx, "-std=c++11", *checks, *folders, "-o", "values", VALUES, "wire.o"]
    subprocess.run(program, cwd=tmp_path, check=True, timeout=120)
    done = subprocess.run(
        [tmp_path / "values"], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.stdout, done.stderr, done.returncode) == (SAID, "", 0)


@pytest.fixture
def root(requires, tmp_path) -> Callable[..., Path]:
    """root() is a folder as a build of OpenDDS leaves it, but for what is left out."""
    compiler = requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")

    def make(*without: str, source: str = FACTORY) -> Path:
        path = tmp_path / "OpenDDS"
        for name in {*HEADERS, "dds/Version.h"} - set(without):
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).write_text('#define DDS_VERSION "3.13.3"\n')
        (path / "lib").mkdir(exist_ok=True)
        for name in {"libOpenDDS_Dcps.so", "libOpenDDS_Security.so"} - set(without):
            words = ["-shared", "-fPIC", "-xc", "-", "-o", path / "lib" / name]
            subprocess.run([compiler, *words], input=source.encode(), check=True, timeout=60)
        return path

    return make


def test_an_opendds_is_found_by_its_folder(root):
    path = root()
    for said in (find_opendds(path, {}), find_opendds(None, {"DDS_ROOT": str(path)})):
        assert said.title == "OpenDDS 3.13.3"
        assert said.library.path == path / "lib/libOpenDDS_Security.so"
        ace = path / "ACE_wrappers"
        assert said.include == (path, ace, ace / "TAO")
        assert said.libraries == (path / "lib",)


def test_ace_is_where_the_variables_or_the_script_of_the_build_say(root, tmp_path):
    path, elsewhere = root(), tmp_path / "elsewhere"
    (path / "ACE_wrappers").rename(elsewhere)
    with pytest.raises(AdapterError, match="headers of ACE") as refusal:
        find_opendds(path, {})
    assert "ACE_ROOT" in refusal.value.hint
    assert elsewhere in find_opendds(path, {"ACE_ROOT": str(elsewhere)}).include
    (path / "setenv.sh").write_text(f'export ACE_ROOT="{elsewhere}"\nexport PATH=$PATH\n')
    assert find_opendds(path, {}).include == (path, elsewhere, elsewhere / "TAO")


REFUSED = {
    "no headers": (HEADERS[:2], FACTORY, "has no headers of OpenDDS"),
    "no generated headers": ((GENERATED,), FACTORY, "which a build writes"),
    "no security": (("libOpenDDS_Security.so",), FACTORY, "was built without security"),
    "not built": (("libOpenDDS_Security.so", "libOpenDDS_Dcps.so"), FACTORY, "is not built"),
    "another name space": ((), "void other(void) {}", "does not export _make_BuiltInPluginLoader"),
    "no TAO": ((HEADERS[3],), FACTORY, "headers of TAO"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_opendds_that_cannot_be_compiled_for_is_refused_with_the_reason(root, case):
    without, source, words = REFUSED[case]
    with pytest.raises(AdapterError, match=words) as refusal:
        find_opendds(root(*without, source=source), {})
    assert refusal.value.hint


def test_without_a_folder_the_variable_is_named():
    with pytest.raises(UsageError, match="DDS_ROOT is not set") as refusal:
        find_opendds(None, {"DDS_ROOT": ""})
    assert "--root" in refusal.value.hint


def test_headers_that_do_not_compile_are_told_with_the_compilers_words(root, tmp_path):
    """Each standard of C++ is tried, and nothing is installed."""
    tried = []

    def run(command, folder: Path) -> None:
        tried.append(next(word for word in command if word.startswith("-std=")))
        raise CompileError("the compiler says: no")

    folder = tmp_path / "plugin"
    with pytest.raises(CompileError, match="no"):
        install_opendds(find_opendds(root(), {}), folder, Compilers(c="cc", cxx="c++", run=run))
    assert tried == ["-std=gnu++17", "-std=gnu++14", "-std=gnu++11"]
    assert not folder.exists()


def pretended(factories: str) -> Compilers:
    """Compilers that compile another source, which needs no OpenDDS."""

    def run(command, folder: Path) -> None:
        if "-o" in command:
            words = ["cc", "-shared", "-fPIC", "-xc", "-", "-o", folder / OPENDDS]
            subprocess.run(words, input=factories.encode(), check=True, timeout=60)

    return Compilers(c="cc", cxx="c++", run=run)


BOTH = FACTORY + FACTORY.replace("BuiltInPlugin", "Pqsec")


def test_a_library_without_the_factories_is_not_installed(root, tmp_path):
    with pytest.raises(CompileError, match="lacks _make_PqsecLoader"):
        compile_opendds(find_opendds(root(), {}), tmp_path, pretended(FACTORY))


def test_it_is_listed_until_opendds_is_built_again_and_removed_with_its_link(root, tmp_path):
    stack, folder = find_opendds(root(), {}), tmp_path / "plugin"
    assert installed_opendds(folder) is None
    assert install_opendds(stack, folder, pretended(BOTH)).adapter == folder / OPENDDS
    assert (folder / OPENDDS_LINK).resolve() == folder / OPENDDS
    (found,) = installed_plugins(folder)
    assert (found.stack, found.title, found.problem) == ("opendds", "OpenDDS 3.13.3", "")
    with pytest.raises(PqsecError, match="exists"):
        install_opendds(stack, folder, pretended(BOTH))
    install_opendds(stack, folder, pretended(BOTH), force=True)

    os.utime(stack.library.path, (0, 1))
    assert installed_plugins(folder)[0].problem == "OpenDDS was built again since"
    install_opendds(stack, folder, pretended(BOTH))
    (folder / OPENDDS_LINK).unlink()
    assert "is missing" in installed_plugins(folder)[0].problem
    install_opendds(stack, folder, pretended(BOTH))
    stack.library.path.unlink()
    assert "is gone" in installed_plugins(folder)[0].problem
    assert {path.name for path in remove_plugins(folder)} == {
        OPENDDS,
        OPENDDS_RECORD,
        OPENDDS_LINK.name,
    }
    assert not folder.exists()


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("protocol", VERSION + 1, "pqsec was updated since"),
        ("python", "/nowhere/python3", "/nowhere/python3 is gone"),
    ],
)
def test_an_adapter_for_another_pqsec_is_told(root, tmp_path, key, value, problem):
    folder = tmp_path / "plugin"
    install_opendds(find_opendds(root(), {}), folder, pretended(BOTH))
    record = json.loads((folder / OPENDDS_RECORD).read_text())
    assert record["python"] == sys.executable
    (folder / OPENDDS_RECORD).write_text(json.dumps(record | {key: value}))
    assert installed_plugins(folder)[0].problem == problem


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"root": 1}', "[" * 100_000, '{"size": "x"}'])
def test_a_record_that_no_machine_wrote_is_left_out(tmp_path, content):
    (tmp_path / OPENDDS_RECORD).write_text(content)
    assert installed_opendds(tmp_path) is None


def test_a_folder_in_which_others_may_write_is_refused(root, tmp_path):
    folder = tmp_path / "plugin"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(FileError, match="anybody may write there"):
        install_opendds(find_opendds(root(), {}), folder, pretended(BOTH))
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    return made(tmp_path_factory.mktemp("k") / "k", "pq", names=TWO)


@pytest.fixture
def exported(keystore, root, tmp_path):
    """exported(**options) is an export with the plugin, which is installed."""
    folder = tmp_path / "plugin"
    stack = find_opendds(root(), {})
    install_opendds(stack, folder, pretended(BOTH))

    def make(folder: Path = folder, **options):
        chosen = Options(
            plugin=folder, anyway=True, **options
        )  # RTPS is protected, and 3.13 cannot
        return export(stack_named("opendds"), keystore, "/talker", chosen, now=NOW)

    return make


def test_an_export_loads_the_plugin_by_its_path(exported, keystore, tmp_path):
    found = exported()
    directive = f"dynamic Pqsec Service_Object * {tmp_path}/plugin/{OPENDDS}:_make_PqsecLoader()"
    header = found.files["pqsec_participant.h"]
    assert f'process_directive(ACE_TEXT("{directive}"))' in header
    assert "  load();\n" in header
    assert f"{tmp_path}/plugin/opendds is first in LD_LIBRARY_PATH" in str(found.notes)
    plain = export(
        stack_named("opendds"), keystore, "/talker", Options(anyway=True), now=NOW
    ).files["pqsec_participant.h"]
    assert "Service_Config" not in plain
    assert "load()" not in plain


def test_what_its_version_cannot_protect_is_known(exported, keystore, tmp_path):
    """Without `--stack-version` too: the plugin is for one version."""
    exported()
    chosen = Options(plugin=tmp_path / "plugin")
    with pytest.raises(VerificationError, match=r"OpenDDS before 3\.14"):
        export(stack_named("opendds"), keystore, "/talker", chosen, now=NOW)


def test_an_export_is_for_the_opendds_that_the_plugin_is_for(exported, tmp_path):
    exported(version="3.13.3")
    with pytest.raises(FileError, match=r"is for OpenDDS 3\.13\.3") as refusal:
        exported(version="3.34.0")
    assert "--root" in refusal.value.hint
    os.utime(tmp_path / "OpenDDS/lib/libOpenDDS_Security.so", (0, 1))
    with pytest.raises(FileError, match="OpenDDS was built again since") as refusal:
        exported()
    assert "pqsec plugin install opendds" in refusal.value.hint
    with pytest.raises(FileError, match="has no libpqsec_opendds") as refusal:
        exported(tmp_path)
    assert "pqsec plugin install opendds" in refusal.value.hint


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("name", ["a b", "a:b", "a(b", 'a"b', "\u00e9"])
def test_a_folder_that_ace_reads_otherwise_is_refused(exported, tmp_path, name):
    (tmp_path / "plugin").rename(tmp_path / name)
    with pytest.raises(UsageError, match="OpenDDS loads nothing from a folder"):
        exported(tmp_path / name)
