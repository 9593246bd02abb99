"""Measure the authentication handshake in memory, and meshes of hosts that run a real stack.

    suites         which keys and key agreements are measured together
    participants   a CA and two participants in memory
    measuring      rounds of a handshake, each operation timed
    results        samples, percentiles and sizes of one suite
    meshes         hosts of a real stack on a network of their own: credentials, runs
    mesh_results   times, counts and losses of such runs
    drawing        which plots there are of both; `plots` draws them
    environment    what the numbers depend on: versions, processor, load

What is measured in memory is what the Authentication plugin does; room `trial` runs the stacks.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.benchmark.drawing import (
        MESH_PLOTS,
        SUITES,
        meshes_drawn,
        refuse_without_library,
        suites_drawn,
    )
    from pqsec_pki.benchmark.environment import Environment
    from pqsec_pki.benchmark.measuring import measured_rounds
    from pqsec_pki.benchmark.mesh_results import (
        MESH_COLUMNS,
        MeasuredMeshes,
        MeshCase,
        MeshRun,
        Plugins,
    )
    from pqsec_pki.benchmark.meshes import MeshPlan, measured_meshes
    from pqsec_pki.benchmark.participants import MeasuredParticipants
    from pqsec_pki.benchmark.results import (
        CSV_COLUMNS,
        HandshakeSizes,
        MeasuredSuite,
        Operation,
        Timing,
        percentile,
    )
    from pqsec_pki.benchmark.suites import HandshakeSuite, every_suite, suites_of
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CSV_COLUMNS",
    "MESH_COLUMNS",
    "MESH_PLOTS",
    "SUITES",
    "Environment",
    "HandshakeSizes",
    "HandshakeSuite",
    "MeasuredMeshes",
    "MeasuredParticipants",
    "MeasuredSuite",
    "MeshCase",
    "MeshPlan",
    "MeshRun",
    "Operation",
    "Plugins",
    "Timing",
    "every_suite",
    "measured_meshes",
    "measured_rounds",
    "meshes_drawn",
    "percentile",
    "refuse_without_library",
    "suites_drawn",
    "suites_of",
]
