"""Which room may import which: the map of the package, kept true."""

import ast
import importlib
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

import pqsec_pki
from pqsec_pki.access import INTERPRETATIONS, SPEC
from pqsec_pki.cli.explain_error import STACKS as STACKS_WITH_MESSAGES
from pqsec_pki.selfcheck import PQSEC
from pqsec_pki.selfcheck import STACKS as SIMULATED
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import EXPORTERS
from pqsec_pki.vendors.messages import messages
from tests.running import measured_too

ROOT = Path(pqsec_pki.__file__).parent
GROUND = {
    "errors",
    "problems",
    "stacks",
    "_assets",
    "_csv",
    "_dataclass",
    "_der",
    "_drafts",
    "_files",
    "_lazy",
    "_libraries",
    "_locks",
    "_name_patterns",
    "_owners",
    "_packages",
    "_places",
    "_processes",
    "_progress",
    "_times",
    "_asn1",
}
ROOMS = sorted(path.parent.name for path in ROOT.glob("*/__init__.py"))

# A room may import the rooms named here, and the ground.
MAY_IMPORT: dict[str, set[str]] = {
    "algorithms": set(),
    "documents": set(),
    "certificates": {"algorithms"},
    "tokens": {"algorithms"},
    "transparency": {"algorithms"},
    "smime": {"algorithms", "certificates"},
    "access": {"documents"},
    "handshake": {"algorithms", "certificates", "smime"},
    "credentials": {
        *("algorithms", "certificates", "smime", "documents", "access", "tokens"),
        "transparency",
    },
    "approvals": {"algorithms"},
    "keystore": {
        *("algorithms", "certificates", "smime", "documents", "credentials", "tokens"),
        *("approvals", "transparency"),
    },
    "lifecycle": {
        *("algorithms", "certificates", "smime", "documents", "credentials", "keystore"),
        *("tokens", "access", "approvals", "transparency"),
    },
    "vendors": {"keystore", "lint", "access", "documents", "smime", "algorithms", "plugin"},
    "domain": {
        *("enrolment", "lifecycle", "keystore", "documents", "access", "certificates"),
        *("algorithms", "policy", "credentials", "approvals"),
    },
    "inspection": {"documents", "smime", "certificates", "algorithms", "tokens"},
    "plugin": {
        *("handshake", "access", "documents", "smime", "certificates", "algorithms"),
        *("tokens", "transparency"),
    },
    "selfcheck": {
        *("handshake", "access", "documents", "smime", "certificates", "algorithms"),
        *("keystore", "lifecycle"),
    },
}
MAY_IMPORT["lint"] = {
    *("algorithms", "certificates", "smime", "documents", "access", "handshake", "keystore"),
    "transparency",
}
MAY_IMPORT["enrolment"] = MAY_IMPORT["lifecycle"] | {"lifecycle", "transparency"}
MAY_IMPORT["policy"] = {"keystore", "access"} | MAY_IMPORT["keystore"]
MAY_IMPORT["report"] = MAY_IMPORT["policy"] | {"policy", "lint", "migration"}
MAY_IMPORT["learning"] = {"policy", "access", "keystore", "documents"}
MAY_IMPORT["trial"] = {"vendors", "keystore", "access", "documents", "smime", "plugin"}
MAY_IMPORT["attacks"] = MAY_IMPORT["selfcheck"] | {"selfcheck"}
MAY_IMPORT["lint"] |= {"tokens"}
MAY_IMPORT["vendors"] |= {"tokens"}
for room in ("vendors", "plugin", "selfcheck", "lint", "enrolment", "trial", "attacks"):
    MAY_IMPORT[room] = MAY_IMPORT[room] | {"credentials"}
MAY_IMPORT["cbom"] = {
    *("lint", "inspection", "keystore", "credentials", "certificates", "smime", "documents"),
    *("algorithms", "tokens"),
}
MAY_IMPORT["migration"] = {
    *("selfcheck", "lifecycle", "vendors", "keystore", "credentials", "documents"),
    *("algorithms", "domain"),
}
MAY_IMPORT["benchmark"] = {
    *("handshake", "documents", "smime", "certificates", "algorithms"),
    *("trial", "vendors", "plugin", "lifecycle", "keystore", "credentials"),
}
MAY_IMPORT["estimation"] = {"handshake", "keystore", "credentials", "algorithms"}
MAY_IMPORT["est"] = MAY_IMPORT["enrolment"] | {"enrolment"}
MAY_IMPORT["server"] = MAY_IMPORT["est"] | {"est", "domain"}
MAY_IMPORT["installed"] = {"plugin", "vendors", "trial", "enrolment", "keystore"}
MAY_IMPORT["cli"] = set(MAY_IMPORT)
MAY_IMPORT["ros"] = {"vendors", "cli"}

