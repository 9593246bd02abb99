"""Every command's help has examples that work, and the exit codes that it has."""

import base64
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from pqsec_pki.cli import pqsec as root
from pqsec_pki.cli._help import Command
from tests.cli.conftest import clean_environment, command_of, secret
from tests.unit.approving import make_key
from tests.unit.sros2_keystore import SROS2

KEYSTORE = {"PQSEC_KEYSTORE": "robots"}


def commands(group: click.Group = root, path: str = "") -> Iterator[tuple[str, click.Command]]:
    """Every command that is not a group, by its path such as `ca init`."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{path}{name} ")
        else:
            yield f"{path}{name}", command


ALL = dict(commands())

RECORDED = Path(__file__).parents[1] / "vectors/learning"
POLICY = """
domains: 0
validity: 1y
grants:
  - name: {name}
    publish: [rt/chatter]
"""
FILES = {
    "baseline.json": '{"findings": []}',
    "names.txt": "/talker\n/listener  # both on one robot\n",
    "talker.yaml": POLICY.format(name="/talker"),
    "permissions.yaml": POLICY.format(name="/fleet/robot9"),
    "bad.yaml": "grants: 5\n",
    "decided.yaml": (
        "name: Robots\napprovals: {required: 2, of: {alice: alice.pub.pem, bob: bob.pub.pem}}\n"
    ),
    "bad.xml": "<dds><permissions/></dds>",
    "robot.policy.xml": (
        '<policy version="0.2.0"><enclaves><enclave path="/a"><profiles><profile ns="/" node="a">'
        '<topics publish="ALLOW"><topic>chatter</topic></topics></profile></profiles></enclave>'
        "</enclaves></policy>"
    ),
    "node.log": "Subject name is invalid(code: 146)\n",
    "quiet.log": "nothing of interest\n",
    "learned.yaml": "grants: [{name: /talker, publish: [rt/chatter, rt/pose]}]",
    "domain.log": (RECORDED / "kitchen.log").read_text(),
    "monitor.json": (RECORDED / "monitor.json").read_text(),
    "monday.txt": (RECORDED / "nodes.txt").read_text(),
    "tuesday.txt": (RECORDED / "nodes.txt").read_text(),
}


@pytest.fixture(scope="session")
def made(run_in, tmp_path_factory) -> Path:
    """A folder with all files that examples name: a keystore `robots`, and what goes with it."""
    folder = tmp_path_factory.mktemp("examples")

    def run(line: str, *, robot: bool = False) -> None:
        run_in(folder / "robot" if robot else folder, line, **({} if robot else KEYSTORE)).done()

    (folder / "robot").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    for name in ("alice", "bob", "carol", "line1"):
        make_key(folder, name)
    for name in ("passphrase", "new-passphrase"):
        secret(folder / name, f"the {name} of the robots\n")
    run("ca init --name Robots --passphrase-file passphrase")
    run("ca passphrase --passphrase-file passphrase --no-passphrase")
    run("issue /talker --ros-node /talker --ros-publish /chatter")
    run("issue /listener --ros-node /listener --ros-subscribe /chatter")
    shutil.copytree(folder / "robots", folder / "robots.old", symlinks=True)
    run("bundle-key --dir .", robot=True)
    shutil.copy(folder / "robot/bundle.pub.pem", folder)
    for number in (1, 2, 3):
        run(f"request /fleet/robot{number} --dir {number}", robot=True)
        made = folder / f"robot/{number}/requests/fleet+robot{number}/request.csr"
        shutil.copy(made, folder / f"robot{number}.csr")
    run("issue --csr robot1.csr /fleet/robot1 --publish rt/chatter --bundles .")
    (folder / "fleet+robot1.bundle").rename(folder / "robot1.bundle")
    shutil.copytree(folder / "robot/1", folder / "credentials")
    run("sign-request export robot2.csr --publish rt/chatter -o asked")
    run("governance new -o governance.yaml")
    run("sign-governance governance.yaml -o governance.p7s")
    shutil.copy(folder / "robots/enclaves/talker/permissions.p7s", folder)
    shutil.copy(folder / "robots/enclaves/talker/cert.pem", folder)
    forged = (folder / "permissions.p7s").read_bytes().replace(b"rt/chatter", b"rt/secrets")
    (folder / "forged.p7s").write_bytes(forged)
    run("plan --init domain.yaml")
    run("serve --config serve.yaml --init https://127.0.0.1:8443")
    run("-k decided apply decided.yaml --yes --no-passphrase")
    run("-k decided plan domain.yaml -o plan.json --key alice.pem")
    SROS2(folder / "sros2-keystore").enclave("/talker")
    return folder


@pytest.fixture
def folder(made, tmp_path) -> Path:
    """The test's own copy."""
    return shutil.copytree(made, tmp_path / "work", symlinks=True)


