"""Runs participants of a real stack with credentials of a keystore, each a process.

For `pqsec try`, two of them show whether a stack accepts what pqsec writes. In a network with only
a loopback, one sends a sample to the other, and a third one, without credentials, listens. For
`pqsec bench`, many meet on an Ethernet of network namespaces (`hosts.py`, `segment.py`).
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.trial.agent_runs import AgentError, AgentUse, TrialPlugin, plugin
    from pqsec_pki.trial.building import BuildError, built, cache_path
    from pqsec_pki.trial.hosts import HostOutcome, HostsRun, HostsSetup, run_hosts
    from pqsec_pki.trial.installation import MACHINE, Installation, MissingStackError, find
    from pqsec_pki.trial.peer import Act, PeerOutcome, TrialRole
    from pqsec_pki.trial.peer_builds import STACKS
    from pqsec_pki.trial.running import TrialRun, TrialSetup, run_peers, unique_text
    from pqsec_pki.trial.segment import HOSTS, Link, SegmentError, refuse_without_hosts
    from pqsec_pki.trial.topics import TopicRoute, topic_route
    from pqsec_pki.trial.trial import (
        UNAUTHENTICATED,
        Trial,
        TrialReport,
        credentialed,
        in_memory,
        refuse_untrusted,
        run_trial,
        unauthenticated,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "HOSTS",
    "MACHINE",
    "STACKS",
    "UNAUTHENTICATED",
    "Act",
    "AgentError",
    "AgentUse",
    "BuildError",
    "HostOutcome",
    "HostsRun",
    "HostsSetup",
    "Installation",
    "Link",
    "MissingStackError",
    "PeerOutcome",
    "SegmentError",
    "TopicRoute",
    "Trial",
    "TrialPlugin",
    "TrialReport",
    "TrialRole",
    "TrialRun",
    "TrialSetup",
    "built",
    "cache_path",
    "credentialed",
    "find",
    "in_memory",
    "plugin",
    "refuse_untrusted",
    "refuse_without_hosts",
    "run_hosts",
    "run_peers",
    "run_trial",
    "topic_route",
    "unauthenticated",
    "unique_text",
]
