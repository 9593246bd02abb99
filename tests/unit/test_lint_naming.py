"""Names across all checked files: which participant can pass for another on Cyclone DDS."""

from dataclasses import replace

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.lint import check
from pqsec_pki.lint.keystores import names
from tests.unit.test_lint_documents import NOW, YEAR

KEY, OTHER_KEY = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))


def name(text):
    parts = []
    for part in text.split(","):
        oids = {"CN": NameOID.COMMON_NAME, "O": NameOID.ORGANIZATION_NAME}
        oids["OU"] = NameOID.ORGANIZATIONAL_UNIT_NAME
        pairs = [each.split("=") for each in part.split("+")]
        parts.insert(0, x509.RelativeDistinguishedName(
            x509.NameAttribute(oids[word], value) for word, value in pairs))  # fmt: skip
    return x509.Name(parts)


def certificate(subject, key=KEY):
    builder = x509.CertificateBuilder(
        issuer_name=name("CN=CA"),
        subject_name=name(subject),
        public_key=key.public_key(),
        serial_number=7,
        not_valid_before=NOW - YEAR,
        not_valid_after=NOW + YEAR,
    )
    return builder.sign(KEY, hashes.SHA256()).public_bytes(Encoding.PEM)


def permissions(subject):
    grant = Grant.least(
        subject_name=subject,
        not_before=NOW - YEAR,
        not_after=NOW + YEAR,
        domains=DomainSet.of(0),
        publish=("rt/chatter",),
    )
    return Permissions(grants=(grant,)).to_xml()


def found_in(folder, id_, files):
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return [each for each in check([folder], now=NOW).findings if each.rule.id == id_]


def folder_of(certificates, grants):
    files = {f"c{n}/cert.pem": certificate(each) for n, each in enumerate(certificates)}
    return files | {f"g{n}/permissions.xml": permissions(each) for n, each in enumerate(grants)}


@pytest.mark.parametrize(
    ("certificates", "grants", "message"),
    [
        (
            ["CN=/robot"],
            ["CN=/robot/admin"],
            "CN=/robot may use the permissions of CN=/robot/admin",
        ),
        ([], ["CN=/robot", "CN=/robot/admin"], "CN=/robot may use the permissions of"),
        (["CN=/x/a"], ["CN=/a/x"], "CN=/x/a may use the permissions of CN=/a/x"),
        (["CN=a"], ["CN=a,O=Lab"], "CN=a may use the permissions of CN=a,O=Lab"),
        (["CN=/robot"], ["CN=/robot|b"], "CN=/robot may use"),
    ],
)
def test_a_name_whose_pieces_are_in_another_is_told(tmp_path, certificates, grants, message):
    [finding] = found_in(tmp_path, "PQS401", folder_of(certificates, grants))
    assert message in finding.message
    assert finding.path.name == "permissions.xml"
    assert finding.line == 4


@pytest.mark.parametrize(
    ("certificates", "grants"),
    [
        (["CN=/robot"], ["CN=/robot"]),
        (["CN=/robot/driver"], ["CN=/robot/admin"]),
        (["CN=/robot/admin"], ["CN=/robot"]),
        (["CN=/robot1"], ["CN=/robot/admin"]),
        (["CN=x,O=Lab"], ["CN=x,O=Lab", "O=Lab,CN=x"]),
    ],
)
def test_names_that_cannot_be_confused_are_not(tmp_path, certificates, grants):
    assert found_in(tmp_path, "PQS401", folder_of(certificates, grants)) == []


def test_of_a_thousand_names_few_are_compared(tmp_path, monkeypatch):
    [grant] = Permissions.from_xml(permissions("CN=/fleet/robot0/arm")).grants
    names_of_grants = (f"CN=/fleet/robot{n}/arm" for n in range(1000))
    document = Permissions(
        grants=tuple(replace(grant, name=each, subject_name=each) for each in names_of_grants)
    )
    compared = []
    may_pass = names._may_pass
    monkeypatch.setattr(names, "_may_pass", lambda *two: compared.append(two) or may_pass(*two))
    files = {"a/permissions.xml": document.to_xml(), "b/cert.pem": certificate("CN=/fleet/robot7")}
    [finding] = found_in(tmp_path, "PQS401", files)
    assert "CN=/fleet/robot7/arm" in finding.message
    assert len(compared) < 3000  # and not each with each


def two_enclaves(one, other):
    return {
        f"enclaves/{place}/{file}": data
        for place, pem in (("a", one), ("b", other))
        for file, data in (("cert.pem", pem), ("key.pem", b"no key"))
    }


def test_two_participants_of_one_name_are_told(tmp_path):
    files = two_enclaves(certificate("CN=/a"), certificate("CN=/a", OTHER_KEY))
    [finding] = found_in(tmp_path, "PQS402", files)
    assert finding.path == tmp_path / "enclaves/b/cert.pem"
    assert "/a has the same subject" in finding.message


def test_the_set_before_the_current_one_is_not_another_participant(tmp_path):
    keys = (certificate("CN=/a"), certificate("CN=/a", OTHER_KEY))
    files = {
        f"{robot}/installed/{number}/enclaves/a/{name}": data
        for robot in ("r1", "r2")
        for number, pem in enumerate(keys, 1)
        for name, data in (("cert.pem", pem), ("key.pem", b"no key"))
    }
    one = {path: data for path, data in files.items() if path.startswith("r1/")}
    assert found_in(tmp_path / "one", "PQS402", one) == []
    assert len(found_in(tmp_path / "two", "PQS402", files)) == 1


@pytest.mark.parametrize(("subject", "key"), [("CN=/a", KEY), ("CN=/b", OTHER_KEY)])
def test_one_participant_in_two_places_and_two_of_two_names_are_not(tmp_path, subject, key):
    files = two_enclaves(certificate("CN=/a"), certificate(subject, key))
    assert found_in(tmp_path, "PQS402", files) == []


@pytest.mark.parametrize(
    ("id_", "subject"), [("PQS431", "CN=x,OU=a,OU=b"), ("PQS432", "CN=x+OU=a,O=b")]
)
def test_a_certificate_whose_subject_no_grant_fits_is_told(tmp_path, id_, subject):
    [finding] = found_in(tmp_path, id_, {"cert.pem": certificate(subject)})
    assert "the subject " in finding.message
    assert found_in(tmp_path, id_, {"cert.pem": certificate("CN=x,OU=a,O=b")}) == []
