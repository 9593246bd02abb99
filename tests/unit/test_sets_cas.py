"""Replacing the CAs of one of several sets of credentials: the others stay as they are."""

from dataclasses import replace

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import Authorities, Keystore, Overlap, audit, layout, status
from pqsec_pki.keystore.anchoring import read_anchors, write_anchor
from pqsec_pki.keystore.set_faults import faults_of_sets
from pqsec_pki.lifecycle import (
    Renewal,
    Rollover,
    Scope,
    add_set,
    apply_rollover,
    change_passphrase,
    issue,
    plan_rollover,
    renew,
    renew_list,
    revoke,
)
from pqsec_pki.lifecycle._ca_changes import refuse_known
from tests.unit.keystores import (
    DAY,
    begin_overlap,
    cancel_overlap,
    finish_overlap,
    rotate,
    switch_overlap,
)
from tests.unit.killing import copies, fails, survives
from tests.unit.test_sets import (
    ABOUT_THE_LEDGER,
    CLASSICAL,
    HYBRID,
    LATER,
    PQ,
    TWO,
    create,
    files_of,
    issued,
    one_meaning,
    one_meaning_but_numbers,
    spec,
    states,
)


@pytest.fixture(params=[HYBRID, PQ], ids=["hybrid", "pq"])
def keystore(tmp_path, request):
    """A keystore with a classical set and another one, and two participants."""
    made = create(tmp_path / "k", CLASSICAL, request.param)
    issued(made)
    return made


def terms(view, **others):
    return Rollover(profile=view.profile, **{"validity": 900 * DAY, **others})


def rotated(view, *, now=LATER, kept=None, passphrase=None, **others):
    kept = kept or view.unlock(passphrase)
    return rotate(view, terms(view, **others), kept=kept, passphrase=passphrase, now=now)


def certificates(view):
    return {name: view.participant(name).certificate for name in view.names()}


each_set = pytest.mark.parametrize("number", [0, 1], ids=["first", "further"])


@each_set
@pytest.mark.parametrize("scope", Scope)
def test_the_cas_of_one_set_are_replaced_and_the_files_of_the_other_stay(keystore, number, scope):
    view, other = keystore.sets[number], keystore.sets[1 - number]
    old = view.identity_ca, view.permissions_ca, certificates(view)
    before = files_of(other.folder)
    done = rotated(view, scope=scope)
    assert [each.name for each in done.issued] == list(TWO)
    after = files_of(other.folder)
    assert {each for each in after if before.get(each) != after[each]} <= ABOUT_THE_LEDGER
    opened = Keystore.open(keystore.root, to_change=True)
    assert opened.profiles == keystore.profiles
    assert (view.identity_ca == old[0]) is (scope is Scope.PERMISSIONS)
    assert (view.permissions_ca == old[1]) is (scope is Scope.IDENTITY)
    for name, certificate in certificates(view).items():
        assert certificate.der != old[2][name].der
        assert certificate.spki == old[2][name].spki
    one_meaning_but_numbers(opened, *TWO)
    assert states(opened) == dict.fromkeys(TWO, "valid")
    assert list(faults_of_sets(opened)) == []


@each_set
def test_all_sets_change_together_after_a_rotation(keystore, number):
    rotated(keystore.sets[number])
    opened = Keystore.open(keystore.root, to_change=True)
    authorities, now = opened.unlock(None), LATER + DAY
    renew(opened, authorities, TWO, Renewal(validity=80 * DAY), now=now)
    issue(opened, authorities, [spec("/new")], now=now)
    one_meaning(opened, *TWO, "/new", now=now)
    revoke(opened, authorities, ["/new"], now=now)
    lists = [each.revocation_list for each in opened.sets]
    assert len({each.number for each in lists}) == 1
    audit(opened)


def test_the_sets_are_rotated_one_after_the_other_and_again(keystore):
    for round_number in (1, 2):
        for view in keystore.sets:
            done = rotated(view, now=LATER + round_number * DAY)
            assert done.plan.generation == round_number + 1
            assert (view.folder / layout.GENERATIONS / str(round_number)).is_dir()
    one_meaning_but_numbers(Keystore.open(keystore.root), *TWO, now=LATER + 3 * DAY)
    names = [each.identity_ca.subject_name for each in keystore.sets]
    assert names == ["CN=Lab G3 Identity CA", f"CN=Lab {keystore.profiles[1].name} G3 Identity CA"]


