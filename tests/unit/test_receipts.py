"""Receipts: what a robot says that it runs, and what somebody else could say in its place."""

import hashlib
import json
import shutil
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import PROFILES, load_private_key, profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.enrolment import Bundle, rollback
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.enrolment.receipt import read_receipts, receipt_of
from pqsec_pki.enrolment.trust import Marks, TrustState
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError
from pqsec_pki.keystore import BundleNumbers, Keystore, Receipt
from pqsec_pki.lifecycle import Renewal, Rollover, Scope, renew, revoke, sign_governance
from pqsec_pki.problems import Code
from pqsec_pki.smime import Signer, sign
from tests.unit.enrolling import DAY, LATER, ROBOT, answered, asked_of, put
from tests.unit.keystores import begin_overlap, cancel_overlap, made
from tests.unit.killing import NOW, YEAR


@pytest.fixture(scope="module")
def transition(memory):
    """A keystore, and a robot that has installed; both to be copied."""
    keystore = made(memory / "k", "transition", names=("/arm", "/leg"))
    robot = memory / "robot"
    put(robot, answered(keystore, asked_of(keystore, robot)))
    return keystore, robot


@pytest.fixture
def keystore(transition, place):
    shutil.copytree(transition[0].root, place / "k", symlinks=True)
    return Keystore.open(place / "k", to_change=True)


@pytest.fixture
def robot(transition, place):
    return shutil.copytree(transition[1], place / "robot", symlinks=True)


def receipts_on(robot):
    return {
        each.receipt.participant: each.receipt
        for each in read_receipts(CredentialStore(robot).receipt.read_bytes())
    }


def hashes(files):
    return {
        name: hashlib.sha256(data).hexdigest()
        for name, data in files.items()
        if not name.endswith("key.pem")
    }


# The number


def lines(keystore, *kinds):
    return [each.number for each in keystore.lines() if each.entry.kind in kinds]


def test_a_bundles_number_is_the_newest_ledger_line_among_its_files(keystore):
    def number(*names):
        return Bundle.of(keystore, names, now=LATER).number

    authorities = keystore.unlock(None)
    arm, leg = number("/arm"), number("/leg")
    assert arm != leg
    assert number("/arm", "/leg") == max(arm, leg)
    renew(keystore, authorities, ["/arm"], Renewal(), now=LATER)
    assert arm < number("/arm")
    assert number("/arm") == max(lines(keystore, "permissions"))
    assert number("/leg") == leg
    revoke(keystore, authorities, [ROBOT], now=LATER)
    assert number("/arm") == number("/leg") == max(lines(keystore, "crl"))
    document = (keystore.root / "enclaves/governance.xml").read_bytes()
    sign_governance(keystore, authorities, Governance.from_xml(document), now=LATER)
    assert number("/arm") == number("/leg") == max(lines(keystore, "governance"))


def test_the_number_never_goes_back_even_if_a_ca_file_does(place):
    keystore = made(place / "k", "classical", names=("/arm",))
    before = Bundle.of(keystore, ["/arm"], now=NOW)
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(keystore, terms, kept=keystore.unlock(None), passphrase=None, now=NOW)
    begun = Bundle.of(keystore, ["/arm"], now=NOW)
    cancel_overlap(keystore, now=NOW)
    after = Bundle.of(keystore, ["/arm"], now=NOW)
    assert before.number < begun.number < after.number
    assert before.sha256 == after.sha256


def test_files_that_the_ledger_does_not_know_give_no_number(keystore):
    with BundleNumbers.of(keystore) as numbers:
        assert numbers.number({"cert.pem": b"-----BEGIN", "permissions.p7s": b""}) is None


def test_a_bundle_without_a_number_is_installed_and_has_none_in_its_receipt(keystore, place):
    old = replace(Bundle.of(keystore, ["/arm"], now=LATER), number=None)
    assert "number" not in Archive.unpack(old.to_bytes(), "bundle").about
    assert put(place / "new", old).bundle is None
    assert receipts_on(place / "new")["/arm"].bundle is None
    again = put(place / "new", Bundle.of(keystore, ["/arm"], now=LATER))
    assert again.already
    assert receipts_on(place / "new")["/arm"].bundle == again.bundle


