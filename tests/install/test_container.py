"""The Containerfile: read in the gate; built and run, without an engine, by `.ci/long`."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.install.containerfile import Builder, Image, read, start
from tests.ports import free_port

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "packaging/container/Containerfile").read_text()
STAGES = read(TEXT)
TARGETS = ("agent", "server")
BARE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pqsec-ci/bare-trixie"
PATIENCE = 120
FOR_IT = ["--python-version", "3.13", "--only-binary", ":all:"]
FOR_IT += ["--platform", "manylinux_2_28_x86_64", "--platform", "manylinux_2_17_x86_64"]


def locked(name: str) -> dict[str, str]:
    text = (ROOT / "packaging" / name).read_text()
    return dict(re.findall(r"(?m)^([a-z0-9-]+)==([^ ;]+)", text))


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_runs_pqsec_as_a_user_of_its_own(target):
    steps = STAGES[target].steps
    assert [rest for word, rest in steps if word == "USER"] == ["pqsec"]
    [entrypoint] = [rest for word, rest in steps if word == "ENTRYPOINT"]
    assert entrypoint.startswith('["pqsec", ')
    assert steps.index(("USER", "pqsec")) < steps.index(("ENTRYPOINT", entrypoint))


def test_what_is_copied_is_in_the_checkout_and_enough_for_the_wheel():
    copied = {each for word, rest in STAGES["build"].steps if word == "COPY"
              for each in rest.split()[:-1]}  # fmt: skip
    assert all((ROOT / each).exists() for each in copied)
    built = {"pqsec_pki", "templates", "schemas", "docs/man", "pyproject.toml", "README.md",
             "packaging/completions"}  # fmt: skip
    assert built | {"LICENSE"} <= copied


def test_both_targets_have_the_same_versions():
    agent, server = locked("locked.txt"), locked("locked-serve.txt")
    assert agent.items() <= server.items()
    assert {"twisted", "pyopenssl"} <= server.keys()


@pytest.fixture(scope="module")
def builder(tmp_path_factory, requires):
    """Builds from a root file system of Debian 13, with wheels that were fetched before."""
    root = requires(((BARE / "usr/bin/python3").exists() and os.geteuid() == 0) or None,
                           "a bare Debian 13, and root", ".ci/bare trixie true")  # fmt: skip
    assert root
    folder = tmp_path_factory.mktemp("images")
    wheels = folder / "wheels"
    fetch = [sys.executable, "-m", "pip", "download", "-q", "-d", wheels]
    for each in (["-r", ROOT / "packaging/locked-serve.txt"], ["hatchling>=1.27"]):
        subprocess.run([*fetch, *FOR_IT, *each], check=True, timeout=600)

    def base(place: Path) -> Image:
        subprocess.run(["cp", "-a", BARE, place], check=True)
        for name in ("/etc/resolv.conf", "/etc/hosts"):
            shutil.copy(name, place / name.lstrip("/"))
        shutil.copytree(wheels, place / "wheels")
        image = Image(place)
        image.environment |= {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": "/wheels"}
        return image

    yield Builder(TEXT, ROOT, folder, base)
    shutil.rmtree(folder)


def run(image, *words, check=True):
    return subprocess.run(
        start(image, list(words)), capture_output=True, text=True, timeout=300, check=check
    )


def running(image):
    return subprocess.Popen(start(image, image.entrypoint + image.command))


def wait_for(answer):
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if answer():
            return True
        time.sleep(0.2)
    return False


def stop(process):
    process.send_signal(signal.SIGTERM)
    return process.wait(timeout=PATIENCE)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_agent_is_built_and_answers_whoever_shares_its_folder(builder):
    image = builder.build("agent")
    assert run(image, "id", "-un").stdout == "pqsec\n"
    assert "authenticated" in run(image, "pqsec", "demo", "/tmp/demo").stdout
    process = running(image)
    try:
        assert wait_for(lambda: not run(image, "pqsec", "agent", "status", check=False).returncode)
    finally:
        code = stop(process)
    assert code == 128 + signal.SIGTERM


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_server_is_built_and_listens(builder):
    image = builder.build("server")
    port = free_port()
    image.environment["PQSEC_KEYSTORE"] = "/var/lib/pqsec/robots"
    (image.root / "var/lib/pqsec/domain.yaml").write_text(
        "name: Robots\nvalidity: 90d\nroles:\n  robot: {publish: [rt/pose]}\n"
        "participants:\n  - {name: /r1, role: robot, request: requests/}\n"
    )
    run(image, "pqsec", "apply", "domain.yaml", "--yes", "--no-passphrase", check=False)
    url = f"https://127.0.0.1:{port}"
    run(image, "pqsec", "serve", "--config", "serve.yaml", "--init", url)
    process = running(image)

    def listens():
        with socket.socket() as client:
            return client.connect_ex(("127.0.0.1", port)) == 0

    try:
        assert wait_for(listens)
    finally:
        code = stop(process)
    assert code == 0
