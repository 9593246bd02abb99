"""Stacks that other packages add to `pqsec export`, in ways that they cannot.

test_extension.py has one that works.
"""

import pytest

from pqsec_pki.vendors import foreign

CODE = """
from pqsec_pki.stacks import OtherStack
from pqsec_pki.vendors import Export, Exporter
def write(enclave, options):
    return {made}
def export(files, **others):
    return Export(stack="labdds", participant="/talker", files=files, **others)
ROW = {row}
"""
ROW = "Exporter(stack=OtherStack('labdds', 'Lab DDS'), writer=write, versions='1', evidence='run')"
MADE = "export({'a': 'text'})"


@pytest.fixture
def package(monkeypatch, tmp_path):
    """package(row, made, name) installs a package with that exporter."""
    installed = []

    def make(row=ROW, made=MADE, name="labdds"):
        number = len(installed) + 1
        site = tmp_path / f"site{number}"
        about = site / f"lab{number}-2.0.dist-info"
        about.mkdir(parents=True)
        metadata = f"Metadata-Version: 2.1\nName: lab{number}\nVersion: 2.0\n"
        (about / "METADATA").write_text(metadata)
        module = f"lab_{abs(hash(tmp_path))}_{number}"
        (about / "entry_points.txt").write_text(f"[pqsec.exporters]\n{name} = {module}:ROW\n")
        (site / f"{module}.py").write_text(CODE.format(row=row, made=made))
        monkeypatch.syspath_prepend(site)
        installed.append(site)
        return site

    foreign.exporter_of.cache_clear()
    yield make
    foreign.exporter_of.cache_clear()


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("exit(0)", "SystemExit: 0"),
        ("'text'", "a str is not an Exporter"),
        (ROW.replace("'labdds'", "'other'"), "its stack is not OtherStack('labdds', ...)"),
        (ROW.replace("OtherStack('labdds', 'Lab DDS')", "'labdds'"), "its stack is not OtherStack"),
        (ROW.replace("writer=write, ", ""), "it has no writer"),
    ],
)
def test_a_package_that_cannot_add_a_stack_is_named(pqsec, keystore, package, row, words):
    keystore()
    package(row)
    said = "the package lab1 2.0 cannot add the stack 'labdds': "
    pqsec("-k k export labdds talker").refused(3, said, words, hint="update or uninstall")


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("exit(0)", "SystemExit: 0"),
        ("None", "a NoneType is not an Export"),
        ("export({})", "its first file is not a text"),
        ("export({'a': enclave.folder})", "its first file is not a text"),
        ("export({'../a': 'text'})", "the file '../a' is not below its folder"),
        ("export({'/a': 'text'})", "the file '/a' is not below its folder"),
        ("export({'a': 'text', '': 'text'})", "the file '' is not below its folder"),
        ("export({'a': 'text', 'b': 5})", "AttributeError"),
        ("export({'a': '\\udcff'})", "UnicodeEncodeError"),
        ("export({'a': 'text'}, notes=(5,))", "AttributeError"),
        ("export({'a': 'text'}, environment={'A': 5})", "AttributeError"),
    ],
)
def test_an_exporter_that_fails_is_named_and_writes_nothing(pqsec, keystore, package, made, words):
    folder = keystore().parent / "conf"
    package(made=made)
    said = "the exporter of the package lab1 2.0 failed: "
    pqsec("-k k export labdds talker -o conf").refused(3, said, words, hint="update or uninstall")
    assert not folder.exists()


def test_a_stack_of_pqsec_is_never_replaced(pqsec, keystore, package):
    keystore()
    package(ROW.replace("labdds", "connext"), name="connext")
    done = pqsec("-k k export connext talker").done()
    assert "<qos_library" in done.out
    assert "lab1" not in done.err


def test_several_packages_with_one_stack_are_named(pqsec, keystore, package):
    keystore()
    package()
    package()
    said = pqsec("-k k export labdds talker")
    said.refused(3, "several packages offer the stack 'labdds': lab", hint="uninstall all but one")


def test_an_unknown_stack_is_answered_with_those_there_are(pqsec, package):
    package()
    said = pqsec("export vortex talker")
    said.refused(2, "no stack named 'vortex'", hint="cyclonedds, fastdds, opendds, connext, ros2")
    assert said.err.endswith("ros2, labdds\n")


def test_a_package_whose_entry_points_cannot_be_read_is_named(pqsec, package):
    (next(package().glob("*.dist-info")) / "entry_points.txt").write_text("[x]\nno equals sign")
    pqsec("export labdds talker").refused(3, "the entry points of lab1 2.0 cannot be read")
