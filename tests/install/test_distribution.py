"""The wheel and the source distribution: complete, and the same bytes whenever they are built."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHARED = {
    "docs/man": "share/man/man1",
    "packaging/completions/_pqsec": "share/zsh/site-functions/_pqsec",
    "packaging/completions/pqsec": "share/bash-completion/completions/pqsec",
    "packaging/completions/pqsec.fish": "share/fish/vendor_completions.d/pqsec.fish",
}
IN_PACKAGE = ["pqsec_pki", "templates", "schemas"]
ABOUT = ["pyproject.toml", "README.md", "LICENSE"]
BUILT = [*IN_PACKAGE, "docs/man", "packaging/completions", *ABOUT]


def build(source, folder, *what, umask=0o022):
    """Build in a copy, at another path and with other times."""
    copy = folder / "checkout"
    ignored = shutil.ignore_patterns("__pycache__", ".*", "build")
    if not copy.exists():
        for name in BUILT:
            path = source / name
            copy.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                shutil.copytree(path, copy / name, ignore=ignored, copy_function=shutil.copyfile)
            else:
                shutil.copyfile(path, copy / name)
    command = [sys.executable, "-m", "hatchling", "build", "-d", folder, *what]
    subprocess.run(command, cwd=copy, umask=umask, check=True, capture_output=True)
    return sorted(path for path in folder.iterdir() if path.is_file())


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source distribution and the wheel."""
    folder = tmp_path_factory.mktemp("first")
    wheel, source = build(ROOT, folder)
    return source, wheel


@pytest.mark.slow
def test_two_builds_have_the_same_bytes(built, tmp_path):
    again = build(ROOT, tmp_path / "another/place", umask=0o077)
    assert [path.name for path in again] == sorted(path.name for path in built)
    for path in built:
        assert path.read_bytes() == (tmp_path / "another/place" / path.name).read_bytes()


def test_the_wheel_of_the_source_distribution_is_that_of_the_checkout(built, tmp_path):
    source, wheel = built
    # Debian 12's Python, 3.11.2, has no filters of tarfile.
    subprocess.run(["tar", "-xf", source, "-C", tmp_path], check=True)
    [unpacked] = tmp_path.iterdir()
    [again] = build(unpacked, tmp_path / "again", "-t", "wheel")
    assert again.read_bytes() == wheel.read_bytes()


def test_the_wheel_has_all_that_pqsec_needs_and_nothing_else(built, requires):
    cloned = shutil.which("git") and (ROOT / ".git").exists()
    requires(cloned or None, "a clone with git", "apt-get install git, and clone the repository")
    names = zipfile.ZipFile(built[1]).namelist()
    version = built[1].name.split("-")[1]
    listed = ("git", "ls-files", "-z", "--cached", *BUILT[: -len(ABOUT)])
    done = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True)
    wanted = set()
    for path in filter(None, done.stdout.split("\0")):
        if path.startswith(tuple(SHARED)):
            begin = max((each for each in SHARED if path.startswith(each)), key=len)
            wanted.add(f"pqsec-{version}.data/data/{SHARED[begin]}{path.removeprefix(begin)}")
        else:
            wanted.add(path if path.startswith("pqsec_pki/") else f"pqsec_pki/{path}")
    about = {each for each in names if ".dist-info/" in each}
    assert {each for each in names if each not in about} == wanted
    assert {each.split("/", 1)[1] for each in about} == {
        *("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")
    }
    assert "pqsec_pki/py.typed" in names


def test_the_metadata_name_licence_python_and_extras(built):
    archive = zipfile.ZipFile(built[1])
    [name] = [each for each in archive.namelist() if each.endswith("METADATA")]
    metadata = archive.read(name).decode()
    for line in ("License-Expression: Apache-2.0", "Requires-Python: >=3.11", "Typing :: Typed"):
        assert line in metadata
    assert {"cbom", "hsm", "plot"} <= {
        line.split()[1] for line in metadata.splitlines() if line.startswith("Provides-Extra: ")
    }


@pytest.mark.slow
def test_wheels_on_a_stick_install_without_a_network(built, tmp_path):
    """As docs/how-to/install.md says: `pip wheel` there, `pip install --no-index` here."""
    pip = [sys.executable, "-m", "pip"]
    wheels = tmp_path / "wheels"
    subprocess.run([*pip, "wheel", "-q", "-w", wheels, built[1]], check=True)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    nowhere = {name: each for name, each in os.environ.items() if not name.startswith("PIP_")}
    nowhere |= {"PIP_CONFIG_FILE": os.devnull, "https_proxy": "http://127.0.0.1:9"}
    install = [tmp_path / "venv/bin/pip", "install", "-q", "--no-index", "--find-links", wheels]
    subprocess.run([*install, "pqsec"], check=True, env=nowhere)
    done = subprocess.run(
        [tmp_path / "venv/bin/pqsec", "demo", "robots"],
        cwd=tmp_path, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert "ok    authenticated" in done.stdout
    share = tmp_path / "venv/share"
    assert (share / "man/man1/pqsec.1").is_file()
    lines = (
        f". {share}/bash-completion/completions/pqsec; COMP_WORDS=(pqsec verify); COMP_CWORD=1;"
        '_pqsec_completion pqsec; echo "${COMPREPLY[@]}"'
    )
    path = {"PATH": f"{tmp_path}/venv/bin:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", lines], env=os.environ | path, check=True, capture_output=True, text=True
    )
    assert done.stdout == "verify verify-handshake\n"


@pytest.mark.slow
@pytest.mark.parametrize("tool", ["pipx", "uv"])
def test_each_tool_installs_it_apart_and_removes_it(requires, built, tmp_path, tool):
    """As docs/how-to/install.md says; and `pqsec uninstall --list` knows which tool it was."""
    found = Path(sys.executable).with_name(tool)
    program = requires(found if found.exists() else None, tool, f"pip install {tool}")
    words = {"pipx": [program], "uv": [program, "tool"]}[tool]
    bin_ = tmp_path / "bin"
    environment = os.environ | {"HOME": str(tmp_path), "PIPX_HOME": str(tmp_path / "pipx")}
    environment |= {"PIPX_BIN_DIR": str(bin_), "UV_TOOL_BIN_DIR": str(bin_)}
    environment |= {"UV_TOOL_DIR": str(tmp_path / "uv"), "UV_CACHE_DIR": str(tmp_path / "cache")}
    environment |= {"UV_PYTHON_DOWNLOADS": "never", "UV_PYTHON": sys.executable}

    def run(*line):
        done = subprocess.run(
            line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout

    run(*words, "install", built[1])
    assert "ok    authenticated" in run(bin_ / "pqsec", "demo", "robots")
    listed = run(bin_ / "pqsec", "uninstall", "--list")
    assert f"{' '.join([tool, *words[1:]])} uninstall pqsec" in listed
    run(*words, "uninstall", "pqsec")
    assert not (bin_ / "pqsec").exists()