@each_set
def test_keys_are_replaced_where_it_is_asked(keystore, number):
    views = keystore.sets
    before = [certificates(each) for each in views]
    rotated(views[number], rekey=True)
    for place, each in enumerate(views):
        kept = [each.participant(name).certificate.spki == before[place][name].spki for name in TWO]
        assert kept == [place != number] * 2
    one_meaning_but_numbers(keystore, *TWO)


@each_set
def test_a_new_list_of_one_set_keeps_the_number_of_the_others(keystore, number):
    authorities = keystore.unlock(None)
    for day in range(3):
        renew_list(keystore, authorities, now=LATER + day * DAY)
    rotated(keystore.sets[number], now=LATER + 4 * DAY)
    assert [each.revocation_list.number for each in keystore.sets] == [3, 3]
    assert list(faults_of_sets(keystore)) == []
    revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER + 5 * DAY)
    assert [each.revocation_list.number for each in keystore.sets] == [4, 4]


@each_set
def test_a_set_whose_ca_keys_are_lost_is_rotated_with_the_keys_of_the_others(keystore, number):
    view, other = keystore.sets[number], keystore.sets[1 - number]
    for key in (view.folder / "private").glob("*.key.pem"):
        key.write_bytes(b"lost")
    kept = keystore.unlock(None, without=(view.set_name,))
    rotated(view, kept=kept)
    keystore.unlock(None)
    one_meaning_but_numbers(keystore, *TWO)
    assert other.identity_ca.fingerprint == kept.of(other.set_name).identity.certificate.fingerprint


@pytest.mark.parametrize("scope", Scope)
def test_without_the_keys_of_the_others_no_set_is_rotated(keystore, scope):
    """The head of the ledger would be signed by fewer than all sets, and be refused."""
    for view in keystore.sets:
        plan = plan_rollover(view, terms(view, scope=scope), now=LATER)
        assert plan.needs_other_sets
        with pytest.raises(UsageError, match="keys of the CAs that stay"):
            apply_rollover(view, plan, now=LATER)


def test_old_keys_of_one_set_are_destroyed_and_no_others(keystore):
    view, other = keystore.sets[1], keystore.sets[0]
    old = {path.read_bytes() for path in (view.folder / "private").glob("*.key.pem")}
    rotated(view, destroy=True)
    there = {path.read_bytes() for path in keystore.root.rglob("*.key.pem") if path.is_file()}
    assert not old & there
    assert len([*(other.folder / "private").glob("*.key.pem")]) == 2


def test_a_set_keeps_its_profile(keystore):
    for view in keystore.sets:
        other = next(each for each in (CLASSICAL, HYBRID, PQ) if each not in keystore.profiles)
        with pytest.raises(UsageError, match="keeps its profile"):
            plan_rollover(view, Rollover(profile=other), now=LATER)


def test_a_new_ca_has_neither_name_nor_key_of_one_of_another_set(keystore):
    second = keystore.sets[1]
    with pytest.raises(UsageError, match="is the name of another CA"):
        rotated(second, name="Lab")
    with pytest.raises(UsageError, match="is the name of another CA"):
        overlap(begin_overlap, second, name="Lab")
    kept = keystore.unlock(None)
    keys = {layout.IDENTITY_KEY: kept.identity.key}
    made = Authorities.create(CLASSICAL, "Other", now=LATER, validity=DAY, keys=keys)
    with pytest.raises(UsageError, match="key of another CA"):
        refuse_known(kept, replace(made, set_name=second.set_name))


def test_a_participant_whose_certificate_ended_is_left_out(keystore):
    view, later = keystore.sets[1], LATER + 300 * DAY
    plan = plan_rollover(view, terms(view), now=later)
    assert {*plan.left_out} == {*TWO}
    assert all("its certificate ended on" in each for each in plan.left_out.values())


def test_a_revoked_participant_is_left_out_in_each_set(keystore):
    revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    for view in keystore.sets:
        assert rotated(view).plan.left_out == {"/talker": "revoked"}
    one_meaning_but_numbers(keystore, "/listener")


