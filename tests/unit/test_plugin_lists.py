"""Which revocation list counts for a participant of the agent: its own, and never an older one."""

import shutil

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from pqsec_pki.certificates import Certificate
from pqsec_pki.lifecycle import renew_list
from pqsec_pki.plugin.lists import NewestLists
from tests.unit.chains import issuing
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import RefusedError, Shim, shaken, side

LIST = {"org.eclipse.cyclonedds.sec.auth.crl": "file:crl.pem"}
UNKNOWN = x509.UnrecognizedExtension(x509.ObjectIdentifier("1.3.6.1.4.1.55555.1"), b"\5\0")
"""Critical, it may say that the list speaks for some certificates only."""


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    return made(tmp_path_factory.mktemp("k") / "k", "classical")


@pytest.fixture
def enclave(keystore, tmp_path):
    """enclave(name) is a copy of that participant's files; another one with a second word."""

    def copy(name, other=""):
        folder = tmp_path / f"{name}{other}"
        return shutil.copytree(keystore.root / "enclaves" / name, folder, symlinks=False)

    return copy


def certificate(folder):
    return Certificate.from_pem((folder / "cert.pem").read_bytes())


def put(keystore, folder, number, *revoked, at=NOW, **critical):
    """A list of the keystore's CA in the place of `crl.pem`; without a number if that is None.

    `critical` are extensions of the whole, and of each entry.
    """
    ca = (keystore.root / "public/identity_ca.cert.pem").read_bytes()
    key = (keystore.root / "private/identity_ca.key.pem").read_bytes()
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(x509.load_pem_x509_certificate(ca).subject)
        .last_update(at)
        .next_update(at + 30 * DAY)
    )
    if number is not None:
        builder = builder.add_extension(x509.CRLNumber(number), critical=False)
    if "whole" in critical:
        builder = builder.add_extension(critical["whole"], critical=True)
    for each in revoked:
        entry = x509.RevokedCertificateBuilder().revocation_date(at)
        entry = entry.serial_number(certificate(each).serial_number)
        if "entry" in critical:
            entry = entry.add_extension(critical["entry"], critical=True)
        builder = builder.add_revoked_certificate(entry.build())
    made_list = builder.sign(load_pem_private_key(key, None), hashes.SHA256())
    pem = made_list.public_bytes(Encoding.PEM)
    (folder / "crl.pem").unlink(missing_ok=True)
    (folder / "crl.pem").write_bytes(pem)


def told(shim):
    found = []
    while handle := shim.call("find_revoked")[1]:
        found.append(handle)
    return found


@pytest.fixture
def met(keystore, enclave):
    """Listener after its handshake with talker, who is on list 7: shim, folders and handle."""
    listener, talker = enclave("listener"), enclave("talker")
    put(keystore, listener, 6)
    here, there = side(listener, **LIST), side(talker)
    ends = shaken(here, there)
    [peer] = [peer for shim, _, peer in ends if shim is here[0]]
    put(keystore, listener, 7, talker)
    assert told(here[0]) == [peer]
    return here, listener, talker


def test_a_peer_of_whom_a_newer_list_does_not_speak_is_told_in_mid_session(keystore, enclave):
    listener, talker = enclave("listener"), enclave("talker")
    put(keystore, listener, 6)
    here, there = side(listener, **LIST), side(talker)
    [peer] = [peer for shim, _, peer in shaken(here, there) if shim is here[0]]
    assert told(here[0]) == []
    put(keystore, listener, 7, whole=issuing("http://lab.example/others"))
    assert peer in told(here[0])


def test_an_older_list_is_not_taken_in_mid_session_and_the_newer_goes_on_counting(keystore, met):
    here, listener, talker = met
    put(keystore, listener, 6, at=NOW)  # as it was, which the CA signed too
    for _ in range(2):  # and it is told again as long as it lies there
        with pytest.raises(RefusedError, match="list 6 is older than list 7"):
            told(here[0])
    with pytest.raises(RefusedError, match="was revoked on"):
        shaken(here, side(talker))
    assert any("which stays in force" in line for line in here[0].log)


def test_a_list_of_the_same_number_and_a_newer_one_are_taken(keystore, met):
    here, listener, talker = met
    for number in (7, 8):
        put(keystore, listener, number)
        assert told(here[0]) == []
        assert shaken(here, side(talker))


def test_a_list_without_a_number_is_taken_and_does_not_lower_the_mark(keystore, met):
    here, listener, talker = met
    put(keystore, listener, None)
    assert told(here[0]) == []
    assert shaken(here, side(talker))
    put(keystore, listener, 6)
    with pytest.raises(RefusedError, match="list 6 is older than list 7"):
        told(here[0])


