"""Questions about a keystore believe only what a robot would install."""

import shutil
from datetime import UTC, datetime

import pytest

from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import Credentials, verify_credentials
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import enclave_files
from pqsec_pki.smime import Signer, document_in, sign

GOVERNANCE = "k/enclaves/governance.p7s"
EXPLAIN = "-k k --json explain --participant /talker --join"
VERIFY = f"-k k --json verify {GOVERNANCE}"
WHO_MAY = "who-may k --json"


def signed_anew(k, place, signer):
    path = k / f"enclaves/{place}"
    document = document_in(path.read_bytes())
    path.write_bytes(sign(document, signer, now=datetime.now(UTC)))


def signer_in(folder, role):
    certificate = Certificate.from_pem((folder / f"public/{role}.cert.pem").read_bytes())
    key = load_private_key((folder / f"private/{role}.key.pem").read_bytes(), None)
    return Signer(certificate, key)


def one_key_for_two_roles(k, _other):
    shutil.copy(k / "public/identity_ca.cert.pem", k / "public/permissions_ca.cert.pem")
    for place in ("governance.p7s", "talker/permissions.p7s", "listener/permissions.p7s"):
        signed_anew(k, place, signer_in(k, "identity_ca"))


def doubled(role):
    def change(k, other):
        path = k / f"public/{role}.cert.pem"
        source = k if role == "identity_ca" else other
        path.write_bytes(path.read_bytes() + (source / f"public/{role}.cert.pem").read_bytes())

    return change


def countersigner_lost(k, _other):
    (k / "public/permissions_ca.alt.cert.pem").unlink()
    for name in ("talker", "listener"):
        (k / f"enclaves/{name}/permissions_ca.alt.cert.pem").unlink()


def governance_of_another_ca(k, other):
    path = k / "enclaves/talker/governance.p7s"
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content)
    signed_anew(k, "talker/governance.p7s", signer_in(other, "permissions_ca"))


def certificate_of_another(k, _other):
    shutil.copy(k / "enclaves/listener/cert.pem", k / "enclaves/talker/cert.pem")
    for name in ("key.pem", "permissions.p7s"):
        shutil.copy(k / f"enclaves/listener/{name}", k / f"enclaves/talker/{name}")


ALL = (EXPLAIN, WHO_MAY, VERIFY)
"""What is wrong with the keystore, and the questions that it spoils."""
SPOILT = {
    "one key for two roles": ("classical", one_key_for_two_roles, ALL),
    "two permissions CAs": ("classical", doubled("permissions_ca"), ALL),
    "an identity CA twice": ("classical", doubled("identity_ca"), (EXPLAIN, WHO_MAY)),
    "the countersigner is lost": (
        "transition",
        countersigner_lost,
        (*ALL, f"{VERIFY} --require any"),
    ),
    "governance of another CA": ("classical", governance_of_another_ca, (EXPLAIN, WHO_MAY)),
    "certificate of another": ("classical", certificate_of_another, (EXPLAIN, WHO_MAY)),
}


def believes(said):
    """who-may answers for the others, and names the participants that it leaves out."""
    return said.code == 0 and "/talker" not in said.json.get("left_out", ())


@pytest.mark.parametrize("name", SPOILT)
def test_no_question_believes_what_install_refuses(pqsec, keystore, name):
    profile, change, lines = SPOILT[name]
    k, other = keystore(profile), keystore(profile, "other", "another")
    for line in lines:
        assert pqsec(line).code == 0, line
    change(k, other)
    with pytest.raises(PqsecError):
        verify_credentials(
            Credentials.of("/talker", enclave_files(k, "/talker")), now=datetime.now(UTC)
        )
    assert [line for line in lines if believes(pqsec(line))] == []
