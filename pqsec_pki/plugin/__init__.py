"""The security plugin that Cyclone DDS loads: its agent, and the shim that asks it.

The shim (`shim/`, C) is what a DDS process loads. It hands each call that needs thought
to the agent, one process for each user, over a socket. The agent holds the identities
and answers with the rooms of this package; private keys never enter the DDS process.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.plugin.agent_folder import AgentFolder
    from pqsec_pki.plugin.building import LIBRARY, NAMES, Built, build
    from pqsec_pki.plugin.control import AgentStatus, agent_status, stop_agent
    from pqsec_pki.plugin.units import home, units_folder, written_units
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "LIBRARY",
    "NAMES",
    "AgentFolder",
    "AgentStatus",
    "Built",
    "agent_status",
    "build",
    "home",
    "stop_agent",
    "units_folder",
    "written_units",
]
