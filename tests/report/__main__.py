"""Makes reports, and opens them in Chromium: python -m tests.report FOLDER [--robots 2000]

Screenshots and PDFs stay in the folder. Needs node, and playwright-core and axe-core in NODE_PATH.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, revoke
from pqsec_pki.migration import plan_migration
from pqsec_pki.report import Report, html_of, report_of
from pqsec_pki.selfcheck import STACKS
from tests.unit.test_report import hostile

YEAR = timedelta(days=365)
MOST_BYTES = 3_000_000
"""Of the page of 2,000 robots."""


def main() -> int:
    """Exit code 1 if a page has a problem."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, default=2_000)
    options = parser.parse_args()
    failed = False
    for name, page in pages(options.robots):
        folder = options.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "report.html"
        path.write_text(page)
        size = path.stat().st_size
        print(f"-- {name}: {size} bytes", flush=True)
        script = Path(__file__).with_name("page.cjs")
        failed |= subprocess.run(["node", script, path, folder], check=False).returncode != 0
        failed |= size > MOST_BYTES
    return 1 if failed else 0


def pages(robots: int) -> Iterator[tuple[str, str]]:
    """Of a warehouse, of hostile names, of a damaged keystore, and of many robots."""
    now = datetime.now(UTC)
    with tempfile.TemporaryDirectory() as place:
        warehouse = report_of_fleet(Path(place) / "warehouse", "transition", 24, now)
        yield "warehouse", html_of(warehouse)
        yield "hostile", html_of(hostile(warehouse))
        (Path(place) / "warehouse/enclaves/governance.p7s").write_text("damaged")
        yield "damaged", html_of(report_of(Keystore.open(Path(place) / "warehouse"), now=now))
        yield "robots", html_of(report_of_fleet(Path(place) / "many", "classical", robots, now))


def report_of_fleet(root: Path, profile: str, robots: int, now: datetime) -> Report:
    """The report of a fleet: each robot of three nodes if there are few, else of one."""
    keystore = Keystore.create(
        root,
        profile_named(profile),
        name="Warehouse",
        domains=DomainSet.parse("0-2"),
        validity=YEAR,
        passphrase=None,
        now=now,
    )
    authorities = keystore.unlock(None)
    issue(keystore, authorities, list(fleet(robots)), now=now)
    revoke(keystore, authorities, ["/tools/joystick"], now=now)
    stacks = tuple(each for each in STACKS if each.is_stock)
    return report_of(
        keystore,
        now=now,
        command="pqsec report --migrate-to pq",
        migration=lambda: plan_migration(keystore, profile_named("pq"), stacks, now=now),
    )


def fleet(robots: int) -> Iterator[ParticipantSpec]:
    """Robots with topics of their own, a manager, a dock with a service and action, and tools."""
    for number in range(1, robots + 1):
        name = f"/amr{number:04}"
        if robots > 100:
            commands = [f"rt{name}/cmd_vel", "rt/fleet/stop"]
            yield robot(name, [f"rt{name}/odom"], commands, number % 3)
            continue
        yield robot(f"{name}/base", [f"rt{name}/odom"], [f"rt{name}/cmd_vel", "rt/fleet/stop"])
        yield robot(f"{name}/nav", [f"rt{name}/cmd_vel"], [f"rt{name}/odom", f"rt{name}/scan"])
        yield robot(f"{name}/lidar", [f"rt{name}/scan"], [])
    request, reply = ros.service_topics("/dock")
    client, server = ros.action_client("/charge"), ros.action_server("/charge")
    asked = ["rt/fleet/stop", request, *client.publish]
    yield robot("/fleet/manager", asked, [reply, *client.subscribe])
    yield robot("/fleet/dock", [reply, *server.publish], [request, *server.subscribe])
    yield robot("/tools/recorder", [], ["rt/*"])
    yield robot("/tools/joystick", ["rt/*/cmd_vel"], [])


def robot(name: str, publish: list[str], subscribe: list[str], domain: int = 0) -> ParticipantSpec:
    """A participant with what every ROS 2 node needs."""
    needs = ros.node_minimum(name)
    return ParticipantSpec(
        name=name,
        domains=DomainSet.of(domain),
        publish=(*needs.publish, *publish),
        subscribe=(*needs.subscribe, *subscribe),
        validity=YEAR,
    )


if __name__ == "__main__":
    sys.exit(main())
