"""Inspection: any bytes are told or refused, and no private key is ever quoted."""

import base64
import json
import traceback
from datetime import UTC, datetime, timedelta
from functools import cache

import pytest
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pqsec_pki._asn1 import SeedAndExpandedKey, encode
from pqsec_pki.algorithms import SIGNATURES, pem, private_key_pem, unpem
from pqsec_pki.certificates import Authority, CertificateRequest, RevocationList
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.errors import PqsecError
from pqsec_pki.inspection import describe
from pqsec_pki.smime import Signer, sign
from tests.longer import examples
from tests.some_keys import some_key as key
from tests.unit.test_requests import crl, request, with_alternative

NOW = datetime(2026, 6, 1, tzinfo=UTC)
ROWS = [row.name for row in SIGNATURES if "3072" not in row.name and "4096" not in row.name]
"""Larger RSA keys are only slower."""
WINDOW = 6
"""Bytes. Fewer could stand in a message by chance."""


@cache
def authority():
    row, second = SIGNATURES.named("p256"), SIGNATURES.named("ml-dsa-65")
    return Authority.create("CA", row, alternative=second, now=NOW, validity=timedelta(days=9))


@cache
def public_files():
    """One of each kind that has no secret in it, DER where it has a DER form."""
    ca, second = authority(), key("ml-dsa-44")
    leaf = ca.issue(
        "/a",
        key("p256").public_key,
        alternative=second.public_key,
        now=NOW,
        validity=timedelta(days=5),
    )
    governance = Governance.protected(DomainSet.of(0)).to_xml()
    countersigner = Signer(ca.certificate, ca.alternative_key)
    message = sign(governance, Signer(ca.certificate, ca.key), countersigner=countersigner, now=NOW)
    return (
        leaf.der,
        key("mldsa65+p256").public_key.spki,
        request(key("p256"), second),
        with_alternative(crl(ca), ca),
        governance,
        message,
        leaf.pem + ca.certificate.pem,
        CertificateRequest.from_der(request(key("p256"))).pem,
        RevocationList.from_der(crl(ca)).pem,
    )


@cache
def private_files(name):
    """The forms of one private key: PKCS#8, then any other DER."""
    private = key(name)
    files = [private.pkcs8, private_key_pem(private), private_key_pem(private, b"pass")]
    if name.startswith("ml-dsa"):
        both = SeedAndExpandedKey(seed=private.raw, expanded_key=private.public_key.raw[:32])
        files.append(private.pkcs8[:22] + encode(both))
    if name.startswith(("ecdsa", "rsa")):
        form = PrivateFormat.TraditionalOpenSSL
        files += [
            private.handle.private_bytes(Encoding.DER, form, NoEncryption()),
            private.handle.private_bytes(Encoding.PEM, form, NoEncryption()),
            private.handle.private_bytes(Encoding.PEM, form, BestAvailableEncryption(b"pass")),
        ]
    return tuple(files)


@cache
def quotes(name):
    """What a message that quotes that key could hold: in hex, base64, repr and as numbers."""
    found = set()
    for file in private_files(name)[:1] + private_files(name)[3:4]:
        windows = [file[at : at + WINDOW] for at in range(len(file) - WINDOW)]
        found |= {each.hex() for each in windows} | {repr(each)[2:-1] for each in windows}
        found |= {str(int.from_bytes(file[at : at + 32]))[:18] for at in range(len(file))}
        for shift in range(3):
            text = base64.b64encode(file[shift:]).decode()
            found |= {text[at : at + 12] for at in range(len(text) - 12)}
    return {each for each in found if len(each) >= WINDOW and len(set(each)) > 2}


def told(data):
    """All that anyone gets to see of `data`."""
    try:
        description = describe(data, now=NOW)
    except PqsecError as error:
        return "".join(traceback.format_exception(error)) + str(error.hint)
    text = description.to_text()
    assert all(line.isprintable() for line in text)
    return "\n".join(text) + json.dumps(description.to_json())


EDITS = st.lists(
    st.tuples(
        st.integers(0, 2**16),
        st.integers(0, 12),
        st.binary(max_size=8) | st.sampled_from([b"0\x80", b"\x05\x00", b"\x30", b"\n", b"-----"]),
    ),
    max_size=3,
)


def edited(data, edits):
    for place, length, put in edits:
        at = place % (len(data) + 1)
        data = data[:at] + put + data[at + length :]
    return data


@given(st.binary(max_size=300))
@example(b"-----BEGIN A-----\n" * 20_000)
@example(b"\x30\x80" * 10_000)
def test_any_bytes_are_told_or_refused(data):
    told(data)
    told(b"\x30" + data)
    told(pem("CERTIFICATE", data))


@settings(max_examples=examples(600))
@given(place=st.integers(0, 8), edits=EDITS)
def test_a_damaged_file_is_told_or_refused(place, edits):
    damaged = edited(public_files()[place], edits)
    told(damaged)
    told(pem("X509 CRL", damaged))


@pytest.mark.parametrize("name", ROWS)
@settings(max_examples=examples(60))
@given(place=st.integers(0, 6), edits=EDITS)
def test_no_damage_makes_a_private_key_speak(name, place, edits):
    files = private_files(name)
    file = files[place % len(files)]
    seen = told(edited(file, edits))
    for _, der in unpem(file, "key")[:1]:
        seen += told(pem("PRIVATE KEY", edited(der, edits)))
    assert not [each for each in quotes(name) if each in seen]


@pytest.mark.parametrize("name", ROWS)
def test_no_form_of_a_private_key_is_quoted(name):
    for file in private_files(name):
        seen = told(file) + told(b"x" + file) + told(file + b"\x00")
        assert not [each for each in quotes(name) if each in seen]
