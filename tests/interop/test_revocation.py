"""Others take our revocation lists: they refuse the peers that a list names, and no others.

OpenSSL judges the lists themselves; the plugins of Cyclone DDS and Fast DDS decide whether
a participant with a list starts, and which peers it lets in.
"""

import json
import shlex
import shutil
from contextlib import ExitStack
from datetime import timedelta
from functools import cache, partial

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.lifecycle import renew_list, revoke
from tests.interop.conftest import LAB_PROFILES, ML_DSA_ONLY, STOCK, Lab
from tests.interop.cyclone import RefusedError
from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.der import Der
from tests.interop.either import shake_hands
from tests.interop.fastdds import participant as fastdds_participant
from tests.interop.test_openssl import ALT_VALUE, ml_dsa_holds
from tests.running import clean_environment, run_here

pytestmark = pytest.mark.interop

EXTENSIONS, ALT_KEY = 0xA0, bytes.fromhex("0603551d48")


@pytest.fixture(scope="module")
def revoked(tmp_path_factory, now):
    """revoked("transition") is a lab of its own where alice was revoked."""
    folder = tmp_path_factory.mktemp("revoked")

    def make(name):
        lab = Lab.create(folder / name, LAB_PROFILES[name], now)
        revoke(lab.keystore, lab.authorities, ["/lab/alice"], reason=Reason.KEY_COMPROMISE, now=now)
        return lab

    return cache(make)


JUDGED = [*((profile, "system") for profile in STOCK)]
JUDGED += [(profile, "3.5") for profile in (*STOCK, *ML_DSA_ONLY)]
each_judge = pytest.mark.parametrize(
    ("profile", "any_openssl"), JUDGED, indirect=["any_openssl"], ids=" by ".join
)


# OpenSSL


def checked(folder, crl="crl.pem"):
    """A certificate against its CA and the list, strictly."""
    ca, known = folder / "identity_ca.cert.pem", folder / crl
    options = ("-x509_strict", "-crl_check", "-CAfile", ca, "-CRLfile", known)
    return ("verify", *options, folder / "cert.pem")


@pytest.mark.slow(but=4)
@each_judge
def test_openssl_refuses_whom_the_list_names_and_nobody_else(revoked, any_openssl, profile):
    lab = revoked(profile)
    any_openssl(*checked(lab.bob))
    assert "certificate revoked" in any_openssl.refuses(*checked(lab.alice))


