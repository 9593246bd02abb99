"""Two participants of a real stack, with credentials of a keystore: do they meet?

For `pqsec try` and for whoever must know what a stack makes of what pqsec writes. Each
participant is a process; they meet on a loopback of their own, one sends a sample to the
other, and a third one without credentials listens.
"""

from pqsec_pki.trial.building import BuildError, built
from pqsec_pki.trial.installation import MACHINE, Installation, MissingStackError, find
from pqsec_pki.trial.kits import STACKS
from pqsec_pki.trial.meeting import (
    STRANGER,
    Report,
    Trial,
    credentialed,
    meet,
    refuse_untrusted,
    stranger,
)
from pqsec_pki.trial.peer import Account, Act, Role
from pqsec_pki.trial.plugin import AgentError, Plugin, plugin
from pqsec_pki.trial.scene import Performance, Scene, mark, perform
from pqsec_pki.trial.topics import Passage, passage

__all__ = [
    "MACHINE",
    "STACKS",
    "STRANGER",
    "Account",
    "Act",
    "AgentError",
    "BuildError",
    "Installation",
    "MissingStackError",
    "Passage",
    "Performance",
    "Plugin",
    "Report",
    "Role",
    "Scene",
    "Trial",
    "built",
    "credentialed",
    "find",
    "mark",
    "meet",
    "passage",
    "perform",
    "plugin",
    "refuse_untrusted",
    "stranger",
]
