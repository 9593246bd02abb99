"""examples/operations: systemd takes the units, their commands do what they are for, and the
alerts ask for metrics that there are."""

import re
import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import yaml

from tests.cli.conftest import secret
from tests.longer import LONG

PROMTOOL, SYSTEMD = shutil.which("promtool"), shutil.which("systemd-analyze")
FOLDER = Path(__file__).parents[2] / "examples/operations"
SERVICES = sorted(path.stem for path in FOLDER.glob("*.service"))
PROGRAM = "/usr/bin/pqsec"
COLLECTOR = "/var/lib/prometheus/node-exporter"
DAY = timedelta(days=1)
SAMPLE = re.compile(r"(pqsec_\w+)\{(.*)\} (\d+)")


def settings(name):
    """(key, value) of each setting of a unit, in order."""
    lines = (FOLDER / name).read_text().splitlines()
    return [tuple(line.split("=", 1)) for line in lines if re.match(r"\w+=", line)]


def values(name, key):
    return [value for found, value in settings(name) if found == key]


class Machine:
    """The units' folders below another one, with a keystore, its passphrase, and a collector."""

    def __init__(self, root, run_in):
        self.root, self._run = root, run_in
        self.places = {
            "/var/lib/pqsec": root / "lib",
            "%d": root / "credentials",
            COLLECTOR: root / "collector",
        }
        for place in self.places.values():
            place.mkdir()
        self.passphrase = root / "credentials/ca-passphrase"
        secret(self.passphrase, "correct horse battery staple\n")
        self.keystore = root / "lib/robots"

    def pqsec(self, line):
        places = {"PQSEC_KEYSTORE": self.keystore, "PQSEC_PASSPHRASE_FILE": self.passphrase}
        return self._run(self.root, line, **{key: str(each) for key, each in places.items()}).done()

    def start(self, service):
        """Run the commands of the service, with its variables and nothing else."""
        variables = dict(each.split("=", 1) for each in values(service, "Environment"))
        variables = {key: self.placed(value) for key, value in variables.items()}
        for line in values(service, "ExecStart"):
            assert line.startswith(f"{PROGRAM} ")
            command = self.placed(line.removeprefix(f"{PROGRAM} "))
            self._run(self.root, command, **variables).done()

    def placed(self, text):
        for given, place in self.places.items():
            text = text.replace(given, str(place))
        return text

    def status(self):
        return self.pqsec("status --json").json

    @property
    def metrics(self):
        [file] = (self.root / "collector").iterdir()
        return file.read_text()


@pytest.fixture(scope="module")
def machine(tmp_path_factory, run_in):
    """A machine after a night: the timers' services ran once, in the order of their hours."""
    found = Machine(tmp_path_factory.mktemp("machine"), run_in)
    found.pqsec("ca init --profile transition --name Robots")
    found.pqsec("issue /short --publish rt/a --validity 20d")
    found.pqsec("issue /long --subscribe rt/a")
    found.before = found.status()
    for service in ("pqsec-renew", "pqsec-crl", "pqsec-metrics"):
        found.start(f"{service}.service")
    return found


def serials(status):
    return {each["name"]: each["serial"] for each in status["participants"]}


@pytest.mark.interop
@pytest.mark.skipif(not (LONG or SYSTEMD), reason="in .ci/long: it installs Debian's systemd")
def test_the_units_are_as_systemd_wants_them(tmp_path, requires):
    tool = requires(SYSTEMD, "systemd-analyze", "apt-get install systemd")
    assert sorted(path.stem for path in FOLDER.glob("*.timer")) == SERVICES
    for path in (*FOLDER.glob("*.service"), *FOLDER.glob("*.timer")):
        text = path.read_text().replace(PROGRAM, sys.executable)
        (tmp_path / path.name).write_text(text)
    units = sorted(map(str, tmp_path.iterdir()))
    assert len(units) == 2 * len(SERVICES)
    done = subprocess.run(
        [tool, "verify", "--man=no", *units],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_the_nightly_service_renews_what_is_due_and_nothing_else(machine):
    before, after = serials(machine.before), serials(machine.status())
    assert after["/short"] != before["/short"]
    assert after["/long"] == before["/long"]


def test_the_weekly_service_issues_a_list_that_the_nightly_one_leaves(machine):
    [crl] = [each for each in machine.status()["shared"] if each["kind"] == "crl"]
    left = datetime.fromisoformat(crl["not_after"]) - datetime.now(UTC)
    due = re.search(r"--due (\d+)d", " ".join(values("pqsec-renew.service", "ExecStart")))
    assert left > int(due[1]) * DAY + 14 * DAY
    lists = machine.pqsec("log").out.count(" crl (")
    machine.start("pqsec-renew.service")
    assert machine.pqsec("log").out.count(" crl (") == lists


def test_the_services_reach_no_folder_that_they_do_not_name(machine):
    """What a sandbox refuses is not found by running the commands without it."""
    for service in SERVICES:
        text = " ".join(value for _, value in settings(f"{service}.service"))
        writable = values(f"{service}.service", "ReadWritePaths")
        named = set(re.findall(r"(?<!\w)/[\w./-]+", text)) - {PROGRAM, "/etc/pqsec/ca-passphrase"}
        places = (*writable, *values(f"{service}.service", "ReadOnlyPaths"))
        assert all(any(Path(each).is_relative_to(place) for place in places) for each in named)
    assert values("pqsec-metrics.service", "ReadWritePaths") == [COLLECTOR]


def test_the_alerts_ask_for_metrics_and_labels_that_there_are(machine):
    labels = {}
    for line in machine.metrics.splitlines():
        if found := SAMPLE.fullmatch(line):
            labels.setdefault(found[1], set()).update(re.findall(r'(\w+)="', found[2]))
    rules = yaml.safe_load((FOLDER / "pqsec-alerts.yaml").read_text())["groups"][0]["rules"]
    used = set()
    for rule in rules:
        names = re.findall(r"(pqsec_\w+)(?:\{([^}]*)\})?", rule["expr"])
        assert names, rule
        for name, selector in names:
            used.add(name)
            assert set(re.findall(r"(\w+)=~?\"", selector)) <= labels[name], rule
        said = " ".join(rule["annotations"].values())
        assert set(re.findall(r"\$labels\.(\w+)", said)) <= set().union(
            *(labels[name] for name, _ in names)
        )
        assert set(rule["annotations"]) == {"summary", "description"}
    assert used == labels.keys()
    kinds = re.findall(r'kind="([^"]+)"', machine.metrics)
    assert {"participant", "crl", "identity-ca", "permissions-ca", "countersigner"} <= set(kinds)


@pytest.mark.interop
@pytest.mark.skipif(not (LONG or PROMTOOL), reason="in .ci/long: it installs Debian's prometheus")
def test_prometheus_takes_the_rules_and_the_metrics(machine, requires):
    tool = requires(PROMTOOL, "promtool", "apt-get install prometheus")
    subprocess.run([tool, "check", "rules", FOLDER / "pqsec-alerts.yaml"], check=True, timeout=60)
    subprocess.run(
        [tool, "check", "metrics"], input=machine.metrics, text=True, check=True, timeout=60
    )
