"""XML made to hurt: every reader of it ends with a clear answer, soon, in little memory.

Each reader meets all of them in a process of its own, which may not have more than
MAX_MEMORY; the time counted is the processor's.
"""

import json
import os
import subprocess
import sys
import time
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.documents import Governance, Permissions, read_tree, sros2, validate
from pqsec_pki.errors import PqsecError
from pqsec_pki.inspection import describe
from pqsec_pki.lint import check
from tests.longer import some

MAX_SECONDS = 20
MAX_MEMORY = 2 << 30
NOW = datetime(2026, 1, 1, tzinfo=UTC)

HEAD = '<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">'
GRANT = (
    '<grant name="x"><subject_name>CN=x</subject_name><validity><not_before>2020-01-01T00:00:00Z'
    "</not_before><not_after>2030-01-01T00:00:00Z</not_after></validity><allow_rule><domains>"
    "<id>0</id></domains><publish><topics><topic>T</topic></topics></publish></allow_rule>"
    "<default>DENY</default></grant>"
)
DOCUMENT = f"{HEAD}<permissions>{GRANT}</permissions></dds>"
DECLARED = '<?xml version="1.0" encoding="{}"?>'


def with_text(old, new):
    assert old in DOCUMENT
    return DOCUMENT.replace(old, new, 1).encode()


def declared(entities, use="&a;"):
    return f"<!DOCTYPE dds [{entities}]>{DOCUMENT.replace('>T<', f'>{use}<')}".encode()


def entity_bomb():
    steps = "".join(f"<!ENTITY e{n + 1} '{f'&e{n};' * 20}'>" for n in range(30))
    return declared(f"<!ENTITY e0 'x'>{steps}", "&e30;")


def encoded(declaration, codec):
    return (DECLARED.format(declaration) + DOCUMENT).encode(codec)


def attributes(count, name="a{}"):
    many = " ".join(f'{name.format(n)}="u"' for n in range(count))
    return DOCUMENT.replace("<permissions>", f"<permissions {many}>").encode()


XINCLUDE = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def including(href, more=""):
    include = f'<xi:include {XINCLUDE} href="{href}" parse="text" {more}/>'
    return with_text("<topic>T</topic>", f"<topic>{include}</topic>")


# What must be refused, made when asked for.
REFUSED = {
    "nothing": lambda: b"",
    "nul": lambda: with_text(">T<", ">\0<"),
    "nul after the end": lambda: DOCUMENT.encode() + b"\0" * 1000,
    "entities that multiply": entity_bomb,
    "an entity that is large, used often": lambda: declared(
        f"<!ENTITY a '{'x' * 100_000}'>", "&a;" * 10_000
    ),
    "an entity in itself": lambda: declared("<!ENTITY a '&b;'><!ENTITY b '&a;'>"),
    "a file as entity": lambda: declared("<!ENTITY a SYSTEM 'file:///etc/passwd'>"),
    "a device as entity": lambda: declared("<!ENTITY a SYSTEM 'file:///dev/zero'>"),
    "a server as entity": lambda: declared("<!ENTITY a SYSTEM 'http://127.0.0.1:9/x'>"),
    "a parameter entity": lambda: declared("<!ENTITY % a SYSTEM 'file:///etc/passwd'>%a;", "T"),
    "a DTD elsewhere": lambda: b"<!DOCTYPE dds SYSTEM 'http://127.0.0.1:9/x'>" + DOCUMENT.encode(),
    "a default attribute": lambda: declared("<!ATTLIST grant name CDATA 'y'>", "T"),
    "an unknown entity": lambda: with_text(">T<", ">&nobody;<"),
    "an included file": lambda: including("/etc/passwd"),
    "an included server": lambda: including("http://127.0.0.1:9/x"),
    "an included part": lambda: including("", 'xpointer="xpointer(/dds)"'),
    "deep": lambda: b"<dds>" * 1_000_000,
    "deep and closed": lambda: b"<a>" * 500_000 + b"</a>" * 500_000,
    "100 MB": lambda: with_text(">T<", f">{'x' * (100 << 20)}<"),
    "100 MB of space": lambda: b" " * (100 << 20) + DOCUMENT.encode(),
    "a million attributes": lambda: attributes(1_000_000),
    "100,000 attributes": lambda: attributes(100_000),
    "one attribute twice": lambda: attributes(2, "a"),
    "a long name": f"<dds><{'x' * 4_000_000}/></dds>".encode,
    "a long attribute": lambda: with_text('name="x"', f'y="{"x" * 5_000_000}"'),
    "other namespace": lambda: with_text("<dds ", "<dds xmlns='urn:x' "),
    "unbound prefix": lambda: with_text("<permissions", "<p:permissions"),
    "a flood of elements": lambda: with_text("<default>", "<a/>" * 1_500_000 + "<default>"),
    "a flood of flaws": lambda: with_text("<id>0</id>", "<id>x</id>" * 5_000),
    "an unknown encoding": lambda: encoded("klingon", "ascii"),
    "UTF-16 cut in a character": lambda: encoded("UTF-16", "utf-16")[:-1],
    "bytes that are no UTF-8": lambda: DOCUMENT.encode().replace(b">T<", b">\xff\xfe<"),
    "overlong UTF-8": lambda: DOCUMENT.encode().replace(b">T<", b">\xc0\xbc<"),
    "a surrogate": lambda: with_text(">T<", ">&#xD800;<"),
    "text after the root": lambda: DOCUMENT.encode() + b"more",
    "two roots": lambda: DOCUMENT.encode() * 2,
    "cut": lambda: DOCUMENT.encode()[:-3],
}

