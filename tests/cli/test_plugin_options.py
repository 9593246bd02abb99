"""--plugin of `pqsec export` and `pqsec try`: what they say, and what makes no sense."""

import json
import os

import pytest

from pqsec_pki.plugin import LIBRARY, NAMES


@pytest.fixture
def plugin(tmp_path):
    """A folder `plug` with a plugin that nothing here loads."""
    folder = tmp_path / "plug"
    folder.mkdir()
    (folder / LIBRARY).touch()
    for name in NAMES:
        (folder / name).symlink_to(LIBRARY)
    return folder


def test_a_post_quantum_participant_is_exported_with_the_plugin(pqsec, keystore, plugin):
    keystore("pq")
    refused = pqsec("-k k export cyclonedds /talker")
    refused.refused(1, "for pqsec peers only", hint="--plugin", problems=3)
    done = pqsec("-k k export cyclonedds /talker --plugin --plugins plug").done()
    assert done.out.count(f'path="{plugin / LIBRARY}"') == 2
    assert "PQSEC_AGENT=private" in done.err


def test_the_plugin_is_looked_for_where_it_is_installed(pqsec, keystore, tmp_path, plugin):
    keystore("pq")
    line = "-k k export cyclonedds /talker --plugin"
    refused = pqsec(line, HOME=str(tmp_path))
    refused.refused(3, "the plugin is not installed", hint="pqsec plugin install")
    (tmp_path / ".local/lib").mkdir(parents=True)
    plugin.rename(tmp_path / ".local/lib/pqsec")
    assert str(tmp_path / ".local/lib/pqsec") in pqsec(line, HOME=str(tmp_path)).done().out


def test_without_a_home_the_plugin_must_be_named_and_nothing_else(pqsec, keystore, monkeypatch):
    keystore("transition")
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 3_000_000_000)  # a user that the system does not know
    line = "-k k export cyclonedds /talker"
    pqsec(f"{line} --plugin").refused(3, "no home folder", hint="HOME")
    pqsec(line).done()


@pytest.mark.usefixtures("plugin")
def test_the_environment_of_ros_2_loads_it(pqsec, keystore):
    keystore("pq")
    pqsec("-k k issue /camera --ros-node /camera").done()
    value = pqsec("-k k export ros2 /camera --plugin --plugins plug --json -o out").done().json
    assert value["environment"]["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp"
    assert any("LD_LIBRARY_PATH" in each for each in value["commands"])
    assert json.dumps(value["notes"]).count("rmw_cyclonedds_cpp") == 1


@pytest.mark.usefixtures("plugin")
def test_the_value_of_rmw_implementation_names_the_middleware(pqsec, keystore):
    keystore("pq")
    pqsec("-k k issue /camera --ros-node /camera").done()
    line = "-k k export ros2 /camera --plugin --plugins plug --rmw"
    assert pqsec(f"{line} rmw_cyclonedds_cpp").out == pqsec(f"{line} cyclonedds").done().out
    assert pqsec(f"{line} rmw_fastrtps_cpp").err == pqsec(f"{line} fastrtps").err
    pqsec(f"{line} rmw_connextdds_cpp").refused(2, "connextdds")


@pytest.mark.usefixtures("plugin")
def test_a_stack_that_cannot_load_it_says_so(pqsec, keystore):
    keystore("pq")
    line = "-k k export connext /talker --plugin --plugins plug"
    known = "cyclonedds, fastdds, opendds, ros2"
    pqsec(line).refused(2, "cannot load pqsec's plugin", hint=known)
