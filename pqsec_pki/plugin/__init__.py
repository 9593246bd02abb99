"""The security plugin that Cyclone DDS loads: its agent, and the shim that asks it.

A DDS process loads the shim (`shim/`, C). It passes each call that needs a decision to the
agent over a socket. There is one agent for each user. Its workers hold the identities and
answer with the code of this package; private keys never enter the DDS process.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.plugin.agent_folder import AgentFolder
    from pqsec_pki.plugin.building import LIBRARY, NAMES, Built, build
    from pqsec_pki.plugin.control import AgentStatus, agent_status, retired_agents, stop_agent
    from pqsec_pki.plugin.settings import SETTINGS
    from pqsec_pki.plugin.units import home, units_folder, written_units
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "LIBRARY",
    "NAMES",
    "SETTINGS",
    "AgentFolder",
    "AgentStatus",
    "Built",
    "agent_status",
    "build",
    "home",
    "retired_agents",
    "stop_agent",
    "units_folder",
    "written_units",
]
