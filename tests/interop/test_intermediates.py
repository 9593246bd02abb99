"""An issuing CA under a root: which stack takes it, and what a root would be good for there."""

from datetime import timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, load_private_key, private_key_pem
from pqsec_pki.certificates import Authority, Certificate, RevokedCertificate, revocation_list
from pqsec_pki.credentials import Credentials, verify_credentials
from pqsec_pki.errors import PqsecError
from tests.interop.cyclone import RefusedError
from tests.interop.either import participants_of, shake_hands
from tests.unit.linting import certificate

pytestmark = pytest.mark.interop

DAY = timedelta(days=1)
CA, CERTIFICATE, KEY, LIST = "identity_ca.cert.pem", "cert.pem", "key.pem", "crl.pem"


class Root:
    """A root, and CAs that it certified."""

    def __init__(self, now):
        self.now = now
        self.own = self._ca("Root", None)

    def issuing(self, name):
        return self._ca(name, self.own)

    def _ca(self, name, above):
        """Without a limit of the path's length, which pqsec's own CAs have."""
        key = SIGNATURES.named("ecdsa-p256").generate()
        signer = above.key if above else key
        pem = certificate(
            name,
            ca=True,
            key=key.handle,
            issuer="Root",
            signer=signer.handle,
            begin=self.now - DAY,
            end=self.now + 90 * DAY,
        )
        return Authority(Certificate.from_pem(pem), key)

    def files(self, by, name, *, trusted):
        """The files of a participant that `by` certified, who trusts these CAs."""
        key = SIGNATURES.named("ecdsa-p256").generate()
        made = by.issue(f"/lab/{name}", key.public_key, now=self.now, validity=30 * DAY)
        cas = b"".join(each.certificate.pem for each in trusted)
        return {CA: cas, CERTIFICATE: made.pem, KEY: private_key_pem(key)}

    def crl(self, by, *revoked):
        rows = [RevokedCertificate(each.serial_number, self.now, None) for each in revoked]
        made = revocation_list(by, rows, number=1, now=self.now, validity=30 * DAY)
        return made.pem


@pytest.fixture
def root(now):
    return Root(now)


@pytest.fixture
def meets(request, labs, enclave):
    """meets(stack, files of alice, files of bob): both join, and shake hands."""

    def meet(stack, alice, bob):
        lab = labs("classical")
        with participants_of(stack, request) as starts:
            shake_hands(starts, enclave(lab.alice, alice), enclave(lab.bob, bob))()

    return meet


def pair(root, by, *, trusted):
    return [root.files(by, name, trusted=trusted) for name in ("alice", "bob")]


def test_fast_dds_finds_an_issuing_ca_after_its_root(root, meets):
    issuing = root.issuing("Issuing")
    meets("fastdds", *pair(root, issuing, trusted=[root.own, issuing]))


@pytest.mark.parametrize("order", ["root first", "issuing first", "issuing alone"])
def test_cyclone_dds_takes_no_issuing_ca(root, meets, order):
    issuing = root.issuing("Issuing")
    trusted = {
        "root first": [root.own, issuing],
        "issuing first": [issuing, root.own],
        "issuing alone": [issuing],
    }[order]
    with pytest.raises(RefusedError):
        meets("cyclone", *pair(root, issuing, trusted=trusted))


def test_fast_dds_takes_no_issuing_ca_without_its_root(root, meets):
    issuing = root.issuing("Issuing")
    with pytest.raises(RefusedError):
        meets("fastdds", *pair(root, issuing, trusted=[issuing]))


def test_a_root_spares_no_robot_the_file_of_a_new_issuing_ca(root, meets):
    """The certificate of the issuing CA is not sent: who has not its file refuses the peer."""
    first, second = root.issuing("Issuing 1"), root.issuing("Issuing 2")
    alice = root.files(first, "alice", trusted=[root.own, first])
    bob = root.files(second, "bob", trusted=[root.own, second])
    with pytest.raises(RefusedError):
        meets("fastdds", alice, bob)


def test_a_root_that_is_trusted_also_issues(root, meets):
    """An attacker with the root's key needs no issuing CA."""
    issuing = root.issuing("Issuing")
    alice = root.files(issuing, "alice", trusted=[root.own, issuing])
    meets("fastdds", alice, root.files(root.own, "bob", trusted=[root.own, issuing]))


def test_a_list_of_the_root_does_not_revoke_an_issuing_ca(root, meets):
    """Fast DDS looks for the participant's own certificate only."""
    issuing = root.issuing("Issuing")
    alice, bob = pair(root, issuing, trusted=[root.own, issuing])
    of_root = root.crl(root.own, issuing.certificate)
    both = root.crl(issuing) + of_root
    meets("fastdds", {**alice, CA: alice[CA] + both}, {**bob, CA: bob[CA] + both})
    names_alice = root.crl(issuing, Certificate.from_pem(alice[CERTIFICATE])) + of_root
    with pytest.raises(RefusedError):  # the lists are read
        meets("fastdds", alice, {**bob, CA: bob[CA] + names_alice})


@pytest.mark.parametrize("order", [1, -1], ids=["root first", "issuing first"])
def test_pqsec_and_its_plugin_refuse_it(root, labs, enclave, now, order):
    issuing = root.issuing("Issuing")
    trusted = [root.own, issuing][::order]
    folder = enclave(labs("classical").alice, root.files(issuing, "alice", trusted=trusted))
    files = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    with pytest.raises(PqsecError):
        verify_credentials(Credentials.of("/lab/alice", files, None, folder=folder), now=now)
    load_private_key(files[KEY])  # it is not the key that is refused