@pytest.mark.parametrize("number", [0, -1, True, "7", 1.0, 1 << 63, [7]])
def test_a_number_that_no_ledger_line_has_is_refused(keystore, number):
    bundle = replace(Bundle.of(keystore, ["/arm"], now=LATER), number=number)
    with pytest.raises(MalformedError, match="not the number of a ledger line"):
        Bundle.from_bytes(bundle.to_bytes())


# The receipt, as a robot makes it


@pytest.mark.parametrize("key", [*(each.name for each in PROFILES), "rsa-2048"])
def test_a_receipt_names_the_installed_files_and_every_key_of_the_robot_signs_it(place, key):
    rsa = key.startswith("rsa")
    keystore = Keystore.create(
        place / "k",
        profile_named("classical").changed({"participant_key": key}) if rsa else profile_named(key),
        name="Test",
        domains=DomainSet.of(0),
        validity=2 * YEAR,
        passphrase=None,
        now=NOW,
    )
    bundle = answered(keystore, asked_of(keystore, place / "robot"))
    done = put(place / "robot", bundle)
    assert done.receipt == place / "robot/installed.receipt"
    [signed] = read_receipts(done.receipt.read_bytes())
    assert signed.receipt == Receipt(
        participant=ROBOT,
        store=CredentialStore(place / "robot").trust_state.store,
        number=1,
        bundle=bundle.number,
        files=hashes(bundle.enclaves[ROBOT]),
        installed_at=LATER,
        made_at=LATER,
        pqsec=signed.receipt.pqsec,
    )
    members = Archive.unpack(done.receipt.read_bytes(), "receipt").files
    assert members[f"enclaves{ROBOT}/cert.pem"] == signed.certificate.pem
    assert not [name for name in members if name.endswith("key.pem")]


def test_all_participants_of_a_robot_are_in_one_receipt_each_with_its_own_bundle(robot, keystore):
    renew(keystore, keystore.unlock(None), ["/arm"], Renewal(), now=LATER)
    revoke(keystore, keystore.unlock(None), ["/leg"], now=LATER)
    bundle = Bundle.of(keystore, ["/arm"], now=LATER)
    before = receipts_on(robot)[ROBOT]
    put(robot, bundle, now=LATER + DAY)
    found = receipts_on(robot)
    assert found["/arm"].bundle == bundle.number
    assert found[ROBOT].bundle == before.bundle < bundle.number
    crl = hashes(bundle.enclaves["/arm"])["crl.pem"]
    assert found[ROBOT].files == {**before.files, "crl.pem": crl}  # it came with the other
    put(robot, bundle, now=LATER + DAY, alone=True)
    assert set(receipts_on(robot)) == {"/arm"}


def test_a_receipt_is_made_again_by_the_same_bundle_and_tells_of_a_rollback(robot, keystore):
    first = receipts_on(robot)[ROBOT]
    renew(keystore, keystore.unlock(None), [ROBOT], Renewal(), now=LATER)
    bundle = Bundle.of(keystore, [ROBOT], now=LATER)
    put(robot, bundle, now=LATER + DAY)
    second = receipts_on(robot)[ROBOT]
    assert second.files != first.files
    assert put(robot, bundle, now=LATER + 2 * DAY).already
    again = receipts_on(robot)[ROBOT]
    assert again == replace(second, number=3, made_at=LATER + 2 * DAY)
    rollback(robot, now=LATER + 3 * DAY, older=True)
    assert receipts_on(robot)[ROBOT] == replace(first, number=4, made_at=LATER + 3 * DAY)


