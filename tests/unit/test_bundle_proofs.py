"""The proof in a bundle that the ledger has what is in it, and what the robot makes of it."""

import json
import shutil
from dataclasses import replace

import pytest

from pqsec_pki.credentials import Credentials, verify_credentials, verify_logged
from pqsec_pki.enrolment import Bundle, install, rollback
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.errors import KeystoreError, MalformedError, UsageError, VerificationError
from pqsec_pki.keystore import BundleNumbers
from pqsec_pki.keystore.heads import read_head
from pqsec_pki.lifecycle import renew
from pqsec_pki.lint import check
from pqsec_pki.problems import Code
from pqsec_pki.transparency import Checkpoint, LedgerProof, MerkleTree, TreeHead, leaf_hash
from tests.unit.enrolling import DAY, ROBOT, answered, asked_of
from tests.unit.keystores import enter, made
from tests.unit.killing import NOW
from tests.unit.plugin_wire import RefusedError, Shim, properties
from tests.unit.test_ledger import entry
from tests.unit.test_ledger_heads import forget_heads, rewrite


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    return made(tmp_path_factory.mktemp("proofs") / "k", "transition")


@pytest.fixture(scope="module")
def asked(keystore, tmp_path_factory):
    robot = tmp_path_factory.mktemp("proofs") / "robot"
    return robot, answered(keystore, asked_of(keystore, robot))


@pytest.fixture
def robot(asked, tmp_path):
    shutil.copytree(asked[0], tmp_path / "robot", symlinks=True)
    return tmp_path / "robot"


@pytest.fixture
def bundle(asked):
    return asked[1]


def put(robot, bundle, *, now=NOW, **options):
    path = robot.parent / "robot.bundle"
    path.write_bytes(bundle.to_bytes())
    return install(path, robot, now=now, **{"trust_first": True, **options})


def refused(robot, bundle, **options):
    with pytest.raises(VerificationError) as caught:
        put(robot, bundle, **options)
    return caught.value.codes, str(caught.value)


def proof_in(robot):
    current = CredentialStore(robot).current
    data = current.enclaves[ROBOT].get("ledger.proof") if current else None
    return LedgerProof.from_bytes(data) if data else None


def test_a_bundle_proves_certificate_and_documents(keystore, bundle, robot):
    assert [each.kind for each in bundle.proof.lines] == [
        "participant",
        "permissions",
        "governance",
    ]
    put(robot, bundle, proofs=True)
    found = proof_in(robot)
    assert found == bundle.proof
    assert found.checkpoint.head == read_head(keystore.root).head
    told = json.dumps(found.to_json())
    operators = {each.operator for each in keystore.ledger()}
    assert not any(f'"{each}"' in told for each in operators)
    assert keystore.ledger()[-1].at not in told


def test_a_bundle_for_several_gives_each_its_own_lines(keystore, tmp_path):
    names = ["/listener", "/talker"]
    bundle = Bundle.of(keystore, names, now=NOW)
    assert len(bundle.proof.lines) == 5
    put(tmp_path / "both", bundle, proofs=True)
    current = CredentialStore(tmp_path / "both").current.enclaves
    for name in names:
        proof = LedgerProof.from_bytes(current[name]["ledger.proof"])
        assert {each.name for each in proof.lines} == {name, ""}


def test_a_bundle_without_proof_is_installed_unless_one_is_demanded(bundle, robot):
    plain = replace(bundle, proof=None)
    put(robot, plain)
    assert proof_in(robot) is None
    assert refused(robot, plain, proofs=True)[0] == {Code.PROOF_MISSING}
    put(robot, plain)  # the demand was refused with the bundle
    assert not put(robot, bundle, proofs=True).already
    assert proof_in(robot)
    assert refused(robot, plain)[0] == {Code.PROOF_MISSING}


def test_a_newer_head_of_the_same_documents_is_no_other_set(keystore, bundle, robot):
    put(robot, bundle)
    renew(keystore, keystore.unlock(None), ["/talker"], now=NOW + DAY)
    later = Bundle.of(keystore, [ROBOT], now=NOW + DAY)
    assert later.proof != bundle.proof
    assert later.sha256 == bundle.sha256
    assert put(robot, later, now=NOW + DAY).already