# Outside packages that only these rooms, or modules of the ground, may touch.
ONLY_IN = {
    "cryptography.hazmat.asn1": {"_asn1"},
    "cryptography.hazmat.primitives.asymmetric": {"algorithms"},
    "click": {"cli"},
    "cyclonedx": {"cbom"},
    "lxml": {"documents"},
    "matplotlib": {"benchmark"},
    "OpenSSL": {"est", "server"},
    "twisted": {"server"},
    "pkcs11": {"tokens"},
    "psycopg": {"keystore"},
    "launch": {"ros"},
    "launch_ros": {"ros"},
    "ros2cli": {"ros"},
    "yaml": {"documents", "vendors"},
    "jinja2": {"vendors", "report"},
}


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Those of a module, at any depth, without the expressions in them: there are many more."""
    for field in ("body", "handlers", "cases", "orelse", "finalbody"):
        for each in getattr(tree, field, ()):
            yield each
            yield from statements(each)


@cache
def imports(source: str) -> tuple[str, ...]:
    """The full name of everything imported, at the top or inside functions."""
    found: list[str] = []
    for node in statements(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            prefix = "." * node.level + (node.module or "")
            found += (f"{prefix}.{alias.name}" for alias in node.names)
    return tuple(found)


def broken_rules(place: str, source: str) -> Iterator[str]:
    """What `source`, of the room or ground module `place`, imports against the map."""
    allowed = {place} | GROUND | MAY_IMPORT.get(place, set())
    for name in imports(source):
        if name.startswith("."):
            yield f"{name} is not written in full"
        if name.startswith("pqsec_pki.") and name != "pqsec_pki.__version__":
            other, *inside = name.split(".")[1:]
            if other not in allowed:
                yield f"{name} is not for {place}"
            if other != place and any(part.startswith("_") for part in inside):
                yield f"{name} is private"
        for outside, places in ONLY_IN.items():
            if f"{name}.".startswith(f"{outside}.") and place not in places:
                yield f"{name} is not for {place}"


# Ways to ask a text what it says. (`partition` cuts, and inspection/_key.py cuts what could quote.)
_PARSING = {"startswith", "endswith", "removeprefix", "removesuffix", "rpartition", "split"}
_WORDS = ("str(error)", ".message", ".words")


def parsed_messages(source: str) -> Iterator[str]:
    """Where the words of an error, called so, or of a Problem are taken apart."""
    if not any(words in source for words in _WORDS):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            asked = ast.unparse(node.func.value)
            told = asked == _WORDS[0] or asked.endswith(_WORDS[1:])
            if told and node.func.attr in _PARSING:
                yield ast.unparse(node)


def test_no_message_is_parsed_back():
    found = {str(path): list(parsed_messages(path.read_text())) for path in ROOT.rglob("*.py")}
    assert {name: calls for name, calls in found.items() if calls} == {}
    assert list(parsed_messages("str(error).removeprefix(f'{path}: ')"))
    assert list(parsed_messages("problem.message.startswith('is not expected here')"))


def stacks_in(source: str) -> Iterator[str]:
    """The strings in `source` that are the name or the product of a stack, and nothing else."""
    known = {each.value for each in Stack} | {each.product for each in Stack}
    if not any(name in source for name in known):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in known:
            yield node.value


def test_no_stack_is_named_outside_the_one_table():
    here = {ROOT / "stacks.py"}
    found = {str(path): list(stacks_in(path.read_text())) for path in {*ROOT.rglob("*.py")} - here}
    source = found.pop(str(ROOT / "vendors/fastdds_adapter.py"))  # the name of a folder
    assert {name: texts for name, texts in found.items() if texts} == {}
    assert source == [Stack.FASTDDS]
    assert list(stacks_in("row = Row(title='RTI Connext')")) == [Stack.CONNEXT.product]


def test_every_row_of_a_room_is_for_a_stack_of_the_table():
    assert [each.stack for each in EXPORTERS] == list(Stack)
    assert {stack for each in messages() for stack in each.stacks} == {*STACKS_WITH_MESSAGES}
    rows = {re.split("[-@]", each.name)[0] for each in (*INTERPRETATIONS, *SIMULATED)}
    assert rows - {SPEC.name, PQSEC.name} < {*Stack}


PAST_THE_INIT = {
    "documents.parts_yaml": "what a room needs to read YAML of its own",
    "access.governance_diff": "a module of this name has the function",
    "selfcheck.trace": "a module of this name has the function",
    "vendors.messages": "a module of this name has the function",
    "vendors.fastdds_adapter": "`install`, `here` and others say what they do only beside its name",
    "plugin": "the agent's parts, for those that run an agent themselves",
}
"""Modules of which other rooms import more than the room's `__init__` has, and why."""