def test_heads_and_anchors_of_earlier_generations_of_each_set_are_known(keystore, tmp_path):
    anchors = tmp_path / "anchors"
    write_anchor(keystore, anchors)
    for view in (keystore.sets[1], keystore.sets[0], keystore.sets[1]):
        rotated(view)
        write_anchor(keystore, anchors)
    assert len(read_anchors(anchors)) == 4
    audit(keystore)


def test_an_anchor_that_only_an_earlier_ca_of_a_further_set_signed_is_known(keystore, tmp_path):
    """By its generation, which is in the folder of the set."""
    view, anchors = keystore.sets[1], tmp_path / "anchors"
    old = view.permissions_ca
    write_anchor(keystore, anchors)
    [path] = anchors.iterdir()
    kept = [
        line
        for line in path.read_text().splitlines(keepends=True)
        if not line.startswith("\N{EM DASH}") or _signed_by_last(path, line)
    ]
    path.write_text("".join(kept))
    rotated(view)
    rotated(keystore.sets[0])
    assert view.permissions_ca != old
    write_anchor(keystore, anchors)
    for each in (view.folder / layout.GENERATIONS / "1").iterdir():
        each.unlink()
    with pytest.raises(VerificationError, match="not signed by a CA of this keystore"):
        write_anchor(keystore, anchors)


def _signed_by_last(path, line):
    lines = [each for each in path.read_text().splitlines(keepends=True) if each[0] == line[0]]
    return line == lines[-1]


# An overlap in one set


def overlap(step, view, **others):
    if step in {finish_overlap, cancel_overlap}:
        how = {finish_overlap: "finish", cancel_overlap: "cancel"}[step]
        return rotate(
            view,
            terms(view, scope=Scope.IDENTITY, overlap=how),
            kept=view.unlock(None),
            now=LATER,
        )
    how = terms(view, scope=Scope.IDENTITY, **others)
    return step(view, how, kept=view.unlock(None), passphrase=None, now=LATER)


def trusted(view):
    data = (view.folder / "public/identity_ca.cert.pem").read_bytes()
    return [each.subject_name for each in Certificate.all_from_pem(data)]


@each_set
def test_two_generations_of_one_set_are_trusted_while_the_other_stays(keystore, number):
    view, other = keystore.sets[number], keystore.sets[1 - number]
    before = files_of(other.folder)
    for step, count in ((begin_overlap, 2), (switch_overlap, 2), (finish_overlap, 1)):
        overlap(step, view)
        assert len(trusted(view)) == count
        assert len(trusted(other)) == 1
        assert (Overlap.of(view) is None) is (count == 1)
        assert Overlap.of(other) is None
        one_meaning_but_numbers(keystore, *TWO)
        assert states(keystore) == dict.fromkeys(TWO, "valid")
        assert list(faults_of_sets(keystore)) == []
    after = files_of(other.folder)
    assert {each for each in after if before.get(each) != after[each]} <= ABOUT_THE_LEDGER
    assert "G2" in trusted(view)[0]


@each_set
def test_an_overlap_of_one_set_is_cancelled(keystore, number):
    view = keystore.sets[number]
    before = trusted(view)
    overlap(begin_overlap, view)
    overlap(cancel_overlap, view)
    assert trusted(view) == before
    assert not [*view.folder.rglob("next_*")]
    one_meaning_but_numbers(keystore, *TWO)


def test_both_sets_may_overlap_at_once(keystore):
    for step in (begin_overlap, switch_overlap, finish_overlap):
        for view in keystore.sets:
            overlap(step, view)
        one_meaning_but_numbers(keystore, *TWO)
        audit(keystore)
    assert all("G2" in trusted(each)[0] for each in keystore.sets)


def test_the_next_step_of_an_overlap_names_the_set(keystore):
    view = keystore.sets[1]
    overlap(begin_overlap, view)
    with pytest.raises(KeystoreError) as refused:
        rotated(view)
    words = f"`pqsec ca rotate --set {view.profile.name} --overlap switch`"
    assert words in refused.value.hint
    with pytest.raises(KeystoreError, match="no overlap has begun") as refused:
        overlap(switch_overlap, keystore.sets[0])
    assert "--set classical" in refused.value.hint


