"""CAs without a network: files that fit together, may come twice, and show what was altered."""

import hashlib
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate, certificate_request
from pqsec_pki.documents import DomainSet, Grant
from pqsec_pki.enrolment import (
    Bundle,
    SignRequest,
    accept,
    install,
    offline,
    request,
    sign,
    tarball,
)
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.errors import ExistsError, MalformedError, PqsecError, VerificationError
from pqsec_pki.keystore import audit
from pqsec_pki.lifecycle import ParticipantSpec, revoke
from tests.unit.keystores import made
from tests.unit.killing import NOW, YEAR

NAMES = ("/fleet/robot1", "/fleet/robot2")
PROFILE = profile_named("transition")
GRANT = Grant.least(
    name=NAMES[1],
    subject_name=f"CN={NAMES[1]}",
    not_before=NOW - timedelta(days=1),
    not_after=NOW + YEAR,
    domains=DomainSet.of(3),
    publish=["from/a/policy"],
    subscribe=[],
)


@pytest.fixture
def keystore(tmp_path):
    """The CAs, on a machine of their own."""
    return made(tmp_path / "ca", "transition", names=())


def collected(tmp_path, *names):
    """The file that the machine with the network makes."""
    robots = {name: request(name, PROFILE, tmp_path / name[1:], force=True) for name in names}
    specs = [
        ParticipantSpec(
            name=name,
            domains=DomainSet.parse("0,2-5"),
            publish=("t",),
            subscribe=("command/*", "é"),
            validity=timedelta(days=90),
            grants=(GRANT,) if name == NAMES[1] else (),
        )
        for name in names
    ]
    requests = tuple(each.request for each in robots.values())
    return SignRequest(requests, tuple(specs)).to_bytes(now=NOW)


@pytest.fixture
def exported(tmp_path):
    return collected(tmp_path, *NAMES)


def answer_to(keystore, data, now=NOW, **options):
    asked = SignRequest.from_bytes(data)
    return sign(asked, keystore, keystore.unlock(None), now=now, **options)


def test_a_request_says_the_same_when_it_is_read(exported):
    found = SignRequest.from_bytes(exported)
    assert [spec.name for spec in found.specs] == list(NAMES)
    assert found.sha256 == hashlib.sha256(exported).hexdigest()
    first, second = found.specs
    assert (str(first.domains), first.publish, first.subscribe) == (
        *("0,2-5", ("t",), ("command/*", "é")),
    )
    assert first.validity == timedelta(days=90)
    assert (first.grants, second.grants) == ((), (GRANT,))


def test_what_was_asked_for_comes_back_and_is_installed(tmp_path, keystore, exported):
    asked = SignRequest.from_bytes(exported)
    found = accept(answer_to(keystore, exported), asked, tmp_path / "back", now=NOW)
    assert [(each.name, each.path.name, each.already) for each in found] == [
        (NAMES[0], "fleet+robot1.bundle", False),
        (NAMES[1], "fleet+robot2.bundle", False),
    ]
    for each in found:
        done = install(each.path, tmp_path / each.name[1:], (), now=NOW, trust_first=True)
        assert done.names == (each.name,)
    xml = (keystore.root / "enclaves/fleet/robot2/permissions.xml").read_text()
    assert "from/a/policy" in xml
    certificate = Certificate.from_pem(
        (tmp_path / "fleet/robot1/current/enclaves/fleet/robot1/cert.pem").read_bytes()
    )
    assert certificate.not_after == NOW + timedelta(days=90)
    audit(keystore)


def test_signing_and_importing_again_does_no_harm(tmp_path, keystore, exported):
    asked = SignRequest.from_bytes(exported)
    first = answer_to(keystore, exported)
    before = keystore.ledger()
    again = answer_to(keystore, exported, now=NOW + timedelta(hours=1))
    assert keystore.ledger() == before
    accept(first, asked, tmp_path, now=NOW)
    files = {each: each.read_bytes() for each in tmp_path.glob("*.bundle")}
    assert len(files) == 2
    for answer in (first, again):
        assert all(each.already for each in accept(answer, asked, tmp_path, now=NOW))
        assert {each: each.read_bytes() for each in tmp_path.glob("*.bundle")} == files