def test_who_cannot_sign_has_no_receipt_and_keeps_nobody_else_from_installing(robot, keystore):
    enclave = robot / f"current/enclaves{ROBOT}"
    (enclave / "alt.key.pem").write_bytes((enclave / "key.pem").read_bytes())
    put(robot, Bundle.of(keystore, ["/arm"], now=LATER))
    assert set(receipts_on(robot)) == {"/arm"}


@pytest.mark.parametrize("bundles", [[], {"/arm": 0}, {"/arm": "1"}, 7])
def test_a_damaged_record_of_numbers_is_told(robot, bundles):
    path = robot / "installed/1/installed.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "bundles": bundles}))
    with pytest.raises(PqsecError, match=r"installed\.json cannot be read"):
        CredentialStore(robot).current  # noqa: B018 -- reading it is the test


# What somebody else could write


CERT, STATEMENT = f"enclaves{ROBOT}/cert.pem", f"enclaves{ROBOT}/receipt.p7s"
BOTH = ("key.pem", "alt.key.pem")


@pytest.fixture(scope="module")
def enclave(transition):
    return CredentialStore(transition[1]).current.enclaves[ROBOT]


def members_of(enclave, name=ROBOT, now=LATER):
    trust = TrustState(pins={}, marks=Marks(), store="5" * 32, receipts=9)
    data = receipt_of({"": {name: enclave}}, {name: 7}, trust, installed_at=NOW, now=now)
    return dict(Archive.unpack(data, "receipt").files)


def packed(members):
    return Archive("receipt", {}, members).pack()


def statement(enclave, text=None, *, keys=BOTH, **changes):
    """The statement with other values, or the text, signed with keys of the enclave."""
    if text is None:
        [signed] = read_receipts(packed(members_of(enclave)))
        text = replace(signed.receipt, **changes).to_json()
    certificate = Certificate.from_pem(enclave["cert.pem"])
    first, second = [*(Signer(certificate, load_private_key(enclave[key])) for key in keys), None][
        :2
    ]
    return sign(text, first, countersigner=second, embed_certificate=False, now=LATER)


def refused(members, *codes, match=None):
    with pytest.raises(VerificationError, match=match) as caught:
        read_receipts(packed(members))
    assert caught.value.codes == set(codes)


def test_a_receipt_that_was_altered_is_refused(enclave):
    members = members_of(enclave)
    for old, new in ((b'"bundle": 7', b'"bundle": 9'), (b"+00:00", b"+01:00")):
        altered = members[STATEMENT].replace(old, new)
        assert altered != members[STATEMENT]
        refused({**members, STATEMENT: altered}, Code.CONTENT_CHANGED)


def test_a_receipt_that_another_key_signed_is_refused(enclave, keystore):
    members = members_of(enclave)
    arm = Bundle.of(keystore, ["/arm"], now=LATER).enclaves["/arm"]
    mixed = {**enclave, "key.pem": arm["key.pem"], "alt.key.pem": arm["alt.key.pem"]}
    refused(
        {**members, STATEMENT: statement(mixed, statement_text(enclave))},
        *(Code.SIGNATURE_BAD, Code.COUNTERSIGNATURE_BAD),
    )
    # Each key alone counts
    for one in BOTH:
        half = {**enclave, one: arm[one]}
        code = Code.SIGNATURE_BAD if one == "key.pem" else Code.COUNTERSIGNATURE_BAD
        forged = statement(half, statement_text(enclave))
        refused({**members, STATEMENT: forged}, code)
    refused({**members, CERT: arm["cert.pem"]}, Code.WRONG_SIGNER, Code.SIGNATURE_MISSING)


def statement_text(enclave):
    [signed] = read_receipts(packed(members_of(enclave)))
    return signed.receipt.to_json()


def test_a_receipt_without_the_signature_of_the_alternative_key_is_refused(enclave):
    bare = statement(enclave, keys=("key.pem",))
    refused({**members_of(enclave), STATEMENT: bare}, Code.SIGNATURE_MISSING)