@each_set
@pytest.mark.parametrize("end", [finish_overlap, cancel_overlap])
def test_the_list_of_an_overlapping_set_goes_and_comes_back_with_it(keystore, number, end):
    view, other = keystore.sets[number], keystore.sets[1 - number]
    for day in range(3):
        renew_list(keystore, keystore.unlock(None), now=LATER - day * DAY)
    overlap(begin_overlap, view)
    assert (view.has_revocation_list, other.has_revocation_list) == (False, True)
    assert status(keystore, now=LATER).revocation_list.state == "valid"
    assert list(faults_of_sets(keystore)) == []
    if end is finish_overlap:
        overlap(switch_overlap, view)
    renew(keystore, keystore.unlock(None), ["/talker"], Renewal(validity=60 * DAY), now=LATER)
    overlap(end, view)
    # The same CA gives its next list a larger number; a new one has that of the others.
    assert other.revocation_list.number == 3
    assert view.revocation_list.number == (3 if end is finish_overlap else 4)
    view.revocation_list.verify(view.identity_ca)
    assert (view.folder / "enclaves/talker/crl.pem").resolve() == view.revocation_list_path
    assert list(faults_of_sets(keystore)) == []
    one_meaning_but_numbers(keystore, *TWO)


def test_lists_of_the_others_are_renewed_during_an_overlap(keystore):
    view = keystore.sets[1]
    renew_list(keystore, keystore.unlock(None), now=LATER, validity=10 * DAY)
    overlap(begin_overlap, view)
    later = LATER + 9 * DAY
    renew(keystore, keystore.unlock(None), ["/talker"], Renewal(due=5 * DAY), now=later)
    assert keystore.sets[0].revocation_list.number == 2
    assert not view.has_revocation_list


@pytest.mark.parametrize("number", [0, 1])
def test_nobody_is_revoked_in_one_set_only(keystore, number):
    """A set with two trusted CAs cannot have a list."""
    overlap(begin_overlap, keystore.sets[number])
    before = keystore.head
    with pytest.raises(KeystoreError, match="a revocation list would cover only one"):
        revoke(keystore, keystore.unlock(None), ["/talker"], now=LATER)
    assert keystore.head == before


@pytest.mark.parametrize("number", [0, 1])
def test_a_passphrase_is_not_changed_while_a_set_has_a_next_key(keystore, number):
    overlap(begin_overlap, keystore.sets[number])
    with pytest.raises(KeystoreError, match="would keep the old passphrase"):
        change_passphrase(keystore, keystore.unlock(None), b"other")


@pytest.mark.parametrize("number", [0, 1])
def test_no_set_is_added_while_one_overlaps(tmp_path, number):
    made = create(tmp_path / "k", CLASSICAL, HYBRID)
    overlap(begin_overlap, made.sets[number])
    with pytest.raises(KeystoreError, match="two identity CAs are trusted"):
        add_set(made, made.unlock(None), PQ, validity=900 * DAY, passphrase=None, now=LATER)


# All or none, wherever the process dies


BEFORE = {switch_overlap: (begin_overlap,), finish_overlap: (begin_overlap, switch_overlap)}
"""Step of an overlap -> the steps before it."""


@pytest.mark.parametrize("trial", [survives, fails], ids=["killed", "disk refuses"])
@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    "step",
    [None, begin_overlap, switch_overlap, finish_overlap],
    ids=["at once", "begin", "switch", "finish"],
)
def test_a_rotation_of_one_set_is_done_or_not(tmp_path, place, trial, number, step):
    made = create(tmp_path / "k", CLASSICAL, HYBRID)
    issued(made)
    renew_list(made, made.unlock(None), now=LATER)
    for each in BEFORE.get(step, ()):
        overlap(each, made.sets[number])

    def work(root):
        view = Keystore.open(root, to_change=True).sets[number]
        overlap(step, view) if step else rotated(view, destroy=True)

    outcomes = []
    for root, _ in copies(place, made.root, work, trial, every=17):
        Keystore.recover(root)
        opened = Keystore.open(root, to_change=True)
        audit(opened)
        opened.unlock(None)
        one_meaning_but_numbers(opened, *TWO)
        assert list(faults_of_sets(opened)) == []
        view, other = opened.sets[number], opened.sets[1 - number]
        assert "G2" not in "".join(trusted(other))
        outcomes.append((*trusted(view), view.has_revocation_list))
    assert len({*outcomes}) == 2
