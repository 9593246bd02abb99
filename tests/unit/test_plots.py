"""The plots of measured suites and meshes: what is in them, from given numbers."""

import re
from xml.etree import ElementTree as ET

import pytest

from pqsec_pki.benchmark import MESH_COLUMNS, meshes_drawn, suites_drawn

SVG = "{http://www.w3.org/2000/svg}"


def texts(svg):
    """The words in it; ElementTree refuses what is not XML."""
    return {"".join(each.itertext()).strip() for each in ET.fromstring(svg).iter(f"{SVG}text")}  # noqa: S314 -- our own


def suite(name, median, version=1):
    wall = {"p50": median, "p95": 2 * median}
    return {
        "profile": name,
        "signature": "ml-dsa-65",
        "key_agreement": "mlkem768",
        "wire_version": version,
        "wall_ms": dict.fromkeys(("handshake", "initiator", "responder"), wall),
        "token_bytes": (15_000, 19_000, 5_000),
    }


def row(measure, value, *, hosts=2, loss=0.0, host=None, profile="pq", version=1):  # noqa: PLR0913
    own = ("cyclonedds", "0.10.2", "pqsec" if profile else "none", profile, hosts, loss, 0.0, 1500)
    return dict(zip(MESH_COLUMNS, (*own, 1, host, measure, value, version), strict=True))


def runs(hosts, loss, *times):
    """A run with these times of each host and another; the rest have not met."""
    yield row("complete", hosts if len(times) == hosts * (hosts - 1) else 0, hosts=hosts, loss=loss)
    full = max(times) if len(times) == hosts * (hosts - 1) else None
    numbers = {"full_s": full, "datagrams": 100 * hosts, "hosts_cpu_s": 0.1, "agent_cpu_s": 0.2}
    for name, number in numbers.items():
        yield row(name, number, hosts=hosts, loss=loss)
    for time in times:
        yield row("met_s", time, hosts=hosts, loss=loss, host=0)


def test_suites_are_bars_with_their_names():
    [(name, svg)] = suites_drawn([suite("pq", 5.0), suite(None, 2.0)]).items()
    assert name == "suites.svg"
    assert {"pq: ml-dsa-65, mlkem768", "ml-dsa-65, mlkem768", "request", "initiator"} <= texts(svg)
    assert suites_drawn([]) == {}


def test_meetings_have_a_line_for_each_loss_and_a_panel_for_each_kind():
    rows = [*runs(2, 0.0, 0.5, 0.6), *runs(2, 0.05, 1.5, 3.0), row("complete", 2, profile=None)]
    said = texts(meshes_drawn(rows)["meetings.svg"])
    assert {"0% loss", "5% loss", "cyclonedds pq 2 hosts MTU 1500"} <= said
    assert "cyclonedds unsecured 2 hosts MTU 1500" in said


def test_the_second_version_of_messages_has_bars_and_panels_of_its_own():
    svg = suites_drawn([suite("pq", 5.0), suite("pq", 4.0, version=2)])["suites.svg"]
    name = "pq: ml-dsa-65, mlkem768"
    assert {name, f"{name}, version 2"} <= texts(svg)
    rows = [row("complete", 2, version=each) for each in (1, 2)]
    said = texts(meshes_drawn(rows)["meetings.svg"])
    assert {f"cyclonedds pq {more}2 hosts MTU 1500" for more in ("", "version 2 ")} <= said


def test_who_has_not_met_counts_as_apart():
    """Half of the pairs: the line ends in the middle of the panel."""
    heights = []
    for times in ((1.0, 2.0), (1.0,)):
        svg = meshes_drawn(list(runs(2, 0.0, *times)))["meetings.svg"].decode()
        line = max(re.findall(r'<path d="([^"]+)" clip-path[^>]+stroke: #0072b2', svg), key=len)
        heights.append([float(y) for y in re.findall(r"[ML] [\d.]+ ([\d.]+)", line)])
    whole, half = (max(each) - min(each) for each in heights)
    assert half == pytest.approx(whole / 2)


def test_costs_are_drawn_against_the_number_of_hosts():
    rows = [*runs(2, 0.0, 0.5, 0.6), *runs(3, 0.0, *[1.0] * 6)]
    said = texts(meshes_drawn(rows)["hosts.svg"])
    assert {"hosts", "seconds to full mesh", "datagrams", "cyclonedds pq 0% loss MTU 1500"} <= said


def test_values_may_be_text_as_csv_has_them():
    rows = [*runs(2, 0.0, 0.5, 0.6), *runs(3, 0.0, *[1.0] * 6), *runs(3, 0.1)]
    text = [{name: "" if v is None else str(v) for name, v in each.items()} for each in rows]
    environment = dict.fromkeys(MESH_COLUMNS, "") | {
        "measure": "environment.load",
        "value": "(1, 2)",
    }
    assert meshes_drawn([environment, *text]) == meshes_drawn(rows)


def test_the_same_values_give_the_same_bytes():
    first, second = (meshes_drawn(list(runs(2, 0.0, 0.5, 0.6))) for _ in range(2))
    assert first == second


def test_what_was_not_measured_is_not_drawn():
    assert meshes_drawn([]) == {}
    assert list(meshes_drawn(list(runs(2, 0.0, 0.5, 0.6)))) == ["meetings.svg"]
