"""Bundles, requests and answers from anywhere: refused in our words, or what they were."""

import gzip
import json
import tempfile
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pqsec_pki.algorithms import SealingPrivateKey, profile_named
from pqsec_pki.certificates import CertificateRequest, certificate_request
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    Bundle,
    SignRequest,
    open_sealed,
    seal,
    tarball,
    validate_csrs,
    verify_bundle,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.lifecycle import ParticipantSpec
from tests.longer import examples
from tests.unit.keystores import made
from tests.unit.killing import NOW, YEAR

pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
hostile = settings(max_examples=examples(200), suppress_health_check=list(HealthCheck))
PROFILE = profile_named("transition")
KEY = SealingPrivateKey.generate()

mutations = st.lists(
    st.tuples(st.integers(0, 1 << 20), st.binary(max_size=6), st.integers(0, 6)),
    min_size=1,
    max_size=3,
)
"""Where, what to put there, and how much of what was there goes."""


@cache
def bundle():
    with tempfile.TemporaryDirectory() as folder:
        keystore = made(Path(folder) / "k", "transition", names=("/a",))
        return Bundle.of(keystore, ["/a"], now=NOW)


@cache
def asked():
    request = certificate_request(
        "/a", PROFILE.participant_key.generate(), PROFILE.alternative_key.generate()
    )
    spec = ParticipantSpec(name="/a", domains=DomainSet.of(0), publish=("t",), validity=YEAR)
    return SignRequest((request,), (spec,))


def mutated(data, changes):
    changed = bytearray(data)
    for at, text, gone in changes:
        place = at % (len(changed) + 1)
        changed[place : place + gone] = text
    return bytes(changed)


def ours(action):
    """What `action` gives; None if it raised one of our errors."""
    try:
        return action()
    except PqsecError:
        return None


@hostile
@given(mutations)
def test_a_tar_that_was_altered_is_refused_or_has_the_files_that_it_had(changes):
    tar = mutated(gzip.decompress(bundle().to_bytes()), changes)
    found = ours(lambda: Bundle.from_bytes(gzip.compress(tar, mtime=0)))
    assert found is None or found.sha256 == bundle().sha256


@hostile
@given(st.integers(0, 6), mutations)
def test_a_file_that_was_altered_with_its_hash_is_refused_or_holds(number, changes):
    files = tarball.unpack(bundle().to_bytes())
    name = sorted(files)[number % len(files)]
    files[name] = mutated(files[name], changes)
    if name == "manifest.json":
        ours(lambda: Bundle.from_bytes(tarball.pack(files)))
        return
    enclave = dict(bundle().enclaves["/a"]) | {name.rpartition("/")[2]: files[name]}
    altered = Bundle(NOW, {"/a": enclave})
    ours(lambda: verify_bundle(altered, bundle().roles, now=NOW))


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=9,
)


@hostile
@given(st.sampled_from(["format", "kind", "files", "names", "created", "ca_sha256"]), json_values)
def test_a_manifest_may_say_anything(key, value):
    files = tarball.unpack(bundle().to_bytes())
    manifest = json.loads(files["manifest.json"]) | {key: value}
    files["manifest.json"] = json.dumps(manifest).encode()
    ours(lambda: Bundle.from_bytes(tarball.pack(files)))


@hostile
@given(
    st.sampled_from([*("name", "domains", "publish", "subscribe", "validity_hours")]), json_values
)
def test_a_wish_may_say_anything(key, value):
    files = tarball.unpack(asked().to_bytes(now=NOW))
    manifest = json.loads(files["manifest.json"])
    manifest["wishes"][0][key] = value
    files["manifest.json"] = json.dumps(manifest).encode()
    found = ours(lambda: SignRequest.from_bytes(tarball.pack(files)))
    if found:
        ours(lambda: found.admitted([PROFILE]))


@hostile
@given(mutations)
def test_a_request_that_was_altered_is_never_admitted(changes):
    der = asked().requests[0].der
    altered = mutated(der, changes)
    request = ours(lambda: CertificateRequest.from_der(altered))
    if request and altered != der:
        assert ours(lambda: validate_csrs([request], [PROFILE], names=["/a"])) is None


@hostile
@given(mutations)
def test_a_sealed_bundle_that_was_altered_is_not_opened(changes):
    data = seal(b"content", KEY.public_key)
    altered = mutated(data, changes)
    assert altered == data or ours(lambda: open_sealed(altered, KEY)) is None


@hostile
@given(st.binary(max_size=300))
def test_any_bytes_are_refused_in_our_words(data):
    for read in (Bundle.from_bytes, SignRequest.from_bytes, tarball.unpack):
        assert ours(lambda read=read: read(data)) is None
        assert ours(lambda read=read: read(gzip.compress(data, mtime=0))) in (None, {})
