"""Peers that are not all of one program: in C, and in Python where its package was built."""

import os
import shlex
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pqsec_pki.trial import (
    Installation,
    MissingStackError,
    TrialRole,
    TrialRun,
    TrialSetup,
    find,
    run_peers,
)
from tests.interop.conftest import TOPIC
from tests.interop.plugin.processes import DOMAIN, PATIENCE

PEER = Path(__file__).with_name("python_peer.py")
_AS_TOLD = ("sh", "-c", 'exec $PROGRAM "$@"', "peer")


def cyclonedds() -> Installation | None:
    """The Cyclone DDS of this machine, if peers can be compiled against it."""
    with suppress(MissingStackError):
        return find("cyclonedds")
    return None


def python_peer() -> list[str] | None:
    """What runs python_peer.py: what .ci/cyclonedds-python made, or another that
    PQSEC_CYCLONEDDS_PYTHON names."""
    cached = Path.home() / ".cache" / "pqsec-ci" / "cyclonedds-python"
    python = Path(os.environ.get("PQSEC_CYCLONEDDS_PYTHON") or cached) / "bin" / "python"
    return [str(python), str(PEER)] if python.exists() else None


def perform_each(*casts: tuple[TrialRole, list[str]], seconds: float = PATIENCE) -> TrialRun:
    """How it went, each role played by a program of its own."""
    roles = [
        replace(role, environment={**role.environment, "PROGRAM": shlex.join(program)})
        for role, program in casts
    ]
    return run_peers(
        TrialSetup(program=_AS_TOLD, domain=DOMAIN, topic=TOPIC, timeout=seconds), roles
    )
