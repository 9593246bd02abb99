"""Bills of materials: valid CycloneDX 1.7, exact, the same for the same files, without keys."""

import base64
import hashlib
import json
import shutil
from datetime import timedelta
from functools import cache

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES, load_private_key, pem
from pqsec_pki.cbom import bill_of
from pqsec_pki.cbom._algorithms import _OTHERS, agreement_row, by_oid, signature_row, symmetric
from pqsec_pki.cbom._assets import Assets
from pqsec_pki.cbom._document import written
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from pqsec_pki.tokens import reference_to
from tests.json_schemas import postpone_grammar
from tests.unit.keystores import DAY, NOW, made


@cache
def validator():
    """Imported when it is first used, as in `tests.json_schemas`."""
    postpone_grammar()
    from cyclonedx.schema import SchemaVersion  # noqa: PLC0415 -- see above
    from cyclonedx.validation.json import JsonStrictValidator  # noqa: PLC0415 -- see above

    return JsonStrictValidator(SchemaVersion.V1_7)


def parsed(document):
    """The bill, which must be valid, by bom-ref."""
    assert validator().validate_str(document) is None
    return {each["bom-ref"]: each for each in json.loads(document)["components"]}


def kinds(components, kind):
    """Properties of the components of that kind."""
    found = {
        "algorithm": "algorithmProperties",
        "certificate": "certificateProperties",
        "protocol": "protocolProperties",
        "related-crypto-material": "relatedCryptoMaterialProperties",
    }
    crypto = {ref: each["cryptoProperties"] for ref, each in components.items()}
    return {ref: each[found[kind]] for ref, each in crypto.items() if each["assetType"] == kind}


@pytest.fixture(scope="module")
def keystores(tmp_path_factory):
    """A keystore of each profile, by its name."""
    root = tmp_path_factory.mktemp("keystores")
    return {each.name: made(root / each.name, each.name) for each in PROFILES}


@pytest.fixture(scope="module")
def bills(keystores):
    """Their bills."""
    return {name: bill_of([each.root], now=NOW) for name, each in keystores.items()}


def test_a_bill_of_each_profile_is_valid_and_complete(bills):
    for name, bill in bills.items():
        components = parsed(bill.document)
        assert bill.unread == ()
        certificates = kinds(components, "certificate")
        names = {each["subjectName"] for each in certificates.values()}
        assert {"CN=/talker", "CN=/listener", "CN=Test Identity CA"} <= names, name
        material = kinds(components, "related-crypto-material").values()
        # Each private key is there with its public key, and neither has a value.
        ids = {kind: {each.get("id") for each in material if each["type"] == kind}
               for kind in ("private-key", "public-key")}  # fmt: skip
        assert len(ids["private-key"]) >= 4
        assert ids["private-key"] <= ids["public-key"], name
        assert not [each for each in material if "value" in each]
        assert {"protocol:DDS:Auth:PKI-DH", "protocol:DDS:Crypto:AES-GCM-GMAC"} <= set(components)


def test_every_reference_leads_to_a_component(bills):
    for name, bill in bills.items():
        document = json.loads(bill.document)
        known = {each["bom-ref"] for each in document["components"]} | {"subject"}
        used = {ref for each in document["dependencies"] for ref in each.get("dependsOn", ())}
        for each in document["components"]:
            for properties in each["cryptoProperties"].values():
                if isinstance(properties, dict):
                    used |= {v for k, v in properties.items() if k.endswith("Ref")}
                    for suite in properties.get("cipherSuites", ()):
                        used |= set(suite["algorithms"])
        assert used <= known, name


def test_suites_and_levels_of_the_handshake(bills):
    suites = {}
    for name, bill in bills.items():
        found = json.loads(bill.document)["components"]
        [protocol] = [each for each in found if each["name"] == "DDS:Auth:PKI-DH"]
        prefix = "pqsec:nistQuantumSecurityLevel:"
        suites[name] = {
            each["name"].removeprefix(prefix): each["value"] for each in protocol["properties"]
        }
    stock = {
        "ECDSA-SHA256 with ECDH+prime256v1-CEUM": "0",
        "ECDSA-SHA256 with DH+MODP-2048-256": "0",
    }
    assert suites == {
        "classical": stock,
        "transition": {"ECDSA-SHA256+ML-DSA-65 with X25519MLKEM768": "3"} | stock,
        "hybrid": {"MLDSA65-ECDSA-P256-SHA512 with X25519MLKEM768": "3"},
        "pq": {"ML-DSA-65 with MLKEM768": "3"},
        "cnsa2": {"ML-DSA-87 with MLKEM1024": "5"},
    }