# Examples


def parsed(line: str) -> click.Context:
    """The context of the command that the line runs; click's error for a wrong line."""
    name, *words = shlex.split(line.partition(" <")[0])
    assert name == "pqsec"
    context = root.make_context("pqsec", words)
    while isinstance(context.command, click.Group):
        rest = [*context._protected_args, *context.args]
        name, command, rest = context.command.resolve_command(context, rest)
        assert command
        context = command.make_context(name, rest, parent=context)
    return context


def test_every_command_has_examples_that_parse_and_exit_codes():
    faults = []
    for path, command in ALL.items():
        if not isinstance(command, Command) or not command.examples:
            faults.append(f"{path}: no examples")
            continue
        if not {0, 2, 3} <= command.exit_codes.keys():
            faults.append(f"{path}: exit codes {list(command.exit_codes)}")
        for purpose, line in command.examples.items():
            if len(line) > 150 or purpose[0].islower() or purpose.endswith((".", ":")):
                faults.append(f"{path}: {purpose}: {line}")
            try:
                context = parsed(line)
            except click.UsageError as error:
                faults.append(f"{line}: {error}")
            else:
                if context.command is not command or context.command_path != f"pqsec {path}":
                    faults.append(f"{line} runs {context.command_path}")
    assert faults == []
    assert len(ALL) > 50


def test_an_example_that_does_not_parse_is_seen():
    for line in (
        "pqsec issue --pubish x",
        "pqsec diff one",
        "pqsec isue /a",
        "pqsec check --jobs 1",
    ):
        with pytest.raises(click.UsageError):
            parsed(line)


def test_help_ends_with_the_examples_and_the_exit_codes(pqsec):
    faults = []
    for path, command in ALL.items():
        told = pqsec(f"{path} --help").done().out
        usage, _, rest = told.partition("\nOptions:\n")
        options, _, rest = rest.partition("\nExamples:\n")
        examples, _, codes = rest.partition("\nExit codes:\n")
        if not (usage.startswith("Usage: ") and options and examples and codes):
            faults.append(path)
        lines = [line[4:] for line in examples.splitlines() if line.startswith("    pqsec ")]
        if lines != list(command.examples.values()):
            faults.append(f"{path}: {lines}")
        numbers = [line.split()[0] for line in codes.splitlines() if line[2] != " "]
        if numbers != list(map(str, command.exit_codes)):
            faults.append(f"{path}: {codes}")
    assert faults == []


def test_a_group_lists_its_commands_with_their_whole_first_sentences(pqsec):
    told = " ".join(pqsec("ca --help").done().out.split())
    assert (
        "rotate Replace the CAs and reissue everything they signed, or change the profile." in told
    )
    assert "..." not in told.partition("Commands:")[2]