def test_a_list_without_a_number_is_nothing_that_others_are_compared_with(keystore, enclave):
    listener = enclave("listener")
    put(keystore, listener, None)
    shim, *_ = side(listener, **LIST)
    put(keystore, listener, 7)
    assert told(shim) == []
    put(keystore, listener, 6)
    with pytest.raises(RefusedError, match="list 6 is older than list 7"):
        told(shim)


def test_a_list_that_ended_or_is_to_come_is_refused_as_ever(keystore, enclave):
    for days, words in ((-31, "ended on"), (1, "is not in force before")):
        folder = enclave("listener", words)
        put(keystore, folder, 9, at=NOW + days * DAY)
        with pytest.raises(RefusedError, match=words):
            side(folder, **LIST)


def test_a_list_that_is_not_in_force_yet_does_not_count_for_others(keystore, enclave):
    lists = NewestLists()
    late, shim = enclave("listener"), Shim("authentication", lists=lists)
    put(keystore, late, 6)
    shim.identity(late, **LIST)
    put(keystore, late, 9, at=NOW + DAY)
    assert told(shim) == []
    other = enclave("talker")
    put(keystore, other, 6)
    assert Shim("authentication", lists=lists).identity(other, **LIST)


def test_the_newest_list_of_a_ca_counts_for_all_its_participants_in_the_agent(keystore, enclave):
    """Whether they are there already, in another process, or come later."""
    lists = NewestLists()
    listener, talker = enclave("listener"), enclave("talker")
    first, second = (Shim("authentication", lists=lists) for _ in range(2))
    put(keystore, listener, 6)
    own = first.identity(listener, **LIST)
    [peer] = [peer for shim, _, peer in shaken((first, *own), side(talker)) if shim is first]
    newer = enclave("listener", "newer")
    put(keystore, newer, 7, talker)
    second.identity(newer, **LIST)
    assert told(first) == [peer]
    late = Shim("authentication", lists=lists)
    put(keystore, talker, 6)
    with pytest.raises(RefusedError, match="talker was revoked on"):
        late.identity(talker, **LIST)
    assert any("applies in place of list 6" in line for line in [*first.log, *late.log])


def test_the_newest_list_is_remembered_when_its_participant_has_gone(keystore, enclave):
    lists, talker = NewestLists(), enclave("talker")
    folder = enclave("listener")
    put(keystore, folder, 7, talker)
    gone = Shim("authentication", lists=lists)
    gone.call("return_identity_handle", gone.identity(folder, **LIST)[0])
    put(keystore, folder, 6)
    again = Shim("authentication", lists=lists)
    own = again.identity(folder, **LIST)
    with pytest.raises(RefusedError, match="was revoked on"):
        shaken((again, *own), side(talker))


def test_lists_of_other_cas_do_not_matter(keystore, enclave, tmp_path):
    lists = NewestLists()
    other = made(tmp_path / "other", "classical")
    stranger = other.root / "enclaves/listener"
    put(other, stranger, 99)
    Shim("authentication", lists=lists).identity(stranger, **LIST)
    folder = enclave("listener")
    put(keystore, folder, 6)
    shim = Shim("authentication", lists=lists)
    assert shim.identity(folder, **LIST)
    assert shim.log == []


def test_a_list_with_one_signature_does_not_count_for_who_wants_two(tmp_path):
    """Else a forger of classical signatures could keep all later lists from everybody."""
    store = made(tmp_path / "k", "transition")
    lists = NewestLists()
    stock, own = (store.root / "enclaves" / name for name in ("listener", "talker"))
    (stock / "pqsec.toml").write_text('peers = "stock"')
    put(store, stock, 1 << 60)  # with the classical signature alone
    Shim("authentication", lists=lists).identity(stock, **LIST)
    for link in (stock, own):
        (link / "crl.pem").unlink(missing_ok=True)
    renew_list(store, store.unlock(None), now=NOW)
    shim = Shim("authentication", lists=lists)
    assert shim.identity(own, **LIST)
    assert shim.log == []


def test_a_participant_that_its_own_list_names_is_not_made(keystore, enclave):
    folder = enclave("listener")
    put(keystore, folder, 7, folder)
    with pytest.raises(RefusedError, match="listener was revoked on"):
        side(folder, **LIST)


@pytest.mark.parametrize("place", ["whole", "entry"])
def test_a_list_with_an_unknown_critical_extension_is_not_taken(keystore, enclave, met, place):
    """RFC 5280 5.2 and 5.3: such a list may not say what it seems to say."""
    folder = enclave("listener", "critical")
    put(keystore, folder, 8, enclave("talker", "other"), **{place: UNKNOWN})
    with pytest.raises(RefusedError, match="unknown critical extension"):
        side(folder, **LIST)
    here, listener, talker = met
    shutil.copy(folder / "crl.pem", listener / "crl.pem")
    with pytest.raises(RefusedError, match="unknown critical extension"):
        told(here[0])
    with pytest.raises(RefusedError, match="was revoked on"):  # list 7 stays in force
        shaken(here, side(talker))
