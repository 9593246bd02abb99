"""Runs two participants of a real stack with credentials of a keystore, for `pqsec try`.

It shows whether a stack accepts what pqsec writes. Each participant is a process. In a network
with only a loopback, one sends a sample to the other, and a third one, without credentials,
listens.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.trial.agent_runs import AgentError, TrialPlugin, plugin
    from pqsec_pki.trial.building import BuildError, built
    from pqsec_pki.trial.installation import MACHINE, Installation, MissingStackError, find
    from pqsec_pki.trial.peer import Act, PeerOutcome, TrialRole
    from pqsec_pki.trial.peer_builds import STACKS
    from pqsec_pki.trial.running import TrialRun, TrialSetup, run_peers, unique_text
    from pqsec_pki.trial.topics import TopicRoute, topic_route
    from pqsec_pki.trial.trial import (
        UNAUTHENTICATED,
        Trial,
        TrialReport,
        credentialed,
        refuse_untrusted,
        run_trial,
        unauthenticated,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MACHINE",
    "STACKS",
    "UNAUTHENTICATED",
    "Act",
    "AgentError",
    "BuildError",
    "Installation",
    "MissingStackError",
    "PeerOutcome",
    "TopicRoute",
    "Trial",
    "TrialPlugin",
    "TrialReport",
    "TrialRole",
    "TrialRun",
    "TrialSetup",
    "built",
    "credentialed",
    "find",
    "plugin",
    "refuse_untrusted",
    "run_peers",
    "run_trial",
    "topic_route",
    "unauthenticated",
    "unique_text",
]