def test_a_tree_that_is_kept_gives_the_proofs_of_a_new_one(tmp_path):
    keystore, tree = made(tmp_path / "k", "classical"), MerkleTree()

    def proven(kept):
        with BundleNumbers.of(keystore, kept) as numbers:
            return Bundle.of(keystore, ["/talker"], now=NOW, numbers=numbers).proof

    for change in (
        lambda: None,
        lambda: renew(keystore, keystore.unlock(None), ["/talker"], now=NOW),
        lambda: enter(keystore, [entry(900)]),  # no head is over it
        lambda: renew(keystore, keystore.unlock(None), ["/listener"], now=NOW),
    ):
        change()
        assert proven(tree) == proven(None) is not None
        assert tree.size == len(keystore.lines())
    rewrite(keystore, 2, operator="somebody else")
    for kept in (tree, None):
        with pytest.raises(KeystoreError, match="the ledger lacks one of the"):
            proven(kept)


def altered(proof, at=0, **changes):
    lines = list(proof.lines)
    lines[at] = replace(lines[at], **changes)
    return replace(proof, lines=tuple(lines))


@pytest.mark.parametrize("at", range(3))
@pytest.mark.parametrize("what", ["number", "name", "sha256", "chain", "path", "shorter", "gone"])
def test_a_proof_with_one_thing_wrong_is_refused(bundle, robot, what, at):
    proof, line = bundle.proof, bundle.proof.lines[at]
    changes = {
        "number": {"number": line.number - 1},
        "name": {"name": "/other"},
        "sha256": {"sha256": "0" * 64},
        "chain": {"chain": "0" * 64},
        "path": {"path": (leaf_hash(b""), *line.path[1:])},
        "shorter": {"path": line.path[1:]},
    }
    if what == "gone":
        bad = replace(proof, lines=tuple(each for each in proof.lines if each != line))
    else:
        bad = altered(proof, at, **changes[what])
    assert refused(robot, replace(bundle, proof=bad))[0] == {Code.PROOF_BAD}
    assert proof_in(robot) is None


@pytest.mark.parametrize("count", [16, 17])
def test_a_head_has_few_signatures(bundle, count):
    """Thousands of one valid signature would be verified for each participant of a bundle."""
    head = bundle.proof.checkpoint
    first = head.signatures[0]
    data = replace(head, signatures=(first,) * count).to_bytes()
    if count == 16:
        assert Checkpoint.from_bytes(data).head == head.head
    else:
        with pytest.raises(MalformedError):
            Checkpoint.from_bytes(data)


def test_a_proof_of_another_head_is_refused(keystore, bundle, robot, tmp_path):
    other = made(tmp_path / "other", "transition")
    good, authorities = bundle.proof.checkpoint, keystore.unlock(None)
    foreign = [each.key for each in other.unlock(None).signers]
    own = [each.key for each in authorities.signers]
    heads = {
        "signed by another CA": Checkpoint.signed(good.head, foreign),
        "without the countersigner": Checkpoint.signed(good.head, own[:1]),
        "without the permissions CA": Checkpoint.signed(good.head, own[1:]),
        "with the keys of another role": Checkpoint.signed(good.head, [authorities.identity.key]),
        "of another size": replace(good, text=replace(good.head, size=good.head.size + 1).text),
        "of another tree": Checkpoint.signed(replace(good.head, root=leaf_hash(b"")), own),
        "with altered text": replace(good, text=good.text + b"more\n"),
    }
    for what, head in heads.items():
        bad = replace(bundle, proof=replace(bundle.proof, checkpoint=head))
        codes, words = refused(robot, bad)
        assert Code.PROOF_BAD in codes, (what, words)
    put(robot, bundle)


def test_a_proof_of_other_documents_is_refused(keystore, bundle, robot):
    talker = Bundle.of(keystore, ["/talker"], now=NOW + DAY)
    codes, words = refused(robot, replace(bundle, proof=talker.proof))
    assert codes == {Code.PROOF_BAD}
    assert "no proof for the participant" in words


def test_what_was_issued_off_the_books_has_no_proof(keystore, bundle, robot):
    """Signed by the CAs, but in no ledger: their keys were used elsewhere."""
    signed = keystore.unlock(None).sign(
        (keystore.root / f"enclaves{ROBOT}/permissions.xml").read_bytes(), now=NOW + DAY
    )
    files = {**bundle.enclaves[ROBOT], "permissions.p7s": signed}
    secret = replace(bundle, enclaves={ROBOT: files})
    codes, words = refused(robot, secret, proofs=True, now=NOW + 2 * DAY)
    assert codes == {Code.PROOF_BAD}
    assert "no proof for the permissions" in words


