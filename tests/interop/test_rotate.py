"""Real stacks across a rollover: who trusts two generations of CAs at once, and who does not.

A robot of each generation, with the files that it would have; the plugins of Cyclone DDS
and of Fast DDS decide whether the two let each other in.
"""

import shutil
from contextlib import ExitStack
from functools import cache
from itertools import pairwise

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.lifecycle import Rollover, Scope, renew_list
from tests.interop.conftest import LAB_PROFILES, Lab
from tests.interop.cyclone import RefusedError
from tests.interop.either import STACKS, meet, participants_of
from tests.interop.fastdds import participant as fastdds_participant
from tests.unit.keystores import rotate

pytestmark = pytest.mark.interop


@pytest.fixture(scope="module")
def generations(tmp_path_factory, now):
    """generations(scope) are the folders of alice, before the rollover, and of bob, after."""
    folder = tmp_path_factory.mktemp("generations")

    def make(scope, profile="transition", to="transition"):
        lab = Lab.create(folder / f"{scope}-{profile}-{to}", LAB_PROFILES[profile], now)
        alice = folder / f"alice-{scope}-{profile}-{to}"
        shutil.copytree(lab.alice, alice)
        terms = Rollover(profile=profile_named(to), scope=scope)
        rotate(lab.keystore, terms, kept=lab.authorities, passphrase=None, now=now)
        bob = folder / f"bob-{scope}-{profile}-{to}"
        shutil.copytree(lab.bob, bob)
        return alice, bob

    return cache(make)


@pytest.fixture(params=STACKS)
def stack(request):
    """Cyclone DDS or Fast DDS, as they are installed here."""
    return request.param


@pytest.fixture
def starts(request, stack):
    """starts(folder) is a participant of the stack."""
    with participants_of(stack, request) as made:
        yield made


def with_both(copy, folder, order, name):
    """A copy of the folder that has the CAs of both generations in the file `name`."""
    return copy(folder, {name: b"".join((each / name).read_bytes() for each in order)})


def with_folder(copy, folder, order):
    """A copy of the folder, and in it a folder `trusted` of the identity CAs of both."""
    made = copy(folder, {})
    (made / "trusted").mkdir()
    for number, each in enumerate(order):
        ca = (each / "identity_ca.cert.pem").read_bytes()
        (made / "trusted" / f"{number}.pem").write_bytes(ca)
    return made


def judge(starts, pair, *, good):
    """The two let each other in, or not, with either of them as initiator."""
    for first, second in (pair, reversed(pair)):
        if good:
            meet(starts, first, second)
        else:
            with pytest.raises(RefusedError):
                meet(starts, first, second)


def rounds(old, new, trusting):
    """What a robot has: old; trusting both; new, and trusting both; new."""
    return [old, trusting(old), trusting(new), new]


@pytest.mark.parametrize("scope", list(Scope))
def test_each_generation_meets_its_own_and_not_the_other(generations, starts, scope):
    old, new = generations(scope)
    meet(starts, old, old)
    meet(starts, new, new)
    judge(starts, (old, new), good=False)


@pytest.mark.parametrize(
    ("start", "to"), [("classical", "transition"), ("transition", "classical")]
)
def test_a_profile_is_left_for_another_that_runs_in_the_stack(generations, starts, start, to):
    old, new = generations(Scope.BOTH, start, to)
    meet(starts, new, new)
    judge(starts, (old, new), good=False)


@pytest.mark.parametrize("order", ["old first", "new first"])
@pytest.mark.parametrize("stack", ["fastdds"], indirect=True)
def test_fast_dds_trusts_two_identity_cas_in_one_file(generations, starts, enclave, order):
    pair = generations(Scope.IDENTITY)
    both = pair if order == "old first" else pair[::-1]
    robots = rounds(*pair, lambda folder: with_both(enclave, folder, both, "identity_ca.cert.pem"))
    for neighbours in pairwise(robots):
        judge(starts, neighbours, good=True)
    judge(starts, (robots[0], robots[2]), good=False)
    judge(starts, (robots[1], robots[3]), good=False)


