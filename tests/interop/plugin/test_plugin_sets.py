"""Cyclone DDS itself, with participants that have a classical and a hybrid set of credentials.

With pqsec's plugin they meet by the hybrid set. With Cyclone's own plugins one meets them by the
classical set, if `stock` in their `pqsec.toml` names it, and is refused if not.
"""

import shutil

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.plugin.settings import SettingsFile
from pqsec_pki.trial import MissingStackError, find
from tests.interop.conftest import DOMAINS, TOPIC, YEAR
from tests.interop.cyclone import RefusedError
from tests.interop.plugin.couple import couple
from tests.interop.plugin.processes import Stage, logs, met

pytestmark = pytest.mark.interop

ALICE, BOB = "/lab/alice", "/lab/bob"
CYCLONES = "cyclones cyclones"


@pytest.fixture(scope="module")
def model(tmp_path_factory, now):
    root = tmp_path_factory.mktemp("sets") / "k"
    profiles = map(profile_named, ("classical", "hybrid"))
    options = {"domains": DOMAINS, "validity": 10 * YEAR, "now": now, "passphrase": None}
    keystore = Keystore.create(root, *profiles, name="Lab", **options)
    may = {"publish": (TOPIC,), "subscribe": (TOPIC,), "domains": DOMAINS, "validity": YEAR}
    specs = [ParticipantSpec(name=name, **may) for name in (ALICE, BOB)]
    issue(keystore, keystore.unlock(None), specs, now=now)
    return root


@pytest.fixture
def folder_of(model, tmp_path):
    """folder_of(ALICE, "/x") is her folder with all sets, and those that her policy names;
    folder_of(ALICE) is her classical set, as a stock stack has it."""
    root = tmp_path / "k"
    shutil.copytree(model, root, symlinks=True)

    def folder(name, *stock, has_all=True):
        if not has_all:
            return root / f"enclaves{name}"
        found = root / f"sets/hybrid/enclaves{name}"
        sets = {"classical": f"../../../../../enclaves{name}", "hybrid": "."}
        (found / "pqsec.toml").write_text(SettingsFile(sets=sets, stock=stock).text)
        return found

    return folder


@pytest.fixture
def stage(shim, plugins, requires, tmp_path):
    try:
        installation = find("cyclonedds")
    except MissingStackError as error:
        installation = requires(None, "Cyclone DDS to compile against", error.hint or str(error))
    (tmp_path / "stage").mkdir()
    return Stage(installation, shim, plugins, tmp_path / "stage")


def test_two_with_the_plugin_meet_by_the_hybrid_set(stage, folder_of):
    """Neither names anybody, so the classical set would be refused."""
    went = stage.run_peers(stage.sender(folder_of(ALICE)), stage.receiver(folder_of(BOB)))
    assert met(went), logs(went)


@pytest.mark.parametrize("ours", [ALICE, BOB])
def test_a_stock_participant_is_met_by_the_classical_set_if_it_is_named(stage, folder_of, ours):
    theirs = BOB if ours == ALICE else ALICE
    went = stage.run_peers(
        stage.sender(folder_of(ours, theirs)),
        stage.receiver(folder_of(theirs, has_all=False), plugins=CYCLONES),
    )
    assert met(went), logs(went)


@pytest.mark.parametrize("ours", [ALICE, BOB])
def test_a_stock_participant_that_is_not_named_is_refused(stage, folder_of, ours):
    theirs = BOB if ours == ALICE else ALICE
    went = stage.run_strangers(
        stage.sender(folder_of(ours, "/lab/carol")),
        stage.receiver(folder_of(theirs, has_all=False), plugins=CYCLONES),
    )
    assert all(each.joined for each in went.outcomes), logs(went)
    assert went.outcomes[1].received is None


@pytest.mark.parametrize("ours", [ALICE, BOB])
def test_the_library_and_cyclones_own_plugin_agree_on_the_classical_set(
    shim, plugins, folder_of, ours
):
    """By calls, as Cyclone DDS makes them; its real IdentityToken is what chooses the row."""
    theirs = BOB if ours == ALICE else ALICE
    stock = plugins, folder_of(theirs, has_all=False)
    for entry in (theirs, "/lab/*"):
        with couple((shim.folder, folder_of(ours, entry)), stock) as both:
            both.agree(both.shake_hands())
    with (
        couple((shim.folder, folder_of(ours, "/other/*")), stock) as both,
        pytest.raises(RefusedError, match=r"stock does not name it|may be a stock stack"),
    ):
        both.shake_hands()


@pytest.mark.parametrize("ours", [ALICE, BOB])
def test_fast_dds_with_its_own_plugin_is_met_by_the_classical_set(shim, fastdds, folder_of, ours):
    """Its IdentityToken spells the name in its own way, and it asks for MODP."""
    theirs = BOB if ours == ALICE else ALICE
    stock = fastdds, folder_of(theirs, has_all=False)
    for entry in (theirs, "/lab/*"):
        with couple((shim.folder, folder_of(ours, entry)), stock) as both:
            both.agree(both.shake_hands())
    with (
        couple((shim.folder, folder_of(ours)), stock) as both,
        pytest.raises(RefusedError, match=r"stock does not name it|may be a stock stack"),
    ):
        both.shake_hands()