# What may be read, or not: but quickly, and never with an error of another kind.
ODD = {
    "a long number": lambda: with_text("<id>0</id>", f"<id>{'9' * 5_000_000}</id>"),
    "UTF-16 that says UTF-8": lambda: encoded("UTF-8", "utf-16-le"),
    "UTF-8 with a mark": lambda: b"\xef\xbb\xbf" + DOCUMENT.encode(),
    "UTF-16": lambda: encoded("UTF-16", "utf-16"),
    "UTF-32": lambda: encoded("UTF-32", "utf-32"),
    "EBCDIC": lambda: encoded("IBM037", "cp037"),
    "UTF-7": lambda: encoded("UTF-7", "utf-7"),
    "two marks": lambda: b"\xef\xbb\xbf\xef\xbb\xbf" + DOCUMENT.encode(),
    "200,000 namespaces": lambda: attributes(200_000, "xmlns:a{}"),
    "a million comments": lambda: with_text("<permissions>", "<permissions>" + "<!---->" * 900_000),
    "a million instructions": lambda: with_text(
        "<permissions>", "<permissions>" + "<?a?>" * 1_000_000
    ),
    "CDATA in pieces": lambda: with_text(">T<", f">{'<![CDATA[x]]>' * 500_000}<"),
    "a long text": lambda: with_text(">T<", f">{'x' * 7_000_000}<"),
    "a pattern of stars": lambda: with_text(">T<", f">{'*a' * 3_000_000}<"),
    "a long subject": lambda: with_text(">CN=x<", f">CN={'/a' * 3_000_000}<"),
    "many topics": lambda: with_text("<topic>T</topic>", "<topic>a*</topic>" * 100_000),
    "many domains": lambda: with_text("<id>0</id>", "<id>0</id>" * 100_000),
    "many grants": lambda: with_text(GRANT, GRANT * 5_000),
}
ALL = REFUSED | ODD


def checked(data):
    file = Path("hostile.xml")
    file.write_bytes(data)
    report = check([file], now=NOW)
    if not report.is_clean(strict=True):
        raise PqsecError(report.findings[0].message)


def imported(data):
    file = Path("hostile.policy.xml")
    file.write_bytes(data)
    sros2.read_policy(file)


READERS = {
    "validate": validate,
    "governance": Governance.from_xml,
    "permissions": Permissions.from_xml,
    "tree": read_tree,
    "inspect": lambda data: describe(data, now=NOW),
    "check": checked,
    "sros2": imported,
}
TOLERANT = {"tree"}
"""A tree judges nothing that is XML."""


def outcome(reader, data):
    try:
        READERS[reader](data)
    except PqsecError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 -- to be told to the process that asserts
        return repr(error)[:300], "not ours"
    return None


def those_for(reader):
    """The names of the documents that it meets."""
    return some(list(ALL), list(READERS).index(reader))


def meet_all(reader):
    """In a process of its own: a line for each document."""
    import resource  # noqa: PLC0415 -- there

    outcome(reader, DOCUMENT.encode())  # what is loaded once
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    for name in those_for(reader):
        data = ALL[name]()
        start = time.process_time()
        said = outcome(reader, data)
        print(json.dumps([name, said, time.process_time() - start]), flush=True)


@cache
def met(reader, folder):
    root = Path(__file__).parents[2]
    code = f"from tests.property.test_hostile_xml import meet_all; meet_all({reader!r})"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={"PYTHONPATH": str(root), "PQSEC_LONG": os.environ.get("PQSEC_LONG", "")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = map(json.loads, done.stdout.splitlines())
    return {name: (said, seconds) for name, said, seconds in lines}


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_ends_soon_and_with_an_error_of_ours(reader, tmp_path_factory):
    results = met(reader, tmp_path_factory.mktemp(reader))
    assert list(results) == those_for(reader)
    assert {name: said for name, (said, _) in results.items() if isinstance(said, list)} == {}
    slow = {name: seconds for name, (_, seconds) in results.items() if seconds > MAX_SECONDS}
    assert slow == {}
    for name in REFUSED.keys() & results if reader not in TOLERANT else ():
        said, _ = results[name]
        assert said, f"{name} was read"
        assert len(said) < 20_000
        assert "root:" not in said
