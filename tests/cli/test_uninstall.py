"""pqsec uninstall --list: what is where, and nothing is removed."""

import shlex
import sys
from pathlib import Path

import pytest

import pqsec_pki
from pqsec_pki.installed import program
from pqsec_pki.plugin import AgentFolder
from tests.cli.conftest import snapshot


@pytest.fixture
def home(tmp_path):
    """A user's home with something of each kind in it."""
    home = tmp_path / "home"
    for name in (".local/lib/pqsec", ".config/systemd/user", ".cache/pqsec/peers", "run/pqsec"):
        (home / name).mkdir(parents=True)
    (home / ".local/lib/pqsec/libpqsec_dds.so").touch()
    (home / ".local/lib/pqsec/other").touch()
    (home / ".config/systemd/user/pqsec-agent.socket").write_text(
        "# Written by `pqsec plugin install --systemd`.\n"
    )
    (home / ".config/systemd/user/other.socket").touch()
    (home / ".config/fish/completions").mkdir(parents=True)
    (home / ".config/fish/completions/pqsec.fish").touch()
    (home / ".bashrc").write_text('true\neval "$(_PQSEC_COMPLETE=bash_source pqsec)"\n')
    (home / ".local/share/man/man1").mkdir(parents=True)
    (home / ".local/share/man/man1/pqsec-issue.1").touch()
    (home / "run").chmod(0o700)
    return {"HOME": str(home), "XDG_RUNTIME_DIR": str(home / "run"), "PATH": str(home / "bin")}


def places(result):
    return {(each["what"], each["path"]): each for each in result.done().json["places"]}


def test_what_is_in_a_home_is_listed_with_its_removal(pqsec, home):
    root = Path(home["HOME"])
    before = snapshot(root)
    found = places(pqsec("uninstall --list --json", **home))
    assert snapshot(root) == before
    expected = {
        ("program", Path(pqsec_pki.__file__).parent): "pip uninstall pqsec",
        ("manual pages", root / ".local/share/man/man1/pqsec*.1*"): "with the program",
        ("completion", root / ".config/fish/completions/pqsec.fish"): "rm ",
        ("completion", root / ".bashrc"): "delete that line",
        ("plugin, Cyclone DDS", root / ".local/lib/pqsec/libpqsec_dds.so"): "plugin uninstall",
        ("agent", root / "run/pqsec"): "pqsec agent stop",
        ("unit", root / ".config/systemd/user/pqsec-agent.socket"): "plugin uninstall",
        ("cache", root / ".cache/pqsec"): "rm -r",
    }
    for (what, path), removed_by in expected.items():
        assert removed_by in found[what, str(path)]["removed_by"]
    assert found["completion", str(root / ".bashrc")]["line"] == 2
    assert not [path for _, path in found if path.startswith(str(root)) and "other" in path]
    assert str(AgentFolder.of(home).folder) == str(root / "run/pqsec")


def test_a_command_that_removes_names_one_folder_whatever_it_is_called(pqsec, home):
    """With a blank in the path of a home, `rm -r` removed another folder."""
    root = Path(home["HOME"])
    home = {key: value.replace(str(root), f"{root} $(id)") for key, value in home.items()}
    root = root.rename(home["HOME"])
    found = places(pqsec("uninstall --list --json", **home))
    paths = {"cache": ".cache/pqsec", "agent": "run/pqsec"}
    paths["completion"] = ".config/fish/completions/pqsec.fish"
    for what, name in paths.items():
        words = shlex.split(found[what, str(root / name)]["removed_by"])
        assert words[-1] == str(root / name)


def test_keystores_and_credentials_are_found_where_they_are_named(pqsec, home, tmp_path):
    (tmp_path / "a/k").mkdir(parents=True)
    (tmp_path / "a/k/pqsec.json").touch()
    far = tmp_path / "x/y/far"
    far.mkdir(parents=True)
    (far / "pqsec.json").touch()
    (tmp_path / "credentials/requests/talker").mkdir(parents=True)
    (tmp_path / "credentials/requests/talker/key.pem").touch()
    found = places(pqsec("uninstall --list --json a", **home, PQSEC_KEYSTORE=str(far)))
    kept = {(what, path) for what, path in found if what in {"keystore", "credentials"}}
    assert kept == {
        ("keystore", str(tmp_path / "a/k")),
        ("keystore", str(far)),
        ("credentials", str(tmp_path / "credentials")),
    }
    assert pqsec("-k a/k uninstall --list a", **home).done().out.count(f" {tmp_path}/a/k ") == 1
    lines = pqsec("uninstall --list a", **home).done().out
    assert f"{tmp_path}/a/k" in lines
    assert "far" not in lines
    pqsec("uninstall --list nowhere", **home).refused(3, "nowhere")


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("pipx_metadata.json", "pipx uninstall pqsec"),
        ("uv-receipt.toml", "uv tool uninstall pqsec"),
        ("other", f"{sys.executable} -m pip uninstall pqsec"),
    ],
)
def test_the_removal_is_that_of_who_installed(pqsec, home, monkeypatch, name, command):
    prefix, bin_ = Path(home["HOME"], "prefix"), Path(home["PATH"])
    (prefix / "share/man/man1").mkdir(parents=True)
    (prefix / "share/man/man1/pqsec.1").touch()
    (prefix / name).touch()
    bin_.mkdir()
    (bin_ / "pqsec").touch(0o755)
    monkeypatch.setattr(program.sys, "prefix", str(prefix))
    found = places(pqsec("uninstall --list --json", **home))
    [removed_by] = [each["removed_by"] for (what, _), each in found.items() if what == "program"]
    assert removed_by == command
    assert ("manual pages", str(prefix / "share/man/man1/pqsec*.1*")) in found
    assert ("command", str(bin_ / "pqsec")) in found


def test_a_keystore_with_a_name_that_is_too_long_is_refused(pqsec, home):
    """It ended with a traceback."""
    pqsec(f"-k {'x' * 300} uninstall --list", **home).refused(3, "file name too long")


def test_nothing_is_removed_without_list_either(pqsec, home):
    before = snapshot(Path(home["HOME"]))
    pqsec("uninstall", **home).refused(2, "does not remove itself", hint="--list")
    assert snapshot(Path(home["HOME"])) == before


def test_packages_that_extend_pqsec_are_listed(pqsec, home, tmp_path, monkeypatch):
    for name, group in (("lab", "pqsec.lint_rules"), ("other", "console_scripts")):
        about = tmp_path / f"site/{name}-1.0.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[{group}]\n{name} = lab_module\n")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    found = places(pqsec("uninstall --list --json", **home))
    [lab] = [each for (_, path), each in found.items() if path == str(tmp_path / "site")]
    assert (lab["what"], lab["removed_by"]) == (
        "extension, lab",
        f"{sys.executable} -m pip uninstall lab",
    )