ELSEWHERE = {
    "agent log": "needs an agent: tests/cli/test_plugin.py",
    "agent run": "does not end: tests/cli/test_plugin.py",
    "agent status": "needs an agent: tests/cli/test_plugin.py",
    "enrol": "needs a server: tests/cli/test_network.py",
    "enrolment-token revoke": "needs the id of a token: tests/unit/test_serve.py",
    "ledger move": "needs a server: tests/interop/test_postgres.py",
    "plugin install": "needs a compiler: tests/cli/test_plugin.py",
    "plugin status": "is of the user's home: tests/cli/test_plugin.py",
    "plugin uninstall": "is of the user's home: tests/cli/test_plugin.py",
    "pqsec renew --from https://enrol.example:8443 --dir /etc/dds": "likewise",
    "requests approve": "needs a request that waits: tests/unit/test_serve.py",
    "requests refuse": "likewise",
    "serve": "does not end: tests/unit/test_serve.py",
    "try": "needs a stack: tests/interop/test_try.py",
    "verify-handshake": "minutes, with the matrix: tests/cli/test_handshake_modes.py",
}
"""Commands of which no example runs here, and single examples, and why."""
INSTALL = "install robot1.bundle --trust-first"
EXPORT = "sign-request export robot2.csr -o fleet.request --subscribe x"
ADD = "ra add line1 --key line1.pub.pem --allow-name '/fleet/*' --role robot --max-count 9"
RA = (f"{ADD} --validity 30d --force",)
ORDER = "pqsec sign-request export robot2.csr --grant line1.grant --key line1.pem -o order"
DECIDED = ("apply decided.yaml --yes",)
FIRST = {
    "rollback": (
        *(INSTALL, "renew /fleet/robot1", "bundle /fleet/robot1 -o new.bundle"),
        "install new.bundle",
    ),
    "receipt import": (INSTALL,),
    "report": ("report --format json -o may.json",),
    "verify": ("report --sign -o june.html",),
    "sign-request import": (EXPORT, "sign-request sign fleet.request -o fleet.answer"),
    "sign-request sign": (EXPORT,),
    ORDER: RA,
    "pqsec sign-request sign order -o answer --ra-only": (*RA, ORDER.removeprefix("pqsec ")),
    "ra list": RA,
    "ra revoke": RA,
    "ca crl": ("ca crl",),
    "log": ("log --anchor anchors",),
    "pqsec plan domain.yaml -o plan.json --key alice.pem": DECIDED,
    "propose": DECIDED,
    "pqsec apply plan.json --yes": (
        *DECIDED,
        "plan domain.yaml -o plan.json --key alice.pem",
        "approve plan.json --key bob.pem --yes",
    ),
}
"""What is done before each example of a command, or before that example."""
MAY_BE_NO = {"needs-renewal", "diff", "apply", "plan", "permissions learn"}
"""The answer to their examples may be no."""


def run_example(run_in, folder: Path, line: str) -> tuple[int, str]:
    """The exit code and stderr."""
    if "<" in line:
        shell = line.replace("pqsec", f"{sys.executable} -m pqsec_pki", 1)
        done = subprocess.run(
            ["bash", "-c", shell], cwd=folder, check=False, capture_output=True, text=True
        )
        return done.returncode, done.stderr
    for role in ("identity", "permissions", "countersigner"):
        line = line.replace(f"{role}:SHA256", pin(run_in, folder, role))
    done = run_in(folder, line.removeprefix("pqsec "), **KEYSTORE)
    return done.code, done.err


def pin(run_in, folder: Path, role: str) -> str:
    pins = run_in(folder, "ca show --pins --json", **KEYSTORE).json["pins"]
    return next(each for each in pins if each.startswith(role))


@pytest.mark.slow(but=18)
@pytest.mark.parametrize("path", [path for path in ALL if path not in ELSEWHERE])
def test_the_examples_of_a_command_work(run_in, made, tmp_path, path):
    faults = []
    examples = [line for line in ALL[path].examples.values() if line not in ELSEWHERE]
    for number, line in enumerate(examples):
        folder = shutil.copytree(made, tmp_path / str(number), symlinks=True)
        if line in FIRST or path == "propose":
            (folder / "plan.json").unlink()
        if path == "permissions learn":  # it writes what an example of `permit` reads
            (folder / "learned.yaml").unlink()
        for before in FIRST.get(line, FIRST.get(path, ())):
            run_in(folder, before, **KEYSTORE).done()
        code, err = run_example(run_in, folder, line)
        if "Cyclone DDS is not installed" in err:
            pytest.skip("Cyclone DDS is not on this machine: apt-get install cyclonedds-dev g++")
        if code > (path in MAY_BE_NO) or "error:" in err:
            faults.append(f"{line}: {code}, {err}")
    assert faults == []


