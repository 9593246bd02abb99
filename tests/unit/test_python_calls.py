"""What a command does is one call: handshake, verify, explain, pins, apply."""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.access import CYCLONEDDS, Action, decide
from pqsec_pki.access.question import Question
from pqsec_pki.certificates import Reason
from pqsec_pki.credentials import IDENTITY_CA, verify_credentials
from pqsec_pki.domain import StepAction, apply, read_domain
from pqsec_pki.enrolment import Bundle, pin_texts, pins_in_use, pins_of, verify_bundle
from pqsec_pki.errors import KeystoreError, PassphraseError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore, Overlap
from pqsec_pki.lifecycle import Rollover, Scope, revoke
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import PQSEC, stack_named, verify_handshake
from tests.unit.domains import DAY, FILE, NAMES, Scene
from tests.unit.keystores import NOW, begin_overlap, made

LATER = NOW + DAY


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """/a on domain 1, /b on 1 and 2, /c on 2; not to be changed."""
    domains = {"/a": "1", "/b": "1,2", "/c": "2"}
    return made(tmp_path_factory.mktemp("original") / "k", "transition", "1-2", domains)


@pytest.fixture
def keystore(original, tmp_path):
    shutil.copytree(original.root, tmp_path / "k", symlinks=True)
    return Keystore.open(tmp_path / "k", to_change=True)


def test_two_meet_on_the_first_domain_that_both_may_join(original):
    report = verify_handshake(original, "/b", "c", now=NOW)
    assert (report.ok, report.domain, report.shared) == (True, 2, (2,))
    assert report.key_agreement == original.profile.key_agreement.wire_name


def test_each_participant_is_read_once(original, monkeypatch):
    read, names = Keystore.participant, []
    monkeypatch.setattr(Keystore, "participant", lambda *args: names.append(args[1]) or read(*args))
    assert verify_handshake(original, "/a", "b", now=NOW).talks
    assert names == ["/a", "/b"]


def test_a_domain_that_is_named_is_not_replaced_by_another(original):
    report = verify_handshake(original, "/b", "/c", domain=1, now=NOW)
    assert (report.ok, report.failed.name, report.domain) == (False, "documents of /c", 1)


def test_without_a_common_domain_that_is_the_step_that_fails(original):
    report = verify_handshake(original, "/a", "/c", now=NOW)
    assert (report.ok, report.failed.name) == (False, "common domain")


def test_the_second_may_behave_like_a_stack(original):
    stacks = (PQSEC, stack_named("cyclonedds"))
    report = verify_handshake(original, "/a", "/b", stacks=stacks, now=NOW)
    assert report.ok
    assert report.stacks == {"/a": "pqsec", "/b": "cyclonedds"}


def test_a_handshake_needs_participants_that_exist(original):
    with pytest.raises(KeystoreError, match="no participant /nobody"):
        verify_handshake(original, "/a", "/nobody", now=NOW)


def test_credentials_are_verified_by_name_also_without_their_key(keystore):
    (keystore.root / "enclaves/a/key.pem").unlink()
    verified = keystore.verified("a", now=NOW)
    assert (verified.name, verified.certificate.subject_name) == ("/a", "CN=/a")


def test_another_participant_s_key_is_not_verified(keystore):
    shutil.copyfile(keystore.root / "enclaves/b/key.pem", keystore.root / "enclaves/a/key.pem")
    with pytest.raises(VerificationError) as caught:
        keystore.verified("/a", now=NOW)
    assert Code.KEY_MISMATCH in caught.value.codes


def test_an_enclave_of_other_cas_is_not_verified_though_it_agrees_with_itself(keystore, tmp_path):
    other = made(tmp_path / "other", "transition", "1", ("/a",))
    shutil.rmtree(keystore.root / "enclaves/a")
    shutil.copytree(other.root / "enclaves/a", keystore.root / "enclaves/a")  # no links
    assert verify_credentials(keystore.participant("/a"), now=NOW)
    with pytest.raises(VerificationError) as caught:
        keystore.verified("/a", now=NOW)
    assert Code.BAD_SIGNATURE in caught.value.codes


def test_an_enclave_without_its_revocation_list_is_still_revoked(keystore):
    revoke(keystore, keystore.unlock(None), ["/a"], reason=Reason.UNSPECIFIED, now=NOW)
    (keystore.root / "enclaves/a/crl.pem").unlink()
    with pytest.raises(VerificationError) as caught:
        keystore.verified("/a", now=NOW + DAY / 24)
    assert Code.REVOKED in caught.value.codes


