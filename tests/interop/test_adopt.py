"""A keystore that OpenSSL made is adopted and rotated, and real stacks run with it throughout."""

import pytest

from pqsec_pki.documents import Governance, Grant, Permissions
from pqsec_pki.keystore import audit
from pqsec_pki.lifecycle import Rollover, adopt, renew, revoke
from tests.interop.conftest import DOMAINS, TOPIC
from tests.interop.either import STACKS, meet, participants_of
from tests.unit.keystores import rotate

pytestmark = pytest.mark.interop

NAMES = ("/alice", "/bob")
LINKS = (
    "enclaves/governance.p7s",
    "public/identity_ca.cert.pem",
    "public/permissions_ca.cert.pem",
)


@pytest.fixture(params=STACKS)
def starts(request):
    """starts(folder) is a participant of a DDS stack."""
    with participants_of(request.param, request) as made:
        yield made


@pytest.fixture(params=["rsa:2048", "ec -pkeyopt ec_paramgen_curve:P-256"])
def made(request, openssl, tmp_path, now):
    """A keystore in SROS2's layout, of two CAs and two participants with longer names."""
    root, kind = tmp_path / "k", request.param.split()
    for folder in ("public", "private", *(f"enclaves{name}" for name in NAMES)):
        (root / folder).mkdir(parents=True)
    for ca in ("identity_ca", "permissions_ca"):
        openssl(
            *("req", "-x509", "-newkey", *kind, "-nodes", "-days", "3650"),
            *("-subj", f"/O=Lab/CN={ca}"),
            *("-keyout", root / f"private/{ca}.key.pem", "-out", root / f"public/{ca}.cert.pem"),
        )
    sign(openssl, root, "enclaves/governance", Governance.protected(DOMAINS).to_xml())
    for number, name in enumerate(NAMES, start=1):
        enrol(openssl, root, name, number, kind)
        sign(openssl, root, f"enclaves{name}/permissions", permissions(name, now))
        for link in LINKS:
            (root / f"enclaves{name}" / link.partition("/")[2]).symlink_to(f"../../{link}")
    return root


def enrol(openssl, root, name, number, kind):
    folder, public, private = root / f"enclaves{name}", root / "public", root / "private"
    openssl(
        *("req", "-newkey", *kind, "-nodes", "-subj", f"/O=Lab/CN={name[1:]}"),
        *("-keyout", folder / "key.pem", "-out", folder / "request.csr"),
    )
    openssl(
        *("x509", "-req", "-in", folder / "request.csr", "-CA", public / "identity_ca.cert.pem"),
        *("-CAkey", private / "identity_ca.key.pem", "-set_serial", str(number), "-days", "365"),
        *("-out", folder / "cert.pem"),
    )
    (folder / "request.csr").unlink()


def sign(openssl, root, place, xml):
    (root / f"{place}.xml").write_bytes(xml)
    openssl(
        *("smime", "-sign", "-in", root / f"{place}.xml", "-text", "-out", root / f"{place}.p7s"),
        *("-signer", root / "public/permissions_ca.cert.pem"),
        *("-inkey", root / "private/permissions_ca.key.pem"),
    )


def permissions(name, now):
    grant = Grant.least(
        subject_name=f"CN={name[1:]},O=Lab",
        not_before=now.replace(year=now.year - 1),
        not_after=now.replace(year=now.year + 1),
        domains=DOMAINS,
        publish=[TOPIC],
        subscribe=[TOPIC],
    )
    return Permissions(grants=(grant,)).to_xml()


def both(root):
    return [root / f"enclaves{name}" for name in NAMES]


@pytest.mark.slow(but=1)
def test_stacks_run_with_it_as_it_was_adopted_renewed_and_rotated(made, starts, now):
    done = adopt(made, now=now)
    assert done.participants == list(NAMES)
    assert (done.refused, done.one_ca, done.fitting) == ({}, False, True)
    audit(done.keystore)
    meet(starts, *both(made))
    renew(done.keystore, done.keystore.unlock(None), NAMES, now=now)
    meet(starts, *both(made))
    new = rotate(done.keystore, Rollover(profile=done.keystore.profile), passphrase=None, now=now)
    meet(starts, *both(made))
    audit(new.keystore)


@pytest.mark.slow
def test_who_is_revoked_after_that_is_in_openssls_list(made, openssl, now):
    keystore = adopt(made, now=now).keystore
    revoke(keystore, keystore.unlock(None), ["/alice"], now=now)
    folder = made / "enclaves/alice"
    words = openssl.refuses(
        *("verify", "-crl_check", "-CAfile", folder / "identity_ca.cert.pem"),
        *("-CRLfile", folder / "crl.pem", folder / "cert.pem"),
    )
    assert "certificate revoked" in words