def test_rollback_demands_proofs_too(keystore, robot, bundle):
    put(robot, replace(bundle, proof=None))
    put(robot, bundle, proofs=True)
    with pytest.raises(VerificationError, match="proof: it is missing"):
        rollback(robot, now=NOW)
    rollback(robot, now=NOW, older=True)
    assert proof_in(robot) is None
    assert refused(robot, replace(bundle, proof=None))[0] == {Code.PROOF_MISSING}


@pytest.mark.parametrize("value", [None, 5, "x", [], {"format": 2}, {"format": 1, "lines": []}])
def test_a_manifest_with_another_proof_is_refused(bundle, value):
    archive = Archive.unpack(bundle.to_bytes(), "bundle")
    data = replace(archive, about={**archive.about, "proof": value}).pack()
    with pytest.raises(MalformedError):
        Bundle.from_bytes(data)


def test_only_proofs_that_hold_are_given(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    assert Bundle.of(keystore, ["/talker"], now=NOW).proof
    enter(keystore, [entry(1)])  # a line in no head yet
    assert Bundle.of(keystore, ["/talker"], now=NOW).proof
    rewrite(keystore, 3, name="x")
    with pytest.raises(KeystoreError, match="the ledger lacks one of the"):
        Bundle.of(keystore, ["/talker"], now=NOW)
    forget_heads(keystore)
    assert Bundle.of(keystore, ["/talker"], now=NOW).proof is None


def test_the_agent_starts_no_participant_without_a_proof_that_holds(keystore, bundle, robot):
    put(robot, bundle)
    folder = robot / f"current/enclaves{ROBOT}"
    proof = folder / "ledger.proof"
    good = proof.read_bytes()
    shim, (pairs, where) = Shim("access_control", NOW), properties(folder)
    other = Bundle.of(keystore, ["/talker"], now=NOW + DAY).proof.to_bytes()
    cases = {b"": "not a proof", other: "ledger.proof: no proof for the", None: "it is missing"}
    for setting in ("", "proofs = true"):
        (folder / "pqsec.toml").write_text(setting)
        proof.write_bytes(good)
        assert shim.call("validate_local_permissions", 1, 0, where, pairs)
        for data, words in cases.items():
            proof.unlink() if data is None else proof.write_bytes(data)
            if setting:
                with pytest.raises(RefusedError, match=words):
                    shim.call("validate_local_permissions", 1, 0, where, pairs)
            else:
                assert shim.call("validate_local_permissions", 1, 0, where, pairs)


def test_check_finds_a_proof_that_does_not_hold(keystore, bundle, robot):
    put(robot, bundle)
    proof = robot / f"current/enclaves{ROBOT}/ledger.proof"
    other = Bundle.of(keystore, ["/talker"], now=NOW + DAY).proof.to_bytes()
    for data, words in ((None, ""), (other, "no proof for the"), (b"x", "not a proof")):
        if data:
            proof.write_bytes(data)
        found = check([robot / "current/"], now=NOW).findings
        told = [each for each in found if each.rule.id == "PQS319"]
        assert all(words in str(each.message) for each in told)
        assert bool(told) is (data is not None)
        assert {each.path.name for each in told} <= {"ledger.proof", ROBOT.rpartition("/")[2]}


def test_check_finds_a_missing_proof_where_it_is_demanded(bundle, robot):
    put(robot, bundle)
    proof = robot / f"current/enclaves{ROBOT}/ledger.proof"
    for there in (True, False):
        if not there:
            proof.unlink()
        for demanded in (True, False):
            found = check([robot / "current/"], now=NOW, proofs=demanded).findings
            told = [each for each in found if each.code is Code.PROOF_MISSING]
            assert bool(told) is (demanded and not there)
            assert {each.path for each in told} <= {proof}


def test_a_proof_is_not_demanded_of_a_keystore(keystore):
    with pytest.raises(UsageError, match="a keystore has no proofs"):
        check([keystore.root], now=NOW, proofs=True)


def test_a_proof_is_checked_against_the_verified_files(keystore, bundle):
    verified = verify_credentials(Credentials.of(ROBOT, bundle.enclaves[ROBOT]), now=NOW)
    known = (ROBOT, verified.anchors, verified.files)
    assert verify_logged(*known, bundle.proof) == bundle.proof
    assert verify_logged(*known, None) is None
    with pytest.raises(VerificationError):
        verify_logged(*known, None, demanded=True)
    assert isinstance(bundle.proof.checkpoint.head, TreeHead)
