"""The environment of a launch file's nodes; interop/test_ros2_tools.py has launch itself."""

import importlib.util

import pytest

from pqsec_pki.errors import FileError, PqsecError
from pqsec_pki.ros import secured_variables

PRESENT = {"PATH": "/usr/bin:/bin", "LD_LIBRARY_PATH": "/opt/ros/lib", "OTHER": "a\nb"}
SCRIPT = """
export ROS_SECURITY_ENABLE=true
export ROS_SECURITY_STRATEGY=Enforce
export ROS_SECURITY_KEYSTORE='/opt/a = b'
unset ROS_SECURITY_ENCLAVE_OVERRIDE
export LD_LIBRARY_PATH=/opt/pqsec"${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
"""


@pytest.fixture
def script(tmp_path):
    """script(text) is the path of a script with it."""

    def write(text):
        (tmp_path / "ros2.sh").write_text(text)
        return str(tmp_path / "ros2.sh")

    return write


def test_what_the_script_changes_is_set_and_nothing_else(script):
    before = PRESENT | {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/another", "ROS_SECURITY_ENABLE": "false"}
    assert secured_variables("/talker", script(SCRIPT), present=before) == {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": "/opt/a = b",
        "ROS_SECURITY_ENCLAVE_OVERRIDE": "/talker",
        "LD_LIBRARY_PATH": "/opt/pqsec:/opt/ros/lib",
    }


@pytest.mark.parametrize(
    "text",
    [
        "",
        SCRIPT.replace("=true", "=True"),
        SCRIPT.replace("=Enforce", "=enforce"),
        SCRIPT.replace("export ROS_SECURITY_ENABLE", "ROS_SECURITY_ENABLE"),
    ],
    ids=["empty", "True", "enforce", "not exported"],
)
def test_a_script_that_does_not_secure_nodes_is_refused(script, text):
    with pytest.raises(PqsecError, match="does not secure the nodes of /talker"):
        secured_variables("/talker", script(text), present=PRESENT)


def test_a_script_that_fails_is_refused(script):
    with pytest.raises(PqsecError, match=r"ros2\.sh failed with exit code 1"):
        secured_variables("/talker", script(SCRIPT + "false\n"), present=PRESENT)


def test_a_script_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileError, match=r"no\.sh cannot be read"):
        secured_variables("/talker", str(tmp_path / "no.sh"), present=PRESENT)


def test_without_a_script_it_is_what_pqsec_exports(tmp_path, capfd):
    with pytest.raises(PqsecError, match=r"pqsec export .* failed with exit code 3"):
        secured_variables("/talker", options=f"-k '{tmp_path / 'no such'}'", present=PRESENT)
    assert "pqsec: error:" in capfd.readouterr().err


def test_the_export_runs_no_code_of_the_folder_where_it_starts(tmp_path, monkeypatch, capfd):
    (tmp_path / "click.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PqsecError, match=r"pqsec export .* failed with exit code 3"):
        secured_variables("/talker", options="-k 'no such'", present=PRESENT)
    assert "pqsec: error:" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("module", "needs"), [("launch", "ROS 2's launch"), ("command", "ROS 2's ros2cli")]
)
def test_a_python_without_ros_2_is_told_what_is_missing(module, needs):
    if importlib.util.find_spec("launch"):
        pytest.skip("launch is here")
    with pytest.raises(ModuleNotFoundError, match=needs):
        importlib.import_module(f"pqsec_pki.ros.{module}")