def test_both_keys_and_signatures_of_a_transition_certificate(bills):
    components = parsed(bills["transition"].document)
    [talker] = [each for each in components.values() if each["name"] == "CN=/talker"]
    properties = {each["name"]: each["value"] for each in talker["properties"]}
    second = components[properties["pqsec:alternativePublicKey"]]["cryptoProperties"]
    material = second["relatedCryptoMaterialProperties"]
    assert material["algorithmRef"] == "algorithm:ml-dsa-65"
    assert properties["pqsec:alternativeSignatureAlgorithm"] == "algorithm:ml-dsa-65"
    main = talker["cryptoProperties"]["certificateProperties"]
    assert main["signatureAlgorithmRef"] == "algorithm:ecdsa-p256"
    assert main["notValidAfter"] == (NOW + 90 * DAY).isoformat()


def test_the_same_files_give_the_same_bytes(keystores, bills, tmp_path):
    copy = tmp_path / "elsewhere" / "transition"
    shutil.copytree(keystores["transition"].root, copy, symlinks=True)
    again = bill_of([copy], now=NOW + timedelta(days=400))
    assert again.document == bills["transition"].document
    timed = bill_of([copy], now=NOW, timestamp=NOW)
    assert validator().validate_str(timed.document) is None
    first, second = json.loads(again.document), json.loads(timed.document)
    assert second["metadata"].pop("timestamp") == NOW.isoformat()
    assert "timestamp" not in first["metadata"]
    assert first == second
    (copy / "enclaves/talker/cert.pem").unlink()
    other = json.loads(bill_of([copy], now=NOW).document)
    assert other["serialNumber"] != first["serialNumber"]


def test_no_octet_of_a_private_key_is_in_a_bill(keystores, bills):
    checked = 0
    for name, keystore in keystores.items():
        document = bills[name].document
        for path in keystore.root.rglob("*key.pem"):
            key = load_private_key(path.read_bytes())
            secret = key.raw if len(key.raw) > 16 else key.pkcs8[-32:]
            for part in (secret, key.pkcs8):
                for text in (part.hex(), base64.b64encode(part).decode()):
                    for start in range(0, len(text) - 24, 8):
                        assert text[start : start + 24] not in document or _is_public(
                            text[start : start + 24], key
                        ), path
            assert "PRIVATE KEY--" not in document
            checked += 1
    assert checked > 20


def _is_public(text, key):
    """Whether that part of PKCS#8 is also in the public key, or says only which algorithm it is."""
    spki = key.public_key.spki
    return text in spki.hex() or text in base64.b64encode(spki).decode()


def test_an_encrypted_key_is_known_by_its_certificate(tmp_path):
    keystore = Keystore.create(
        tmp_path / "k",
        PROFILES[0],
        name="Test",
        domains=DomainSet.parse("0"),
        validity=900 * DAY,
        passphrase=b"correct horse battery staple",
        now=NOW,
    )
    components = parsed(bill_of([keystore.root], now=NOW).document)
    places = {
        place["location"]: each
        for each in components.values()
        if each["bom-ref"].startswith("private-key:")
        for place in each["evidence"]["occurrences"]
    }
    expected = {
        "identity_ca.key.pem": "ecdsa-p256",
        "identity_ca.alt.key.pem": "ml-dsa-65",
        "permissions_ca.key.pem": "ecdsa-p256",
        "permissions_ca.alt.key.pem": "ml-dsa-65",
    }
    assert set(places) == {f"private/{name}" for name in expected}
    for name, algorithm in expected.items():
        material = places[f"private/{name}"]["cryptoProperties"]["relatedCryptoMaterialProperties"]
        assert material["algorithmRef"] == f"algorithm:{algorithm}"
        assert f"public-key:{material['id']}" in components
        assert material["securedBy"] == {
            "mechanism": "passphrase",
            "algorithmRef": "algorithm:PBES2 with PBKDF2 and AES256-CBC",
        }