def test_nobody_signs_for_another_participant(enclave, keystore):
    files = Bundle.of(keystore, ["/arm"], now=LATER).enclaves["/arm"]
    other = members_of(files, name=ROBOT)
    refused(other, Code.WRONG_SUBJECT)
    mine = members_of(enclave)
    moved = {path.replace(ROBOT, "/arm"): data for path, data in mine.items()}
    refused(moved, Code.WRONG_SUBJECT, match="a receipt of /fleet/robot1, signed by CN=")
    refused({**mine, STATEMENT: statement(enclave, participant="/arm")}, Code.WRONG_SUBJECT)


def test_an_old_key_cannot_say_that_a_newer_certificate_is_installed(enclave):
    [signed] = read_receipts(packed(members_of(enclave)))
    for files in (
        {**signed.receipt.files, "cert.pem": "0" * 64},
        {name: each for name, each in signed.receipt.files.items() if name != "cert.pem"},
    ):
        claimed = statement(enclave, files=files)
        refused({**members_of(enclave), STATEMENT: claimed}, Code.WRONG_SIGNER)


def test_signed_text_that_is_not_exactly_a_receipt_is_refused(enclave):
    good = json.loads(statement_text(enclave))

    def text(**changes):
        return json.dumps({**good, **changes}, indent=2, sort_keys=True).encode() + b"\n"

    hostile = [
        *(b"", b"[]", b"{", b"null", b"[" * 9000, b"x" * (17 << 10), text()[:-1], b" " + text()),
        text().replace(b"{", b'{"format": 2,', 1),  # twice
        *(text(kind="bundle"), text(format=1), text(more=1), text(pqsec="\x1b[2J"), text(pqsec=1)),
        *(text(participant=each) for each in ("/", "/../x", "fleet/robot1", 7, None)),
        text(participant="/long" * 4000),
        *(text(bundle=each) for each in (0, -1, True, "7", 1 << 63, 1.5)),
        *(text(store=each) for each in ("", "5" * 31, "A" * 32, "5" * 32 + "\n", 7, None)),
        *(text(number=each) for each in (0, -1, True, "7", 1 << 63, 1.5, None)),
        *(text(made_at=each) for each in ("2026-11-21", "2026-11-21T12:00:00", "now", 7)),
        text(installed_at="2026-11-21T12:00:00"),
        # Not in UTC, as which they would be shown
        text(made_at="2026-11-21T12:00:00+05:00"),
        text(installed_at="9999-12-31T23:59:00-23:00"),
        text(installed_at="0001-01-01T00:00:00+23:59"),
        *(text(files=each) for each in ([], {"key.pem": "0" * 64}, {"../cert.pem": "0" * 64})),
        *(text(files={"cert.pem": each}) for each in ("0" * 63, "A" * 64, 7, "0" * 64 + "\n")),
        text().replace(b'"bundle": 7', b'"bundle": NaN'),
    ]
    for each in hostile:
        with pytest.raises(MalformedError):
            read_receipts(packed({**members_of(enclave), STATEMENT: statement(enclave, each)}))
    for each in (text(kind="bundle"), text(format=1)):
        with pytest.raises(MalformedError, match="made by another version of pqsec"):
            Receipt.from_json(each)


def test_an_archive_that_is_not_a_receipt_file_is_refused(enclave, transition):
    members = members_of(enclave)
    bundle = Bundle.of(transition[0], ["/arm"], now=LATER)
    hostile = [
        *(b"", b"x", bundle.to_bytes(), packed({})),
        *(packed({CERT: members[CERT]}), packed({STATEMENT: members[STATEMENT]})),
        packed({**members, f"enclaves{ROBOT}/key.pem": b""}),
        packed({**members, "receipt.p7s": members[STATEMENT]}),
        packed({f"x/{path}": each for path, each in members.items()}),
        packed({path.replace(ROBOT, "/x.pem"): each for path, each in members.items()}),
        packed({**members, CERT: members[CERT] * 2}),
        packed({**members, CERT: b"x"}),
    ]
    for each in hostile:
        with pytest.raises(MalformedError):
            read_receipts(each)