# Exit codes

NO = {
    "agent status": "",
    "apply": "domain.yaml --check",
    "approve": "plan.json --key carol.pem --yes",
    "bundle": "/forged --no-keys",
    "ca rotate": "--plan -k robots.old",
    "check": "bad.xml",
    "diff": "robots/enclaves/talker/permissions.xml permissions.yaml",
    "domain import": "bad.yaml",
    "enrolment-token create": "/a --config bad.yaml -o a.token",
    "enrolment-token list": "--config bad.yaml",
    "enrolment-token revoke": "0 --config bad.yaml",
    "explain": "--participant /talker --publish rt/secret",
    "explain-error": "all is well",
    "export": "fastdds /talker --stack-version 3.1.2",
    "governance read": "bad.xml",
    "governance render": "bad.yaml",
    "inspect": "bad.xml",
    "install": f"robot1.bundle --dir new --ca-fingerprint identity:{64 * '0'}",
    "issue": "--csr robot2.csr /another",
    "log": f"--head {'0' * 64}",
    "needs-renewal": "",
    "permissions import": "bad.xml",
    "permissions learn": "domain.log",
    "permissions read": "bad.xml",
    "permissions render": "bad.yaml",
    "plan": "domain.yaml",
    "plugin status": "--dir nowhere",
    "ra add": f"{ADD.removeprefix('ra add ')} --validity 1d --file bad.yaml",
    "receipt import": "credentials/installed.receipt",
    "propose": "-o new.json --key line1.pem -k decided issue /x --publish y",
    "renew": "/fleet/robot1 --keep-key",
    "report": "-o signed.html --signer robots/enclaves/talker/cert.pem"
    " robots/enclaves/talker/key.pem",
    "requests approve": "012345678 --config bad.yaml",
    "requests list": "--config bad.yaml",
    "requests refuse": "012345678 --config bad.yaml",
    "rollback": "",
    "serve": "--config bad.yaml",
    "sign-governance": "bad.xml",
    "sign-permissions": "bad.xml",
    "sign-request export": "forged.csr -o out",
    "sign-request import": "answer --request other",
    "sign-request sign": "asked --show --allow-name /x",
    "try": "ros2 --dry-run /forged",
    "validate": "bad.xml",
    "verify": "forged.p7s",
    "verify-handshake": "/talker /listener --domain 5",
    "who-may": "",
}
"""Command -> arguments for which the answer is no."""
NEVER_NO = {
    "ca remove-set": "needs a terminal where the answer is no",
    "demo": "the handshake of a new domain succeeds",
    "enrol": "needs a server that refuses: tests/cli/test_network.py",
    "migrate plan": "needs permissions that fill a message: tests/cli/test_migrate.py",
    "permit": "a file that was altered is not in the ledger",
}


@pytest.fixture(scope="session")
def damaged(made, run_in, tmp_path_factory) -> Path:
    """The folder with forged documents and a compromised key, and with all that `NO` names."""
    folder = shutil.copytree(made, tmp_path_factory.mktemp("damaged") / "work", symlinks=True)

    def run(line: str) -> None:
        run_in(folder, line, **KEYSTORE).done()

    run("install robot1.bundle --trust-first")
    lines = run_in(folder, "log --json", **KEYSTORE).json["lines"]
    serial = next(each["serial"] for each in lines if each["name"] == "/fleet/robot1")
    time.sleep(1.1)  # the next certificate is to be newer, in seconds
    run("renew /fleet/robot1")
    run("bundle /fleet/robot1 -o new.bundle")
    run("install new.bundle")
    run(f"revoke {serial} --yes --reason keyCompromise")  # it is the key of the new one, too
    run("issue /forged --publish rt/chatter")
    run("sign-request sign asked -o answer")
    run("sign-request export robot3.csr --publish rt/chatter -o other")
    for path in (
        "robots/enclaves/forged/permissions.p7s",
        "robots/enclaves/governance.p7s",
        "robots.old/enclaves/governance.p7s",
    ):
        data = (folder / path).read_bytes()
        (folder / path).write_bytes(data.replace(b"</dds>", b" </dds>"))
    first, *lines, last = (folder / "robot3.csr").read_text().splitlines()
    der = bytearray(base64.b64decode("".join(lines)))
    der[-1] ^= 1
    text = base64.encodebytes(der).decode()
    (folder / "forged.csr").write_text(f"{first}\n{text}{last}\n")
    return folder


