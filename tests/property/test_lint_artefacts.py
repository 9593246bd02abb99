"""Whatever is in certificates, keys, documents and lists: a check answers, and never fails."""

import base64
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pqsec_pki.lint import Finding, check
from pqsec_pki.stacks import Stack
from tests.longer import examples
from tests.unit.keystores import NOW
from tests.unit.linting import TALKER, Lab
from tests.unit.test_lint_x509 import crl

FILES = (
    *("cert.pem", "key.pem", "alt.key.pem", "permissions.p7s", "permissions.xml"),
    *("identity_ca.cert.pem", "permissions_ca.cert.pem", "permissions_ca.alt.cert.pem"),
    *("governance.p7s", "crl.pem"),
)
BASE64 = re.compile(rb"(?<=\n\n)[A-Za-z0-9+/=\n]{64,}(?=\n\n--)|(?<=-----\n)[A-Za-z0-9+/=\n]+")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    lab = Lab(tmp_path_factory.mktemp("lint"))
    lab.put(f"{TALKER}/crl.pem", crl(1, 2, key=lab.authorities().identity.key.handle))
    return lab


def garbled(data, cuts, *, inside):
    """`data` with some bytes exchanged; `inside`: those of what is in base64 there."""
    place = BASE64.search(data) if inside else None
    old = bytearray(base64.b64decode(place[0]) if place else data)
    for where, byte in cuts:
        old[where % len(old)] = byte
    if place is None:
        return bytes(old)
    return data[: place.start()] + base64.encodebytes(bytes(old)) + data[place.end() :]


@settings(
    max_examples=examples(60),
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    name=st.sampled_from(FILES),
    cuts=st.lists(st.tuples(st.integers(0, 20_000), st.integers(0, 255)), min_size=1, max_size=6),
    inside=st.booleans(),
)
def test_a_garbled_file_is_a_finding_or_nothing(lab, name, cuts, inside):
    path = (lab / TALKER / name).resolve()
    sound = path.read_bytes()
    try:
        path.write_bytes(garbled(sound, cuts, inside=inside))
        findings = check([lab.root], now=NOW, targets=list(Stack)).findings
    finally:
        path.write_bytes(sound)
    assert all(isinstance(each, Finding) and each.message.isprintable() for each in findings)