def test_a_key_in_a_token_is_known_by_its_certificate(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    path = keystore.root / "private/identity_ca.key.pem"
    path.write_bytes(reference_to("pkcs11:token=lab;object=identity-ca"))
    components = parsed(bill_of([keystore.root], now=NOW).document)
    digest = hashlib.sha256(keystore.identity_ca.spki).hexdigest()
    material = kinds(components, "related-crypto-material")[f"private-key:{digest}:elsewhere"]
    assert material["securedBy"] == {"mechanism": "HSM"}


def test_every_row_of_the_tables_is_in_the_schema():
    assets = Assets()
    rows = [*SIGNATURES, *KEY_AGREEMENTS]
    for row in SIGNATURES:
        signature_row(assets, row)
    for row in KEY_AGREEMENTS:
        agreement_row(assets, row)
    for name in _OTHERS:
        symmetric(assets, name)
    by_oid(assets, "1.2.840.113549.1.1.5", None)
    by_oid(assets, "1.2.3.4", None)
    components = parsed(written(assets, "everything", None))
    found = kinds(components, "algorithm")
    for row in rows:
        properties = found[f"algorithm:{row.name}"]
        assert properties["nistQuantumSecurityLevel"] == row.level
        assert properties["classicalSecurityLevel"] >= 112
        # A combination is shown as one, with its parts.
        assert (properties["primitive"] == "combiner") is bool(row.parts), row.name
        assert ("algorithmFamily" in properties) is not bool(row.parts)
    needs = {
        each["ref"]: each.get("dependsOn", [])
        for each in json.loads(written(assets, "everything", None))["dependencies"]
    }
    assert needs["algorithm:x25519mlkem768"] == ["algorithm:mlkem768", "algorithm:x25519"]
    assert needs["algorithm:mldsa65-ecdsa-p256-sha512"] == [
        *("algorithm:ecdsa-p256", "algorithm:ml-dsa-65"),
    ]
    assert found["algorithm:RSA with SHA-1"]["nistQuantumSecurityLevel"] == 0
    assert "nistQuantumSecurityLevel" not in found["algorithm:1.2.3.4"]


def test_facts_of_the_standards():
    """OIDs of RFC 5758, 8017, 9881 and NIST CSOR; categories of FIPS 203 and 204."""
    assets = Assets()
    for row in SIGNATURES:
        signature_row(assets, row)
    for row in KEY_AGREEMENTS:
        agreement_row(assets, row)
    components = parsed(written(assets, "facts", None))
    facts = {
        "ecdsa-p256": ("1.2.840.10045.4.3.2", 128, 0, "ECDSA", "nist/P-256"),
        "ecdsa-p384": ("1.2.840.10045.4.3.3", 192, 0, "ECDSA", "nist/P-384"),
        "rsa-2048": ("1.2.840.113549.1.1.11", 112, 0, "RSASSA-PKCS1", None),
        "rsa-3072": ("1.2.840.113549.1.1.11", 128, 0, "RSASSA-PKCS1", None),
        "ml-dsa-44": ("2.16.840.1.101.3.4.3.17", 128, 2, "ML-DSA", None),
        "ml-dsa-65": ("2.16.840.1.101.3.4.3.18", 192, 3, "ML-DSA", None),
        "ml-dsa-87": ("2.16.840.1.101.3.4.3.19", 256, 5, "ML-DSA", None),
        "mldsa65-ecdsa-p256-sha512": ("1.3.6.1.5.5.7.6.45", 192, 3, None, None),
        "ecdh-p256": ("1.3.132.1.12", 128, 0, "ECDH", "nist/P-256"),
        "dh-modp-2048-256": (None, 112, 0, "FFDH", None),
        "mlkem768": ("2.16.840.1.101.3.4.4.2", 192, 3, "ML-KEM", None),
        "mlkem1024": ("2.16.840.1.101.3.4.4.3", 256, 5, "ML-KEM", None),
        "x25519mlkem768": (None, 192, 3, None, None),
    }
    for name, fact in facts.items():
        crypto = components[f"algorithm:{name}"]["cryptoProperties"]
        properties = crypto["algorithmProperties"]
        found = (
            crypto.get("oid"),
            properties["classicalSecurityLevel"],
            properties["nistQuantumSecurityLevel"],
            properties.get("algorithmFamily"),
            properties.get("ellipticCurve"),
        )
        assert found == fact, name


def test_what_cannot_be_read_is_told(keystores, tmp_path):
    root = tmp_path / "pq"
    shutil.copytree(keystores["pq"].root, root, symlinks=True)
    broken = {
        "enclaves/talker/cert.pem": pem("CERTIFICATE", b"no certificate"),
        "enclaves/talker/key.pem": pem("PRIVATE KEY", b"no key"),
        "enclaves/talker/permissions.p7s": b"Content-Type: multipart/signed;\n\n",
        "enclaves/talker/other.der": b"\x30\x03\x02\x01\x07",
    }
    for name, data in broken.items():
        (root / name).write_bytes(data)
    bill = bill_of([root], now=NOW)
    parsed(bill.document)
    told = {each.path.relative_to(root).as_posix() for each in bill.unread}
    assert told >= set(broken)


def test_names_of_files_that_are_no_text(keystores, tmp_path):
    name = b"<b>\xff\x1b.pem".decode("utf-8", "surrogateescape")
    source = keystores["classical"].root / "public/identity_ca.cert.pem"
    (tmp_path / name).write_bytes(source.read_bytes())
    components = parsed(bill_of([tmp_path], now=NOW).document)
    [certificate] = [ref for ref in components if ref.startswith("certificate:")]
    [place] = components[certificate]["evidence"]["occurrences"]
    assert place["location"] == "<b>\\xff\x1b.pem"


def test_the_name_of_the_folder_may_be_no_text_and_nothing_in_a_bill_commands_a_terminal(
    keystores, tmp_path
):
    folder = tmp_path / b"k\xff\xc2\x9b31m".decode("utf-8", "surrogateescape")
    folder.mkdir()
    source = keystores["classical"].root / "public/identity_ca.cert.pem"
    (folder / "ca.pem").write_bytes(source.read_bytes())
    document = bill_of([folder], now=NOW).document
    assert document.isascii()
    assert json.loads(document)["metadata"]["component"]["name"] == "k\\xff\x9b31m"