def test_what_is_documented_as_no_ends_with_1(run_in, damaged):
    documented = {path for path, command in ALL.items() if 1 in command.exit_codes}
    assert documented == NO.keys() | NEVER_NO.keys()
    found = {path: run_in(damaged, f"{path} {line}", **KEYSTORE) for path, line in NO.items()}
    assert [f"{path}: {each}" for path, each in found.items() if each.code != 1] == []


FAILS = {
    "agent log": "",
    "bundle-key": "--dir credentials",
    "estimate": "--participants 5 --costs nowhere.json",
    "demo": "robots",
    "governance new": "-o names.txt",
    "schema": "domain -o names.txt",
    "permissions new": "/a -o names.txt",
    "install": "nowhere.bundle",
    "plan": "nowhere.yaml",
    "plugin install": "--dir lib",
    "request": "/fleet/robot1",
    "serve": "--config nowhere.yaml",
    "try": "cyclonedds /talker /listener --root robot",
}
"""Command -> arguments with which it cannot be done, where its example would."""
UNPRINTABLE = {
    *("algorithms", "explain-error", "governance presets", "profiles", "agent stop"),
    *("ledger schema", "plugin status", "plugin uninstall", "uninstall --list"),
}
"""Commands that fail only if the result cannot be printed, or standard input be read."""
FAILS_ELSEWHERE = {
    "agent run": "needs another agent: tests/cli/test_plugin.py",
    "agent status": "needs a broken agent: tests/unit/test_plugin_agent.py",
    "bench": "only if the result cannot be printed: tests/cli/test_bench.py",
}


def test_what_cannot_be_done_ends_with_3(run_in, made, tmp_path):
    folder = shutil.copytree(made, tmp_path / "work", symlinks=True)
    run_in(folder, "bundle-key", **KEYSTORE).done()
    empty = tmp_path / "empty"
    empty.mkdir()
    environment = KEYSTORE | {"PATH": "", "XDG_RUNTIME_DIR": str(empty), "HOME": str(empty)}
    faults = []
    for path in ALL.keys() - FAILS_ELSEWHERE.keys() - {*UNPRINTABLE, "uninstall"}:
        line = next(iter(ALL[path].examples.values())).removeprefix("pqsec ")
        where, line = (folder, f"{path} {FAILS[path]}") if path in FAILS else (empty, line)
        done = run_in(where, line, **environment)
        faults += [f"{path}: {done}"] * (done.code != 3)
    for path in UNPRINTABLE:
        with Path("/dev/full").open("wb") as full:
            done = subprocess.run(
                [sys.executable, "-m", "pqsec_pki", *path.split(), *["146"] * path.count("error")],
                env=clean_environment(**environment),
                stdout=full,
                check=False,
            )
        faults += [f"{path}: {done}"] * (done.returncode != 3)
    assert faults == []


def test_every_command_ends_with_2_for_a_wrong_command_line(pqsec):
    found = {path: pqsec(f"{path} --no-such-option").code for path in ALL}
    assert found == dict.fromkeys(ALL, 2)


def test_only_documented_exit_codes_pass(run_in, monkeypatch, tmp_path):
    """Every command line of these tests is compared with the help: tests/cli/conftest.py."""
    assert command_of(["-k", "check", "ca", "show", "--pins"]) is ALL["ca show"]
    run_in(tmp_path, "profiles")
    others = {code: text for code, text in ALL["profiles"].exit_codes.items() if code}
    monkeypatch.setattr(ALL["profiles"], "exit_codes", others)  # as it was afterwards, in its order
    with pytest.raises(AssertionError, match="not in --help"):
        run_in(tmp_path, "profiles")