def test_another_file_for_the_same_names_is_not_taken_for_the_same(tmp_path, keystore, exported):
    answer = answer_to(keystore, exported)
    other = collected(tmp_path, *NAMES)
    with pytest.raises(ExistsError, match="already issued"):
        answer_to(keystore, other)
    with pytest.raises(VerificationError, match="answers another request"):
        accept(answer, SignRequest.from_bytes(other), tmp_path, now=NOW)
    later = answer_to(keystore, other, force=True)
    accept(answer, SignRequest.from_bytes(exported), tmp_path, now=NOW)
    with pytest.raises(ExistsError, match="and is a different bundle"):
        accept(later, SignRequest.from_bytes(other), tmp_path, now=NOW)
    accept(later, SignRequest.from_bytes(other), tmp_path, now=NOW, force=True)


def test_an_import_that_is_refused_writes_nothing(tmp_path, keystore, exported):
    goal = tmp_path / "back"
    goal.mkdir()
    (goal / "fleet+robot2.bundle").write_bytes(b"mine")
    with pytest.raises(ExistsError):
        accept(answer_to(keystore, exported), SignRequest.from_bytes(exported), goal, now=NOW)
    assert [each.name for each in goal.iterdir()] == ["fleet+robot2.bundle"]


def test_an_answer_of_other_cas_is_refused_where_they_are_named(tmp_path, keystore, exported):
    other = made(tmp_path / "other", "transition", names=())
    pins = Bundle.of(made(tmp_path / "third", "transition", names=("/a",)), ["/a"], now=NOW)
    asked = SignRequest.from_bytes(exported)
    with pytest.raises(VerificationError, match="is not trusted in this role"):
        accept(
            *(answer_to(other, exported), asked, tmp_path),
            pins=pins.roles,
            now=NOW,
        )


def altered(answer, change):
    """The answer with its parcel changed, and a manifest to match."""
    parcel = Archive.unpack(answer, "sign answer")
    about, files = dict(parcel.about), dict(parcel.files)
    change(about, files)
    return Archive("sign answer", about, files).pack()


FILES = [f"bundles/fleet+robot{number}.bundle" for number in (1, 2)]


def swap(about, files):
    files[FILES[0]], files[FILES[1]] = files[FILES[1]], files[FILES[0]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda about, files: about.update(request_sha256="00" * 32), "another request"),
        (
            lambda about, files: files.pop(FILES[0]),
            "does not have exactly one answer for each request",
        ),
        (
            lambda about, files: files.update({"bundles/more": b""}),
            "not have exactly one answer for each request",
        ),
        (swap, "the bundle of /fleet/robot1 is for /fleet/robot2"),
    ],
)
def test_an_answer_that_does_not_fit_is_refused(tmp_path, keystore, exported, change, words):
    answer = altered(answer_to(keystore, exported), change)
    with pytest.raises(VerificationError, match=words):
        accept(answer, SignRequest.from_bytes(exported), tmp_path, now=NOW)


def test_a_certificate_for_another_key_than_was_asked_for_is_refused(tmp_path, keystore, exported):
    answer = answer_to(keystore, exported)
    other = answer_to(made(tmp_path / "k", "transition", names=()), collected(tmp_path, *NAMES))
    files = Archive.unpack(other, "sign answer").files
    bad = altered(answer, lambda about, ours: ours.update(files))
    with pytest.raises(VerificationError, match="for another key than in the request"):
        accept(bad, SignRequest.from_bytes(exported), tmp_path, now=NOW)


def test_a_certificate_for_another_second_key_is_refused(tmp_path, keystore):
    key, *seconds = (
        each.generate()
        for each in (PROFILE.participant_key, PROFILE.alternative_key, PROFILE.alternative_key)
    )
    ours, other = (certificate_request(NAMES[0], key, second) for second in seconds)
    spec = ParticipantSpec(name=NAMES[0], domains=DomainSet.of(0), publish=("t",), validity=YEAR)
    data = SignRequest((ours,), (spec,)).to_bytes(now=NOW)
    asked = SignRequest.from_bytes(data)
    answer = answer_to(keystore, data)
    with pytest.raises(VerificationError, match="for another key than in the request"):
        accept(answer, replace(asked, requests=(other,)), tmp_path, now=NOW)
    accept(answer, asked, tmp_path, now=NOW)