@pytest.mark.parametrize("interpretation", [None, CYCLONEDDS])
@pytest.mark.parametrize(
    ("action", "topic", "domain"),
    [
        (Action.PUBLISH, "x", 1),
        (Action.PUBLISH, "y", 1),
        (Action.SUBSCRIBE, "x", 1),
        (Action.JOIN, None, 1),
        (Action.JOIN, None, 2),
    ],
)
def test_verified_credentials_answer_as_their_documents(
    original, action, topic, domain, interpretation
):
    verified = original.verified("/a", now=NOW)
    options = {"interpretation": interpretation} if interpretation else {}
    question = Question(subject="CN=/a", domain=domain, action=action, topic=topic, now=NOW)
    documents = verified.governance.value, verified.permissions.value
    assert verified.decide(action, topic, domain=domain, now=NOW, **options) == decide(
        *documents, question, *options.values()
    )
    if not interpretation:
        allowed = (topic, domain) in {("x", 1), (None, 1)} and action is not Action.SUBSCRIBE
        assert verified.decide(action, topic, domain=domain, now=NOW).allowed is allowed


def test_an_action_on_a_topic_needs_one(original):
    with pytest.raises(UsageError, match="needs a topic"):
        original.verified("/a", now=NOW).decide(Action.PUBLISH, domain=1, now=NOW)


def test_a_robot_with_the_pins_in_use_accepts_a_bundle(original):
    pins = pins_in_use(original)
    assert pins_of(pin_texts(pins)) == pins
    bundle = Bundle.of(original, ["/a"], now=NOW, keys=False)
    assert verify_bundle(bundle, pins, now=NOW)
    with pytest.raises(VerificationError):
        verify_bundle(bundle, {IDENTITY_CA: pins[IDENTITY_CA]}, now=NOW)


def test_in_an_overlap_both_identity_cas_are_in_use(keystore):
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(keystore, terms, kept=keystore.unlock(None), passphrase=None, now=LATER)
    overlap = Overlap.of(keystore)
    both = {overlap.issuing.fingerprint, overlap.other.fingerprint}
    assert pins_in_use(keystore)[IDENTITY_CA] == both
    # A second CA that no overlap put there is not trusted, and robots would refuse the file.
    path = keystore.root / "public/identity_ca.cert.pem"
    path.write_bytes(overlap.issuing.pem + keystore.permissions_ca.pem)
    with pytest.raises(KeystoreError, match="does not have the CA certificates that"):
        pins_in_use(keystore)


def test_apply_creates_a_keystore_and_changes_it(tmp_path):
    scene = Scene(tmp_path)
    done = apply(read_domain(scene.file), scene.root, passphrase=b"secret", now=NOW)
    assert done.steps[0].action is StepAction.CREATE_CAS
    assert scene.keystore.names() == NAMES
    assert scene.keystore.is_locked()
    assert scene.plan().in_order
    # Nothing is left to do: the passphrase is not needed.
    assert not apply(read_domain(scene.file), scene.root, passphrase=None, now=NOW).steps
    scene.change("1..3", "1..2")
    desired = read_domain(scene.file)
    with pytest.raises(PassphraseError):
        apply(desired, scene.root, passphrase=b"wrong", now=NOW, prune=True)
    pruned = apply(desired, scene.root, passphrase=b"secret", now=NOW, prune=True)
    assert [(step.action, step.name) for step in pruned.steps] == [(StepAction.REVOKE, "/r3")]


def test_a_truncated_file_revokes_no_fleet(tmp_path):
    scene = Scene(tmp_path, FILE.replace("transition", "classical"))
    scene.apply()
    scene.change('  - {name: "/r{1..3}", role: robot}\n', "")
    desired = replace(read_domain(scene.file), prune=True)
    with pytest.raises(UsageError, match="3 participants would be revoked"):
        apply(desired, scene.root, passphrase=None, now=NOW)
    done = apply(desired, scene.root, passphrase=None, now=NOW, revoke_most=True)
    assert done.revoked == 3


def test_a_folder_without_a_keystore_has_none_and_half_a_keystore_is_an_error(tmp_path):
    assert Keystore.find(tmp_path / "k") is None
    (tmp_path / "k/private").mkdir(parents=True)
    with pytest.raises(KeystoreError, match="not a pqsec keystore"):
        Keystore.find(tmp_path / "k")