@each_judge
def test_openssl_refuses_a_list_that_was_altered(revoked, any_openssl, enclave, profile):
    lab = revoked(profile)
    der = any_openssl("crl", "-in", lab.bob / "crl.pem", "-outform", "DER")
    serial = lab.keystore.revocation_list.revoked[0].serial_number
    octets = serial.to_bytes((serial.bit_length() + 8) // 8, "big")
    assert der.count(octets) == 1
    other = der.replace(octets, octets[:-1] + bytes([octets[-1] ^ 1]))
    pem = any_openssl("crl", "-inform", "DER", stdin=other)
    words = any_openssl.refuses(*checked(enclave(lab.alice, {"crl.pem": pem})))
    assert "CRL signature failure" in words


@each_judge
def test_openssl_reads_in_the_list_what_we_wrote(revoked, any_openssl, profile):
    crl = revoked(profile).bob / "crl.pem"
    text = any_openssl("crl", "-in", crl, "-noout", "-text").decode(errors="replace")
    assert "Version 2 (0x1)" in text
    assert "X509v3 CRL Reason Code: \n                Key Compromise" in text
    words = any_openssl("crl", "-in", crl, "-noout", "-crlnumber").decode()
    assert words.strip() in {"crlNumber=01", "crlNumber=0x01"}


def test_the_alternative_signature_of_a_list_holds(revoked, openssl35, put):
    # ITU-T X.509 (10/2019) 9.8: over all but the field signature and altSignatureValue
    folder = revoked("transition").bob
    whole = Der(openssl35("crl", "-in", folder / "crl.pem", "-outform", "DER"))
    version, _signature, *rest, extensions = whole.parts[0].parts
    [listed] = extensions.parts
    by_oid = {bytes(each.parts[0]): each for each in listed.parts}
    kept = b"".join(each for oid, each in by_oid.items() if oid != ALT_VALUE)
    covered = Der.of(0x30, b"".join([version, *rest, Der.of(EXTENSIONS, Der.of(0x30, kept))]))
    value = Der(by_oid[ALT_VALUE].parts[-1].content)
    ca = Der(openssl35("x509", "-in", folder / "identity_ca.cert.pem", "-outform", "DER"))
    [in_ca] = ca.parts[0].parts[-1].parts
    spki = next(each for each in in_ca.parts if bytes(each.parts[0]) == ALT_KEY)
    ml_dsa_holds(openssl35, put, spki.parts[-1].content, value.content[1:], covered)


# DDS stacks


@pytest.fixture(params=["cyclone", "fastdds"])
def starts(request, tmp_path):
    """starts(folder) is a participant of a DDS stack; it has a list if its folder has one."""
    if request.param == "cyclone":
        make = partial(cyclone_participant, request.getfixturevalue("plugins"))
    else:
        make = partial(_with_list, request.getfixturevalue("fastdds"))
    with ExitStack() as stack:
        yield lambda folder: stack.enter_context(make(folder))


def _with_list(shim, folder):
    crl = folder / "crl.pem"
    return fastdds_participant(
        shim, folder, **({"identity_crl": f"file://{crl}"} if crl.exists() else {})
    )


@pytest.mark.parametrize("profile", STOCK)
def test_a_revoked_participant_does_not_start(revoked, starts, profile):
    starts(revoked(profile).bob)
    with pytest.raises(RefusedError, match="validate_local_identity"):
        starts(revoked(profile).alice)


@pytest.mark.parametrize("profile", STOCK)
def test_a_revoked_peer_that_hides_the_list_is_refused(revoked, starts, enclave, profile):
    lab = revoked(profile)
    hiding = enclave(lab.alice, {})
    (hiding / "crl.pem").unlink()
    with pytest.raises(RefusedError) as refusal:
        shake_hands(starts, hiding, lab.bob)
    assert str(refusal.value).startswith(("begin_handshake_reply", "process_handshake"))


def test_without_the_list_a_revoked_peer_is_let_in(revoked, starts, enclave):
    """Why the list must reach everybody; and that it is the list that refuses above."""
    folders = [enclave(each, {}) for each in (revoked("classical").alice, revoked("classical").bob)]
    for folder in folders:
        (folder / "crl.pem").unlink()
    shake_hands(starts, *folders)


def test_two_who_are_not_named_meet_with_an_empty_list(labs, starts, tmp_path, now):
    lab = Lab.create(tmp_path / "k", LAB_PROFILES["transition"], now)
    renew_list(lab.keystore, lab.authorities, now=now)
    shake_hands(starts, lab.alice, lab.bob)


def test_with_a_list_that_has_ended_nobody_starts(starts, tmp_path, now):
    lab = Lab.create(tmp_path / "k", LAB_PROFILES["transition"], now)
    before, day = now - timedelta(hours=6), timedelta(hours=1)
    renew_list(lab.keystore, lab.authorities, now=before, validity=day)
    with pytest.raises(RefusedError, match="validate_local_identity"):
        starts(lab.bob)


@pytest.mark.slow
def test_after_the_printed_command_a_stock_cyclone_refuses_the_thief(plugins, tmp_path, requires):
    """`revoke` sent ROS 2 users away: the robots' copies went on, and the thief's stop arrived."""
    requires(shutil.which("gcc"), "a C compiler", "apt install gcc cyclonedds-dev")
    environment = clean_environment()

    def pqsec(*words):
        return run_here([str(each) for each in words], cwd=tmp_path, env=environment)

    def meets(name):
        found = pqsec("-k", "robot", "try", "cyclonedds", name, "/arm", "--timeout", "20")
        return found[0], "".join(found[1:])

    pqsec("-k", "k", "ca", "init", "--no-passphrase", "--profile", "classical")
    pqsec("-k", "k", "issue", "/arm", "--ros-node", "/arm", "--ros-subscribe", "/estop")
    for name in ("/thief", "/desk"):
        pqsec("-k", "k", "issue", name, "--ros-node", name, "--ros-publish", "/estop")
    shutil.copytree(tmp_path / "k", tmp_path / "robot", symlinks=True)  # what robots have
    code, told, _ = pqsec("-k", "k", "revoke", "/thief", "--yes", "--json")
    delivery = json.loads(told)["delivery"]
    assert code == 0
    assert [each["name"] for each in delivery["late"]] == ["/arm", "/desk"]
    assert [each["name"] for each in delivery["accepted"]] == ["/thief"]
    assert meets("/thief")[0] == 0  # it is true: the robot accepts the thief
    [command] = delivery["commands"]
    assert pqsec(*shlex.split(command)[1:])[0] == 0
    shutil.copy(tmp_path / "crl.pem", tmp_path / "robot/enclaves/arm/crl.pem")
    code, words = meets("/thief")
    assert code == 1
    assert "certificate revoked" in words
    assert meets("/desk")[0] == 0
