"""Bundles, robots and receipts of a keystore with several sets of credentials."""

import hashlib
import shutil
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import KEYS, Credentials, verify_credentials
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    Bundle,
    import_receipts,
    install,
    pin_texts,
    pins_in_use,
    pins_of,
    problems_where_installed,
    read_receipts,
    rollback,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.enrolment.pins import of_sets
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.errors import KeystoreError, MalformedError, UsageError, VerificationError
from pqsec_pki.keystore import (
    InstallState,
    Keystore,
    SetLine,
    change,
    list_delivery,
    read_head,
    robot_states,
    stage_governance,
    status,
)
from pqsec_pki.keystore._chain import link
from pqsec_pki.keystore.proofs import LedgerProofs
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    Renewal,
    add_set,
    issue,
    renew,
    renew_list,
    revoke,
)
from pqsec_pki.lint import check
from pqsec_pki.problems import Code
from pqsec_pki.transparency import Checkpoint
from tests.unit.keystores import DAY, NOW
from tests.unit.killing import copies, fails, survives

CLASSICAL, HYBRID, PQ = map(profile_named, ("classical", "hybrid", "pq"))
TALKER, LISTENER = "/talker", "/listener"
LATER = NOW + DAY
FIRST, SET = "", "hybrid"


def create(root, *profiles):
    keystore = Keystore.create(
        root,
        *profiles,
        name="Lab",
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    issued(keystore, TALKER, LISTENER, "/thief")
    renew_list(keystore, keystore.unlock(None), now=NOW)
    return keystore


def issued(keystore, *names, now=NOW):
    specs = [
        ParticipantSpec(name=name, domains=DomainSet.of(0), publish=("chatter",), validity=90 * DAY)
        for name in names
    ]
    return issue(keystore, keystore.unlock(None), specs, now=now, force=True)


def added(keystore, profile=HYBRID, now=LATER):
    found = add_set(
        keystore,
        keystore.unlock(None),
        profile,
        validity=900 * DAY,
        passphrase=None,
        now=now,
    )
    return found.keystore.sets[0]


@pytest.fixture(scope="module")
def models(memory):
    """Keystores with two sets, and with one, by the profile of the second."""
    profiles = {"hybrid": (CLASSICAL, HYBRID), "pq": (CLASSICAL, PQ), "one": (CLASSICAL,)}
    return {name: create(memory / name, *each) for name, each in profiles.items()}


def copied(models, place, name):
    shutil.copytree(models[name].root, place / name, symlinks=True)
    return Keystore.open(place / name, to_change=True)


@pytest.fixture
def keystore(models, place):
    return copied(models, place, "hybrid")


@pytest.fixture
def single(models, place):
    """A keystore with one set."""
    return copied(models, place, "one")


@pytest.fixture
def robot(place):
    return place / "robot"


def bundled(keystore, *names, now=NOW, **options):
    return Bundle.of(keystore, names or (TALKER,), now=now, **options)


def put(robot, bundle, pins=None, now=LATER, **options):
    return install(bundle.to_bytes(), robot, pins, now=now, **options)


def refused(robot, bundle, pins=None, **options):
    """The codes and words of the refusal, after which nothing has changed."""
    before = snapshot(robot)
    with pytest.raises(VerificationError) as caught:
        put(robot, bundle, pins, **options)
    assert snapshot(robot) == before
    return caught.value.codes, str(caught.value)


def snapshot(robot):
    return {
        path.relative_to(robot): path.read_bytes() if path.is_file() else None
        for path in (robot.rglob("*") if robot.exists() else ())
    }


def current(robot):
    return CredentialStore(robot).current


def with_set(bundle, files, name=SET, participant=TALKER):
    """The bundle with other files in one set; None leaves one out."""
    sets = bundle.sets
    own = {**sets[name][participant], **files}
    sets[name] = {
        **sets[name],
        participant: {file: data for file, data in own.items() if data is not None},
    }
    return replace(bundle, enclaves=sets.pop(FIRST), further=sets, proof=None, set_lines=())


def without_sets(bundle):
    return replace(bundle, further={}, set_lines=())


# One bundle


@pytest.mark.parametrize("second", ["hybrid", "pq"])
def test_a_bundle_has_all_sets_under_one_number(models, second):
    keystore = models[second]
    bundle = bundled(keystore)
    assert bundle.profiles == ("classical", second)
    archive = Archive.unpack(bundle.to_bytes(), "bundle")
    assert archive.about["profiles"] == ["classical", second]
    for start in ("", f"sets/{second}/"):
        for file in ("cert.pem", "key.pem", "governance.p7s", "permissions.p7s", "crl.pem"):
            assert f"{start}enclaves/talker/{file}" in archive.files
    again = Bundle.from_bytes(bundle.to_bytes())
    assert (again.sets, again.number, again.sha256) == (bundle.sets, bundle.number, bundle.sha256)
    lines = {each.entry.sha256: each.number for each in keystore.lines()}
    held = [
        lines[digest]
        for files in (each[TALKER] for each in bundle.sets.values())
        for file, data in files.items()
        if (
            digest := Certificate.from_pem(data).fingerprint
            if file.endswith("cert.pem")
            else hashlib.sha256(data).hexdigest()
        )
        in lines
    ]
    assert bundle.number == max(held)


def test_a_change_of_one_set_gives_the_bundle_another_number(keystore):
    before = bundled(keystore)
    view = keystore.sets[1]
    serial = f"{view.participant('/thief').certificate.serial_number:x}"
    revoke(keystore, keystore.unlock(None), [serial], now=LATER)
    after = bundled(keystore, now=LATER)
    assert before.number < after.number


def test_a_bundle_has_no_set_of_which_a_participant_waits_for_a_request(single, robot):
    """Its key is on its robot: until it asks, it has what it had."""
    (single.root / "enclaves/talker/key.pem").unlink()
    keystore = added(single)
    assert bundled(keystore, LISTENER, now=LATER).profiles == ("classical", "hybrid")
    waiting = bundled(keystore, TALKER, now=LATER)
    assert waiting.profiles == ("classical",)
    with pytest.raises(KeystoreError, match="/talker has no certificate in the set"):
        bundled(keystore, TALKER, LISTENER, now=LATER)


@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s", "governance.p7s", "crl.pem"])
def test_a_bundle_without_a_file_of_one_set_is_not_written(keystore, file):
    (keystore.sets[1].folder / f"enclaves/talker/{file}").unlink()
    if file == "crl.pem":
        (keystore.sets[1].folder / "public/identity_ca.crl.pem").unlink()
    with pytest.raises(KeystoreError, match=r"sets/hybrid"):
        bundled(keystore)


def test_a_bundle_with_an_older_file_of_one_set_is_not_written(keystore):
    path = keystore.sets[1].folder / "enclaves/talker/permissions.p7s"
    older = path.read_bytes()
    renew(keystore, keystore.unlock(None), [TALKER], Renewal(), now=LATER)
    path.write_bytes(older)
    with pytest.raises(KeystoreError, match="not the newest permissions"):
        bundled(keystore, now=LATER)


# Pins


def test_pins_of_a_further_set_begin_with_its_name(keystore):
    pins = pins_in_use(keystore)
    texts = pin_texts(pins)
    roles = [each.partition(":")[0] for each in texts]
    assert roles == ["identity", "permissions", "hybrid/identity", "hybrid/permissions"]
    assert pins_of(texts) == pins == bundled(keystore).roles
    for wrong in (f"x/identity:{'0' * 64}", f"hybrid/other:{'0' * 64}", f"/identity:{'0' * 64}"):
        with pytest.raises(UsageError):
            pins_of([wrong])


def test_a_first_installation_needs_the_pins_of_all_sets(keystore, robot):
    bundle, pins = bundled(keystore), pins_in_use(keystore)
    codes, words = refused(robot, bundle, of_sets(pins, [FIRST]))
    assert codes == {Code.CA_UNKNOWN}
    assert "the CAs of the set of credentials hybrid are not trusted here" in words
    assert put(robot, bundle, pins).names == (TALKER,)


def test_a_first_bundle_that_lacks_a_pinned_set_is_refused(keystore, robot):
    codes, words = refused(robot, without_sets(bundled(keystore)), pins_in_use(keystore))
    assert codes == {Code.CA_MISSING}
    assert "the set of credentials hybrid is missing" in words


def test_sets_in_each_others_place_are_refused(keystore, robot):
    bundle, pins = bundled(keystore), pins_in_use(keystore)
    swapped = replace(
        bundle, enclaves=bundle.further[SET], further={SET: bundle.enclaves}, proof=None
    )
    assert refused(robot, swapped, pins)[0] == {Code.CA_UNKNOWN, Code.CA_MISSING}


# Installing


@pytest.mark.parametrize("second", ["hybrid", "pq"])
def test_all_sets_are_installed_and_each_is_complete(models, second, robot):
    keystore = models[second]
    done = put(robot, bundled(keystore), pins_in_use(keystore))
    assert (done.names, done.bundle) == ((TALKER,), bundled(keystore).number)
    found = current(robot)
    assert found.further == (second,)
    for place, folder in ((FIRST, ""), (second, f"sets/{second}/")):
        enclave = found.path / f"{folder}enclaves/talker"
        files = found.sets[place][TALKER]
        verify_credentials(Credentials.of(TALKER, files), now=LATER)
        assert (enclave / "key.pem").stat().st_mode & 0o777 == 0o600
        assert (enclave / "ledger.proof").exists()
    assert put(robot, bundled(keystore)).already


def refusals(keystore, other):
    """Bundles with one thing wrong in one set, and the code for each."""
    good = bundled(keystore, TALKER, LISTENER)
    theirs = good.further[SET][LISTENER]
    foreign = bundled(other, TALKER, LISTENER).further[SET]
    plain = good.enclaves[TALKER]
    return {
        "the set is left out": (without_sets(good), Code.CA_MISSING),
        "another robot's set": (with_set(good, theirs), Code.WRONG_SUBJECT),
        "another robot's certificate": (
            with_set(good, {"cert.pem": theirs["cert.pem"]}),
            Code.WRONG_SUBJECT,
        ),
        "another robot's permissions": (
            with_set(good, {"permissions.p7s": theirs["permissions.p7s"]}),
            Code.NO_GRANT,
        ),
        "another domain's set": (replace(good, further={SET: foreign}), Code.CA_UNKNOWN),
        "the documents of the first set": (
            with_set(good, {"permissions.p7s": plain["permissions.p7s"]}),
            Code.WRONG_SIGNER,
        ),
        "the first set once more": (
            replace(good, further={SET: good.enclaves}),
            Code.CA_UNKNOWN,
        ),
        "the list of the set is left out": (with_set(good, {"crl.pem": None}), Code.LIST_MISSING),
        "the list of the first set is left out": (
            with_set(good, {"crl.pem": None}, FIRST),
            Code.LIST_MISSING,
        ),
        "the list of the other set": (
            with_set(good, {"crl.pem": plain["crl.pem"]}),
            Code.LIST_WRONG_ISSUER,
        ),
    }


CASES = (
    "the set is left out",
    "another robot's set",
    "another robot's certificate",
    "another robot's permissions",
    "another domain's set",
    "the documents of the first set",
    "the first set once more",
    "the list of the set is left out",
    "the list of the first set is left out",
    "the list of the other set",
)


@pytest.mark.parametrize("new", [True, False], ids=["new robot", "running robot"])
@pytest.mark.parametrize("case", CASES)
def test_a_bundle_with_something_wrong_in_one_set_is_refused(models, place, robot, case, new):
    keystore = models["hybrid"]
    other = create(place / "other", CLASSICAL, HYBRID)
    found = refusals(keystore, other)
    assert found.keys() == {*CASES}
    pins = pins_in_use(keystore)
    if not new:
        put(robot, bundled(keystore, TALKER, LISTENER), pins)
    bundle, code = found[case]
    codes, _ = refused(robot, bundle, pins if new else None)
    assert code in codes


@pytest.mark.parametrize("of_set", [FIRST, SET])
def test_a_first_bundle_with_a_list_in_one_set_alone_is_refused(keystore, robot, of_set):
    bundle = with_set(bundled(keystore), {"crl.pem": None}, of_set)
    codes, words = refused(robot, bundle, pins_in_use(keystore))
    assert codes == {Code.LIST_MISSING}
    assert "the revocation list is missing in one of the sets" in words


@pytest.mark.parametrize("of_set", [FIRST, SET])
def test_a_set_with_two_trusted_identity_cas_has_no_list(models, keystore, robot, of_set):
    """In a rollover of its identity CA; the other set has its list."""
    own = bundled(keystore).sets[of_set][TALKER]["identity_ca.cert.pem"]
    both = own + models["one"].identity_ca.pem
    overlap = with_set(bundled(keystore), {"identity_ca.cert.pem": both, "crl.pem": None}, of_set)
    assert put(robot, overlap, overlap.roles).names == (TALKER,)


def test_documents_of_two_sets_that_differ_are_refused(keystore, robot):
    """Each is validly signed; who reads the one set would have other rights than in the other."""
    pins, authorities = pins_in_use(keystore), keystore.unlock(None)
    good = bundled(keystore)
    for file in ("governance", "permissions"):
        folder = keystore.root / ("enclaves" if file == "governance" else "enclaves/talker")
        document = (folder / f"{file}.xml").read_bytes()
        other = document.replace(b"<id>0</id>", b"<id>1</id>")
        other = other.replace(b"chatter", b"secrets")
        assert other != document
        signed = authorities.sets[1].sign(other, now=NOW)
        bad = with_set(good, {f"{file}.p7s": signed})
        codes, words = refused(robot, bad, pins)
        assert codes == {Code.CONTENT_CHANGED}
        assert f"set hybrid: /talker: {file}.p7s: it says something else" in words


def test_a_bundle_whose_documents_differ_is_not_written(keystore):
    """Somebody with the CA keys signed a governance in one set alone."""
    document = (keystore.root / "enclaves/governance.xml").read_bytes()
    other = document.replace(b"<id>0</id>", b"<id>1</id>")
    authorities = keystore.unlock(None)
    with change(keystore.root, authorities) as transaction:
        stage_governance(transaction.of(SET), authorities.sets[1], other, now=LATER)
    with pytest.raises(VerificationError) as caught:
        bundled(keystore, now=LATER)
    assert caught.value.codes == {Code.CONTENT_CHANGED}


# What is older


def test_an_older_copy_of_one_set_is_refused(keystore, robot):
    """The first set is new; the other one restores what was withdrawn."""
    older = bundled(keystore)
    put(robot, older, pins_in_use(keystore))
    renew(keystore, keystore.unlock(None), [TALKER], Renewal(rekey=False), now=LATER)
    newer = bundled(keystore, now=LATER)
    put(robot, newer)
    for of_set in (FIRST, SET):
        mixed = with_set(newer, older.sets[of_set][TALKER], of_set)
        assert refused(robot, mixed)[0] <= {Code.OLDER, Code.CONTENT_CHANGED}
    assert refused(robot, older)[0] == {Code.OLDER}


@pytest.mark.parametrize("of_set", [FIRST, SET])
def test_an_older_list_of_one_set_is_refused(keystore, robot, of_set):
    older = bundled(keystore)
    revoke(keystore, keystore.unlock(None), ["/thief"], now=LATER)
    newer = bundled(keystore, now=LATER)
    put(robot, newer, pins_in_use(keystore))
    mixed = with_set(newer, {"crl.pem": older.sets[of_set][TALKER]["crl.pem"]}, of_set)
    codes, words = refused(robot, mixed)
    assert codes == {Code.OLDER}
    assert "crl.pem: the revocation list is older than one installed before" in words


def test_the_way_back_has_all_sets(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    renew(keystore, keystore.unlock(None), [TALKER], Renewal(), now=LATER)
    put(robot, bundled(keystore, now=LATER))
    with pytest.raises(VerificationError, match="older than one installed before"):
        rollback(robot, now=LATER)
    rollback(robot, now=LATER, older=True)
    assert current(robot).further == (SET,)
    assert read_receipts(CredentialStore(robot).receipt.read_bytes())[0].receipt.further == (SET,)


# A set that was added


@pytest.fixture
def running(single, robot):
    """A robot with one set, whose keystore got another one."""
    put(robot, bundled(single), pins_in_use(single))
    return added(single)


def test_a_set_that_the_keystore_added_is_installed_without_new_pins(running, robot):
    done = put(robot, bundled(running, now=LATER))
    assert not done.already
    assert current(robot).further == (SET,)
    assert CredentialStore(robot).trust_state.pins == pins_in_use(running)
    put(robot, bundled(running, now=LATER))


def test_after_the_addition_a_bundle_with_fewer_sets_is_refused(running, robot):
    """As an attacker or an earlier pqsec would make it; no option allows it."""
    before = bundled(running, now=LATER)
    put(robot, before)
    fewer = without_sets(before)
    pins = of_sets(pins_in_use(running), [FIRST])
    for given, older in ((None, False), (None, True), (pins, False), (pins, True)):
        codes, words = refused(robot, fewer, given, older=older)
        assert codes == {Code.CA_MISSING}
        assert "the set of credentials hybrid is missing" in words
    for older in (False, True):
        with pytest.raises(VerificationError, match="hybrid is missing"):
            rollback(robot, now=LATER, older=older)


def test_a_third_set_is_added_and_none_of_the_three_can_be_left_out(running, robot):
    put(robot, bundled(running, now=LATER))
    keystore = added(running, PQ)
    bundle = bundled(keystore, now=LATER)
    assert bundle.profiles == ("classical", "hybrid", "pq")
    put(robot, bundle)
    assert current(robot).further == ("hybrid", "pq")
    for left_out in bundle.further:
        kept = {name: each for name, each in bundle.further.items() if name != left_out}
        assert refused(robot, replace(bundle, further=kept))[0] == {Code.CA_MISSING}


def forged(running, bundle, place):
    """Bundles with a set for which the trusted CAs do not vouch."""
    other = create(place / "other", CLASSICAL, HYBRID)
    foreign = bundled(other)
    proof = bundle.proof
    keys = [each.key for each in other.unlock(None).signers]
    lines = bundle.set_lines
    renamed = tuple(relabelled(each, "pq") for each in lines)
    linked = tuple(
        replace(
            each,
            line=replace(each.line, chain=link(each.before, each.line.number, each.line.entry)),
        )
        for each in renamed
    )
    return {
        "without a proof": replace(bundle, proof=None),
        "without the lines": replace(bundle, set_lines=()),
        "with one line": replace(bundle, set_lines=lines[:1]),
        "with CAs of another keystore": replace(bundle, further=foreign.further),
        "with their proof": replace(
            bundle, further=foreign.further, proof=foreign.proof, set_lines=foreign.set_lines
        ),
        "with their signature": replace(
            bundle, proof=replace(proof, checkpoint=Checkpoint.signed(proof.checkpoint.head, keys))
        ),
        "under another name": replace(bundle, further={"pq": bundle.further[SET]}),
        "with altered lines": replace(
            bundle, further={"pq": bundle.further[SET]}, set_lines=renamed
        ),
        "with altered lines and their chain values": replace(
            bundle, further={"pq": bundle.further[SET]}, set_lines=linked
        ),
        "with its CAs in each other's role": with_roles_swapped(bundle),
    }


def relabelled(set_line, name):
    """The line, about another set."""
    entry = set_line.line.entry
    changed = replace(entry, details={**entry.details, "set": name})
    return replace(set_line, line=replace(set_line.line, entry=changed))


def with_roles_swapped(bundle):
    """The permissions CA in the place of the identity CA."""
    files = bundle.further[SET][TALKER]
    return replace(
        bundle,
        further={
            SET: {
                TALKER: {
                    **files,
                    "identity_ca.cert.pem": files["permissions_ca.cert.pem"],
                    "permissions_ca.cert.pem": files["identity_ca.cert.pem"],
                }
            }
        },
    )


FORGERIES = (
    "without a proof",
    "without the lines",
    "with one line",
    "with CAs of another keystore",
    "with their proof",
    "with their signature",
    "under another name",
    "with altered lines",
    "with altered lines and their chain values",
    "with its CAs in each other's role",
)


@pytest.mark.parametrize("case", FORGERIES)
def test_a_set_for_which_the_trusted_cas_do_not_vouch_is_not_added(running, place, robot, case):
    bundle = bundled(running, now=LATER)
    found = forged(running, bundle, place)
    assert found.keys() == {*FORGERIES}
    codes, _ = refused(robot, found[case])
    assert codes == {Code.CA_UNKNOWN}
    put(robot, bundle)


def test_a_ca_of_the_first_set_is_not_taken_for_that_of_a_new_set(running, robot):
    """Also of one that was replaced, whose key may be with a thief, the ledger has a line."""
    bundle = bundled(running, now=LATER)
    with running.open_ledger() as ledger:
        lines = [
            SetLine.of(ledger, kind, ca.fingerprint)
            for kind, ca in (
                ("identity-ca", running.identity_ca),
                ("permissions-ca", running.permissions_ca),
            )
        ]
        proof = LedgerProofs.of(running.root, ledger).proof([], [each.about for each in lines])
    stolen = replace(bundle, proof=proof, further={"pq": bundle.enclaves}, set_lines=tuple(lines))
    codes, words = refused(robot, stolen)
    assert codes == {Code.CA_UNKNOWN}
    assert "no line of the ledger says that it is a CA of this set" in words


def test_a_bundle_of_another_domain_with_more_sets_is_not_an_addition(running, place, robot):
    other = bundled(create(place / "other", CLASSICAL, HYBRID))
    for bundle in (other, replace(other, proof=None, set_lines=())):
        codes, words = refused(robot, bundle)
        assert codes == {Code.CA_UNKNOWN, Code.CA_MISSING}
        assert "the identity CA that is trusted is missing" in words
    assert running.profiles


def test_an_addition_in_an_older_copy_of_the_ledger_is_refused(single, place, robot):
    """The robot saw a newer ledger than that in which somebody added a set."""
    shutil.copytree(single.root, place / "older", symlinks=True)
    issued(single, "/new", now=LATER)
    renew(single, single.unlock(None), [TALKER], Renewal(rekey=False), now=LATER)
    put(robot, bundled(single, now=LATER), pins_in_use(single), proofs=True)
    older = added(Keystore.open(place / "older", to_change=True))
    assert read_head(older.root).head.size
    assert not refused(robot, bundled(older, now=LATER))[0].isdisjoint({Code.OLDER, Code.PROOF_BAD})


def test_others_on_the_robot_are_not_left_without_the_added_set(single, robot):
    put(robot, bundled(single, TALKER, LISTENER), pins_in_use(single))
    keystore = added(single)
    _, words = refused(robot, bundled(keystore, TALKER, now=LATER))
    assert "also installed: /listener" in words
    put(robot, bundled(keystore, TALKER, LISTENER, now=LATER))
    assert {*current(robot).sets[SET]} == {TALKER, LISTENER}
    revoke(keystore, keystore.unlock(None), ["/thief"], now=LATER)
    put(robot, bundled(keystore, TALKER, now=LATER))
    for place in (FIRST, SET):
        assert len({each["crl.pem"] for each in current(robot).sets[place].values()}) == 1


# Archives


@pytest.mark.parametrize(
    "profiles",
    [[], ["classical"], ["classical", "pq"], ["classical", "hybrid", "pq"], ["classical", ".."],
     ["classical", "hybrid", "hybrid"], ["hybrid", "hybrid"], ["classical", ""], "classical"],
)  # fmt: skip
def test_a_manifest_that_names_other_sets_than_the_bundle_has_is_refused(models, profiles):
    archive = Archive.unpack(bundled(models["hybrid"]).to_bytes(), "bundle")
    data = replace(archive, about={**archive.about, "profiles": profiles}).pack()
    with pytest.raises(MalformedError):
        Bundle.from_bytes(data)


@pytest.mark.parametrize(
    "path",
    [
        "sets/pq/enclaves/talker/cert.pem",
        "sets//enclaves/talker/cert.pem",
        "sets/hybrid/cert.pem",
        "sets/hybrid/enclaves/other/cert.pem",
        "sets/hybrid/enclaves/talker/x.pem",
        "sets/hybrid/sets/hybrid/enclaves/talker/cert.pem",
    ],
)
def test_a_file_in_another_place_of_a_set_is_refused(models, path):
    archive = Archive.unpack(bundled(models["hybrid"]).to_bytes(), "bundle")
    files = {**archive.files, path: archive.files["enclaves/talker/cert.pem"]}
    with pytest.raises(MalformedError):
        Bundle.from_bytes(replace(archive, files=files).pack())


@pytest.mark.parametrize(
    "value", [5, [5], [{}], [None], "x", [{"number": True}], [{"details": []}]]
)
def test_lines_about_sets_that_are_none_are_refused(models, value):
    archive = Archive.unpack(bundled(models["hybrid"]).to_bytes(), "bundle")
    data = replace(archive, about={**archive.about, "set_lines": value}).pack()
    with pytest.raises(MalformedError):
        Bundle.from_bytes(data)


# Receipts


def received(keystore, robot, now=LATER, **options):
    return import_receipts(keystore, [CredentialStore(robot).receipt], now=now, **options)


def state(keystore, name=TALKER, now=LATER):
    found = status(keystore, [name], now=now).participants
    return robot_states(keystore, found)[name]


def test_a_receipt_names_the_files_of_all_sets_and_all_keys_sign_it(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    [signed] = read_receipts(CredentialStore(robot).receipt.read_bytes())
    assert signed.receipt.further == (SET,)
    for place, start in ((FIRST, ""), (SET, "sets/hybrid/")):
        files = current(robot).sets[place][TALKER]
        assert signed.certificates[place].pem == files["cert.pem"]
        for file in files.keys() - {*KEYS, "ledger.proof"}:
            digest = hashlib.sha256(files[file]).hexdigest()
            assert signed.receipt.files[f"{start}{file}"] == digest
    [done] = received(keystore, robot)
    assert done.receipt == signed.receipt
    found = state(keystore)
    assert (found.state, found.changed) == (InstallState.CURRENT, ())
    assert found.runs == found.should_run == bundled(keystore).number
    [again] = received(keystore, robot)
    assert again.already


def test_a_robot_with_an_older_file_of_one_set_is_outdated(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    received(keystore, robot)
    serial = f"{keystore.sets[1].participant('/thief').certificate.serial_number:x}"
    revoke(keystore, keystore.unlock(None), [serial], now=LATER)
    found = state(keystore)
    assert found.state is InstallState.OUTDATED
    assert "sets/hybrid/crl.pem" in found.changed


def test_a_robot_without_the_added_set_is_outdated(running, robot):
    received(running, robot)
    found = state(running)
    assert found.state is InstallState.OUTDATED
    assert "sets/hybrid/cert.pem" in found.changed
    put(robot, bundled(running, now=LATER))
    received(running, robot)
    assert state(running).state is InstallState.CURRENT


def test_a_receipt_that_lacks_a_set_that_was_installed_is_refused(running, robot, place):
    """With the key of the first set alone, which a quantum computer finds, it could be made."""
    shutil.copytree(robot, place / "before", symlinks=True)
    put(robot, bundled(running, now=LATER))
    received(running, robot)
    for _ in range(3):
        put(place / "before", without_sets(bundled(running, now=LATER)))
    with pytest.raises(VerificationError, match="it lacks the set of credentials hybrid") as caught:
        received(running, place / "before")
    assert caught.value.codes == {Code.OLDER}
    received(running, place / "before", older=True)
    assert state(running).state is InstallState.OUTDATED


def members(robot):
    return dict(Archive.unpack(CredentialStore(robot).receipt.read_bytes(), "receipt").files)


def packed(files):
    return Archive("receipt", {}, files).pack()


def test_a_receipt_without_the_signature_of_one_set_is_refused(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    good = members(robot)
    start = "sets/hybrid/enclaves/talker"
    whole = {path: data for path, data in good.items() if not path.startswith("sets/")}
    with pytest.raises(VerificationError) as caught:
        read_receipts(packed(whole))
    assert caught.value.codes == {Code.SIGNATURE_MISSING}
    for file in ("cert.pem", "receipt.p7s"):
        lacking = {path: data for path, data in good.items() if path != f"{start}/{file}"}
        with pytest.raises(MalformedError, match="incomplete"):
            read_receipts(packed(lacking))
    for file in ("cert.pem", "receipt.p7s"):
        mixed = {**good, f"{start}/{file}": good[f"enclaves/talker/{file}"]}
        with pytest.raises(VerificationError):
            read_receipts(packed(mixed))
    alone = {path: data for path, data in good.items() if path.startswith("sets/")}
    with pytest.raises(MalformedError, match="incomplete"):
        read_receipts(packed(alone))


def test_a_receipt_of_which_the_sets_sign_different_statements_is_refused(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    before = members(robot)
    put(robot, bundled(keystore))
    start = "sets/hybrid/enclaves/talker/receipt.p7s"
    with pytest.raises(VerificationError) as caught:
        read_receipts(packed({**members(robot), start: before[start]}))
    assert caught.value.codes == {Code.CONTENT_CHANGED}


def test_a_receipt_with_a_certificate_of_another_set_is_refused(keystore, place, robot):
    """One that this keystore issued to that participant, but in the other place."""
    put(robot, bundled(keystore), pins_in_use(keystore))
    sets, trust = current(robot).sets, CredentialStore(robot).trust_state
    path = place / "receipt"
    for moved in ({FIRST: sets[SET]}, {FIRST: sets[SET], SET: sets[FIRST]}):
        path.write_bytes(receipt_of(moved, {}, trust, installed_at=LATER, now=LATER))
        assert read_receipts(path.read_bytes())
        with pytest.raises(VerificationError) as caught:
            import_receipts(keystore, [path], now=LATER)
        assert caught.value.codes == {Code.NOT_ISSUED}
    assert state(keystore).receipt is None


def test_a_receipt_whose_certificate_of_one_set_was_revoked_is_not_recorded(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    serial = f"{keystore.sets[1].participant(TALKER).certificate.serial_number:x}"
    revoke(keystore, keystore.unlock(None), [serial], now=LATER)
    with pytest.raises(VerificationError) as caught:
        received(keystore, robot)
    assert caught.value.codes == {Code.REVOKED}
    assert state(keystore).state is InstallState.NONE


# Lists


def test_a_robot_must_have_the_newest_list_of_each_set(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    received(keystore, robot)
    names = [each.name for each in list_delivery(keystore, now=LATER).late]
    assert TALKER not in names
    revoke(keystore, keystore.unlock(None), ["/thief"], now=LATER)
    newer = bundled(keystore, now=LATER)
    put(robot, newer)
    half = {**read_receipts(CredentialStore(robot).receipt.read_bytes())[0].receipt.files}
    assert {"crl.pem", "sets/hybrid/crl.pem"} <= half.keys()
    [late] = [e for e in list_delivery(keystore, now=LATER).late if e.name == TALKER]
    assert (late.has_receipt, late.list_number) == (True, 1)
    received(keystore, robot)
    assert TALKER not in [each.name for each in list_delivery(keystore, now=LATER).late]


def test_a_thief_that_only_the_list_of_a_further_set_has_is_told(running, robot):
    """A robot with the list of the first set alone accepts its certificate of the other set."""
    received(running, robot)
    revoke(running, running.unlock(None), ["/thief"], now=LATER)
    found = list_delivery(running, now=LATER)
    assert TALKER in [each.name for each in found.late]
    assert {each.name for each in found.accepted} == {"/thief"}
    assert len(found.accepted) == 2


# All or none


@pytest.mark.parametrize("trial", [survives, fails], ids=["killed", "disk refuses"])
def test_all_sets_are_installed_or_none(single, place, robot, trial):
    """Also when a set is added."""
    put(robot, bundled(single), pins_in_use(single))
    keystore = added(single)
    data = bundled(keystore, now=LATER).to_bytes()
    outcomes = []
    disturbed = copies(
        place / "copies", robot, lambda goal: install(data, goal, now=LATER), trial, every=3
    )
    for goal, done in disturbed:
        found = current(goal)
        trusted = CredentialStore(goal).trust_state
        assert found.further in {(), (SET,)}
        for place_, enclaves in found.sets.items():
            assert list(enclaves) == [TALKER], place_
            verify_credentials(Credentials.of(TALKER, enclaves[TALKER]), now=LATER)
        assert {*found.further} <= {SET}
        assert of_sets(trusted.pins, [FIRST, *found.further]) == of_sets(
            pins_in_use(keystore), [FIRST, *found.further]
        )
        assert not done or found.further == (SET,)
        install(data, goal, now=LATER)
        assert current(goal).further == (SET,)
        outcomes.append(found.further)
    assert {*outcomes} == {(), (SET,)}


# A life


@pytest.mark.parametrize("second", [HYBRID, PQ], ids=lambda each: each.name)
def test_a_robot_over_its_life(single, robot, second):
    """Installed with one set, which gets another; renewed, listed, told, and never less."""
    put(robot, bundled(single), pins_in_use(single), proofs=True)
    received(single, robot)
    keystore, now = added(single, second), LATER
    authorities = keystore.unlock(None)
    seen = [bundled(keystore, now=now)]
    for month in range(1, 5):
        put(robot, seen[-1], now=now)
        received(keystore, robot, now=now)
        assert state(keystore, now=now).state is InstallState.CURRENT
        assert state(keystore, now=now).runs == seen[-1].number
        now = LATER + month * timedelta(days=20)
        renew(keystore, authorities, [TALKER], Renewal(), now=now)
        if month == 2:
            revoke(keystore, authorities, ["/thief"], now=now)
            assert TALKER in [each.name for each in list_delivery(keystore, now=now).late]
        assert state(keystore, now=now).state is InstallState.OUTDATED
        seen.append(bundled(keystore, now=now))
        assert seen[-2].number < seen[-1].number
    put(robot, seen[-1], now=now)
    for older in seen[1:-1]:
        assert Code.OLDER in refused(robot, older, now=now)[0]
    assert refused(robot, without_sets(seen[-1]), now=now)[0] == {Code.CA_MISSING}
    received(keystore, robot, now=now)
    assert TALKER not in [each.name for each in list_delivery(keystore, now=now).late]


# What a check finds on a robot


def found_on(robot):
    report = check([robot], now=LATER, compare=problems_where_installed)
    return {(each.rule.id, each.message) for each in report.findings if each.rule.id == "PQS319"}


@pytest.mark.parametrize("gone", ["sets", "sets/hybrid/enclaves", "sets/hybrid/enclaves/talker"])
def test_a_check_finds_a_set_that_is_gone_from_a_robot(keystore, robot, gone):
    put(robot, bundled(keystore), pins_in_use(keystore))
    assert found_on(robot) == set()
    shutil.rmtree(current(robot).path / gone)
    [(_, words)] = found_on(robot)
    assert "sets/hybrid/enclaves/talker is missing, and this robot has this set" in words


def test_a_check_finds_that_the_first_set_is_gone_from_a_robot(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    shutil.rmtree(current(robot).path / "enclaves")
    [(_, words)] = found_on(robot)
    assert "enclaves/talker is missing" in words


def test_the_sets_of_a_robot_and_its_earlier_installation_are_one_participant(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    renew(keystore, keystore.unlock(None), [TALKER], Renewal(), now=LATER)
    put(robot, bundled(keystore, now=LATER))
    report = check([robot], now=LATER, compare=problems_where_installed)
    assert "PQS402" not in {each.rule.id for each in report.findings}


def test_a_damaged_installation_is_mended_by_the_next_bundle(keystore, robot):
    put(robot, bundled(keystore), pins_in_use(keystore))
    shutil.rmtree(current(robot).path / "sets")
    done = put(robot, bundled(keystore))
    assert not done.already
    assert {*current(robot).sets[SET]} == {TALKER}


def test_without_its_trust_state_a_robot_needs_the_sets_that_are_installed(keystore, robot):
    bundle = bundled(keystore)
    put(robot, bundle, pins_in_use(keystore))
    (robot / "trust.json").unlink()
    assert refused(robot, without_sets(bundle))[0] == {Code.CA_MISSING}
    shutil.rmtree(current(robot).path / "sets")
    with pytest.raises(KeystoreError, match="the set of credentials hybrid lacks /talker"):
        put(robot, bundle)
    put(robot, bundle, pins_in_use(keystore), older=True)


@pytest.mark.parametrize("lost", ["enclaves", "sets/hybrid/enclaves"])
@pytest.mark.parametrize("others", [(LISTENER,), (LISTENER, "/thief")])
def test_another_participant_that_lost_a_set_is_told_and_not_dropped(keystore, robot, lost, others):
    put(robot, bundled(keystore, TALKER, *others), pins_in_use(keystore))
    shutil.rmtree(current(robot).path / f"{lost}/listener")
    _, words = refused(robot, bundled(keystore, TALKER))
    assert f"also installed: {', '.join(others)}, which were not issued by the bundle's" in words
