"""Which plots there are of what was measured; `plots.py` draws them, with an extra library."""

from collections.abc import Mapping, Sequence
from typing import Any

from pqsec_pki._libraries import needs_libraries

SUITES, MEETINGS, HOSTS = "suites.svg", "meetings.svg", "hosts.svg"
MESH_PLOTS = (MEETINGS, HOSTS)


def refuse_without_library() -> None:
    """PqsecError if plots cannot be drawn; before anything is measured."""
    with needs_libraries("the library for plots is not installed"):
        import pqsec_pki.benchmark.plots  # noqa: F401, PLC0415 -- an extra of the package


def suites_drawn(suites: Sequence[Mapping[str, Any]]) -> dict[str, bytes]:
    """The plot of the `suites` of bench's JSON, by its name; none without suites."""
    from pqsec_pki.benchmark import plots  # noqa: PLC0415 -- an extra of the package

    return {SUITES: plots.suites_svg(suites)} if suites else {}


def meshes_drawn(rows: Sequence[Mapping[str, Any]]) -> dict[str, bytes]:
    """The plots of rows with the keys MESH_COLUMNS, by their names; values may be text.

    HOSTS only if there are several numbers of hosts, and nothing without runs.
    """
    from pqsec_pki.benchmark import plots  # noqa: PLC0415 -- an extra of the package

    numbers = {str(row["hosts"]) for row in rows if row.get("hosts")}
    drawn = {MEETINGS: plots.meetings_svg(rows)} if numbers else {}
    return drawn | ({HOSTS: plots.hosts_svg(rows)} if len(numbers) > 1 else {})
