"""Real meshes under loss, beside what `pqsec estimate` says of them.

Processes of Cyclone DDS on the loopback start together, with pqsec's plugin and profile pq, and
Cyclone DDS drops a share of what it sends (Internal/Test/XmitLossiness; datagrams of 1300 bytes).
Each run is a line of CSV on stdout: the median of the hosts' times until each had met all others,
the time of the last, and seconds of the processor. Governance has rtps_protection_kind NONE, with
which Cyclone DDS 0.10.2 repeats what was lost of a handshake.

Run: python bench/mesh.py [HOSTS...] [--loss PERCENT...] [--runs N] [--seconds N] >> mesh.csv
"""

import argparse
import os
import statistics
import sys
import tempfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has what runs Cyclone DDS

from bench.agent import Meeting, compiled, enclaves
from pqsec_pki.documents import DomainSet, Governance, ProtectionKind
from pqsec_pki.keystore import Keystore
from pqsec_pki.plugin import AgentFolder, build, stop_agent
from tests.interop.cyclone import find_plugins
from tests.interop.plugin.conftest import Shim
from tests.interop.plugin.processes import Stage

COLUMNS = "profile,hosts,loss_percent,run,complete,median_s,last_s,hosts_cpu_s,agent_cpu_s,load"


def unprotected_messages(root: Path) -> None:
    """The governance of that keystore, without protection of whole RTPS messages."""
    store, now = Keystore.open(root), datetime.now(UTC)
    governance = Governance.protected(DomainSet.parse("0-10"))
    rule = replace(governance.domain_rules[0], rtps_protection_kind=ProtectionKind.NONE)
    signed = store.unlock(None).sign(replace(governance, domain_rules=(rule,)).to_xml(), now=now)
    (root / "enclaves" / "governance.p7s").write_bytes(signed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("hosts", nargs="*", type=int, default=[2, 5, 10])
    parser.add_argument("--loss", nargs="+", type=float, default=[0, 1, 5, 10])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=int, default=40, help="for all hosts to meet")
    words = parser.parse_args()
    plugins = find_plugins()
    if plugins is None:
        raise SystemExit("apt-get install libddsc0debian cyclonedds-dev cyclonedds-tools")
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        folder = Path(name)
        for each in ("c", "xml"):
            (folder / each).mkdir()
        place = AgentFolder.of(os.environ)
        shim = Shim(build(folder / "plugin").library.parent, place)
        stage = Stage(None, shim, plugins, folder / "xml", most=max(words.hosts) + 10)
        program = compiled(folder / "c")
        places = enclaves(folder / "pq", "pq", max(words.hosts))
        unprotected_messages(folder / "pq")
        Meeting(program, [stage.environment(places[0])], 10).hold(place)  # starts the agent
        print(COLUMNS)
        agent = 0.0
        for run in range(words.runs):
            for count in words.hosts:
                for loss in words.loss:
                    meant = [stage.environment(each, loss=loss / 100) for each in places[:count]]
                    load = os.getloadavg()[0]
                    crowd = Meeting(program, meant, words.seconds).hold(place)
                    full = crowd.times("full")
                    middle = statistics.median(full) if full else -1
                    values = (
                        f"{middle:.2f},{max(full, default=-1):.2f},{crowd.processor:.2f},"
                        f"{crowd.agent - agent:.2f},{load:.1f}"
                    )
                    print(f"pq,{count},{loss:g},{run},{len(full)},{values}", flush=True)
                    agent = crowd.agent
        stop_agent(place)


if __name__ == "__main__":
    main()