@pytest.mark.parametrize("stack", ["cyclone"], indirect=True)
def test_cyclone_dds_trusts_two_identity_cas_in_a_folder(generations, starts, enclave):
    pair = generations(Scope.IDENTITY)
    robots = rounds(*pair, lambda folder: with_folder(enclave, folder, pair))
    for neighbours in pairwise(robots):
        judge(starts, neighbours, good=True)
    judge(starts, (robots[0], robots[2]), good=False)
    judge(starts, (robots[1], robots[3]), good=False)


@pytest.mark.parametrize("name", ["identity_ca.cert.pem", "permissions_ca.cert.pem"])
@pytest.mark.parametrize("stack", ["cyclone"], indirect=True)
def test_cyclone_dds_reads_the_first_ca_of_a_file(generations, starts, enclave, name):
    old, new = generations(Scope(name.partition("_")[0]))
    first, second = (with_both(enclave, each, (old, new), name) for each in (old, new))
    judge(starts, (old, first), good=True)
    judge(starts, (first, second), good=False)


@pytest.mark.parametrize("stack", ["fastdds"], indirect=True)
def test_a_folder_of_cas_is_not_for_fast_dds(generations, starts, enclave):
    pair = generations(Scope.IDENTITY)
    judge(starts, [with_folder(enclave, each, pair) for each in pair], good=False)


@pytest.mark.parametrize(("order", "gap"), [("old first", (2, 3)), ("new first", (0, 1))])
@pytest.mark.parametrize("stack", ["fastdds"], indirect=True)
def test_fast_dds_has_a_gap_between_two_permissions_cas(generations, starts, enclave, order, gap):
    pair = generations(Scope.PERMISSIONS)
    both = pair if order == "old first" else pair[::-1]
    name = "permissions_ca.cert.pem"
    robots = rounds(*pair, lambda folder: with_both(enclave, folder, both, name))
    for number, neighbours in enumerate(pairwise(robots)):
        judge(starts, neighbours, good=(number, number + 1) != gap)


@pytest.fixture(scope="module")
def listed(tmp_path_factory, now):
    """alice before and after a rollover of the identity CA, with a list of each."""
    folder = tmp_path_factory.mktemp("listed")
    lab = Lab.create(folder / "k", LAB_PROFILES["classical"], now)
    renew_list(lab.keystore, lab.authorities, now=now)
    shutil.copytree(lab.alice, folder / "old")
    terms = Rollover(profile=lab.keystore.profile, scope=Scope.IDENTITY)
    rotate(lab.keystore, terms, kept=lab.authorities, passphrase=None, now=now)
    shutil.copytree(lab.alice, folder / "new")
    return folder / "old", folder / "new"


@pytest.fixture
def starts_with_list(fastdds):
    """starts(folder) of Fast DDS, with the list in the folder if there is one."""

    def options(crl):
        return {"identity_crl": f"file://{crl}"} if crl.exists() else {}

    with ExitStack() as opened:
        yield lambda folder: opened.enter_context(
            fastdds_participant(fastdds, folder, **options(folder / "crl.pem"))
        )


def test_fast_dds_trusts_two_identity_cas_with_their_lists_in_their_file(
    starts_with_list, listed, enclave
):
    files = [each / name for name in ("identity_ca.cert.pem", "crl.pem") for each in listed]

    def trusting(folder):
        content = b"".join(file.read_bytes() for file in files)
        made = enclave(folder, {"identity_ca.cert.pem": content})
        (made / "crl.pem").unlink()
        return made

    for neighbours in pairwise(rounds(*listed, trusting)):
        judge(starts_with_list, neighbours, good=True)


def test_fast_dds_with_one_list_of_two_refuses_what_the_other_ca_issued(
    starts_with_list, listed, enclave
):
    name = "identity_ca.cert.pem"
    robots = rounds(*listed, lambda folder: with_both(enclave, folder, listed, name))
    judge(starts_with_list, robots[:2], good=True)
    judge(starts_with_list, robots[1:3], good=False)


@pytest.mark.parametrize("stack", ["cyclone"], indirect=True)
def test_cyclone_dds_takes_no_revocation_list_beside_that_folder(starts, enclave, tmp_path, now):
    lab = Lab.create(tmp_path / "k", LAB_PROFILES["classical"], now)
    renew_list(lab.keystore, lab.authorities, now=now)
    meet(starts, lab.alice, lab.bob)
    with pytest.raises(RefusedError):
        starts(with_folder(enclave, lab.alice, [lab.alice]))