def test_bundles_that_unpack_to_more_than_a_machine_has_are_refused(
    tmp_path, keystore, exported, monkeypatch
):
    answer, asked = answer_to(keystore, exported), SignRequest.from_bytes(exported)
    monkeypatch.setattr(offline, "MAX_UNPACKED", len(answer))
    with pytest.raises(MalformedError, match="bundles are larger than"):
        accept(answer, asked, tmp_path, now=NOW)


def test_an_answer_never_holds_a_private_key(tmp_path, keystore, exported):
    answer_to(keystore, exported)
    stray = keystore.root / "enclaves/fleet/robot1/key.pem"
    stray.write_bytes((tmp_path / "fleet/robot1/requests/fleet+robot1/key.pem").read_bytes())
    files = Archive.unpack(answer_to(keystore, exported), "sign answer").files
    assert not any(Bundle.from_bytes(data).has_keys for data in files.values())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda spec: spec.update(name="/other"), "cannot be read"),
        (lambda spec: spec.update(name="fleet/robot1"), "is not a participant's name"),
        (lambda spec: spec.update(name="/fleet//robot1"), "is not a participant's name"),
        (lambda spec: spec.update(name="/fleet/robot1\0"), "is not valid"),
        (lambda spec: spec.update(name=f"/{'x' * 300}"), "is not valid"),
        (lambda spec: spec.update(domains="x"), "is not valid"),
        (lambda spec: spec.update(validity_hours="many"), "cannot be read"),
        (lambda spec: spec.update(validity_hours=10**12), "cannot be read"),
        (lambda spec: spec.update(publish=3), "cannot be read"),
        (lambda spec: spec.update(publish="t"), "cannot be read"),
        (lambda spec: spec.pop("subscribe"), "cannot be read"),
    ],
)
def test_a_request_that_cannot_be_read_is_refused(exported, change, words):
    parcel = Archive.unpack(exported, "sign request")
    change(parcel.about["wishes"][0])
    with pytest.raises(MalformedError, match=words):
        SignRequest.from_bytes(Archive(parcel.kind, parcel.about, parcel.files).pack())


@pytest.mark.parametrize("specs", [None, 3, [], "abc", [3], [None]])
def test_wishes_that_are_none_are_refused(specs):
    data = Archive("sign request", {"wishes": specs}, {}).pack()
    with pytest.raises(MalformedError, match=r"cannot be read|asks for nothing"):
        SignRequest.from_bytes(data)


def test_names_that_do_not_fit_the_pattern_are_refused_before_anything_is_issued(
    keystore, exported
):
    with pytest.raises(VerificationError, match="not one of the allowed names: /arm"):
        answer_to(keystore, exported, patterns=["/arm/*", "/*/robot1"][:1])
    assert keystore.names() == []
    answer_to(keystore, exported, patterns=["/fleet/*"])


def test_a_request_for_a_revoked_name_is_refused_unless_told(tmp_path, keystore, exported):
    answer_to(keystore, exported)
    revoke(keystore, keystore.unlock(None), [NAMES[0]], now=NOW)
    other = collected(tmp_path, *NAMES)
    with pytest.raises(PqsecError, match="revoked: /fleet/robot1"):
        answer_to(keystore, other, force=True)
    answer_to(keystore, other, force=True, after_revocation=True)


def test_a_bit_that_flips_in_a_file_is_seen_or_changes_nothing(keystore, exported):
    whole = SignRequest.from_bytes(exported)
    for place in range(0, len(exported), 13):
        bad = bytearray(exported)
        bad[place] ^= 1 << place % 8
        try:
            found = SignRequest.from_bytes(bytes(bad))
        except PqsecError:
            continue
        assert found.specs == replace(whole, sha256="").specs
        assert [each.der for each in found.requests] == [each.der for each in whole.requests]
    assert tarball.unpack(exported)