def test_a_room_exports_what_others_use():
    found = set()
    for path in ROOT.rglob("*.py"):
        for name in imports(path.read_text()):
            room, *inside = name.removeprefix("pqsec_pki.").split(".")
            if room in ROOMS and room != path.relative_to(ROOT).parts[0] and len(inside) > 1:
                found.add(room if room in PAST_THE_INIT else f"{room}.{inside[0]}")
    assert found == set(PAST_THE_INIT)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_the_map_allows(room):
    assert room in MAY_IMPORT, "a new room: say on the map what it may import"
    for file in (ROOT / room).rglob("*.py"):
        assert list(broken_rules(room, file.read_text())) == [], file.name


@pytest.mark.parametrize("module", sorted(GROUND))
def test_the_ground_stands_on_nothing(module):
    assert list(broken_rules(module, (ROOT / f"{module}.py").read_text())) == []


def test_no_module_stands_outside_the_rooms_and_the_ground():
    modules = {path.stem for path in ROOT.glob("*.py")}
    assert modules == GROUND | {"__init__", "__main__"}


@pytest.mark.parametrize(
    ("place", "source"),
    [
        ("documents", "from pqsec_pki.algorithms import PROFILES"),
        ("algorithms", "def f():\n    from pqsec_pki.certificates import Certificate"),
        ("smime", "import pqsec_pki.keystore"),
        ("_files", "from pqsec_pki.algorithms import pem"),
        ("keystore", "from pqsec_pki.smime._mime import split"),
        ("keystore", "from pqsec_pki.smime import _mime"),
        ("keystore", "from pqsec_pki.algorithms.keys import _native"),
        ("keystore", "from ..smime import verify"),
        ("certificates", "from cryptography.hazmat import asn1"),
        ("certificates", "from cryptography.hazmat.primitives.asymmetric import ec"),
        ("keystore", "import click"),
        ("keystore", "from lxml import etree"),
        ("access", "import jinja2.sandbox"),
    ],
)
def test_a_forbidden_import_is_seen(place, source):
    assert list(broken_rules(place, source))


@pytest.mark.parametrize(
    ("place", "source"),
    [
        ("keystore", "from pqsec_pki.keystore._ledger import Entry"),
        ("cli", "import click\nfrom pqsec_pki.keystore import Keystore"),
        ("smime", "from pqsec_pki._asn1 import decode"),
        ("documents", "from lxml import etree"),
        ("cli", "from pqsec_pki import __version__"),
    ],
)
def test_an_allowed_import_is_not_complained_of(place, source):
    assert list(broken_rules(place, source)) == []


def test_the_map_has_no_circles():
    done: set[str] = set()
    while len(done) < len(MAY_IMPORT):
        ready = {room for room, needs in MAY_IMPORT.items() if needs - {room} <= done} - done
        assert ready, f"a circle among {set(MAY_IMPORT) - done}"
        done |= ready


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_it_is_and_what_it_offers(room):
    module = importlib.import_module(f"pqsec_pki.{room}")
    assert module.__doc__
    assert module.__all__
    assert len(set(module.__all__)) == len(module.__all__)
    assert [name for name in module.__all__ if not hasattr(module, name)] == []
    modules = {path.stem for path in (ROOT / room).glob("*.py")}
    loaded_by_name = {
        name for name in module.__all__ if not isinstance(getattr(module, name), ModuleType)
    }
    assert modules & loaded_by_name == set(), "the import of the module would replace the name"


@pytest.mark.parametrize("room", ["keystore", "lifecycle"])
def test_a_room_lists_its_modules(room):
    text = importlib.import_module(f"pqsec_pki.{room}").__doc__ or ""
    listed = re.findall(r"^ {4}(\w+) {2,}|`(_\w+|rollover_\w+)`", text, re.MULTILINE)
    modules = {path.stem for path in (ROOT / room).glob("*.py")} - {"__init__"}
    assert {first or second for first, second in listed} == modules


def test_no_two_classes_have_one_name():
    """A reader who searches for a class finds it, and not three."""
    names = Counter(
        name
        for path in ROOT.rglob("*.py")
        for name in re.findall(r"^class (\w+)", path.read_text(), re.MULTILINE)
    )
    assert {name for name, count in names.items() if count > 1} == set()
    assert len(names) > 500


def test_reading_a_keystore_loads_no_operations():
    code = "import sys, pqsec_pki.keystore; sys.exit('pqsec_pki.lifecycle' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": str(ROOT.parent)})


def test_all_modules_can_be_imported():
    """Also what is loaded on demand. The coverage of this process is measured."""
    modules = {path.relative_to(ROOT.parent).with_suffix("") for path in ROOT.rglob("*.py")}
    names = {".".join(each.parts).removesuffix(".__init__") for each in modules}
    names -= {"pqsec_pki.ros.command", "pqsec_pki.ros.launch"}  # only ROS 2's Python can
    code = "import importlib, sys; list(map(importlib.import_module, sys.argv[1:]))"
    command = [sys.executable, "-c", code, *sorted(names)]
    subprocess.run(command, check=True, cwd=ROOT.parent, env=os.environ | measured_too())
