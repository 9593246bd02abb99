"""What pqsec has on this machine, where it is, and how it is removed. Nothing here removes it.

program     the program, its commands, manual pages and completion
data        what it made: plugin, agent, units, caches, credentials, keystores
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.installed.data import kept_in, made_here
    from pqsec_pki.installed.program import Place, programs
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["Place", "kept_in", "made_here", "programs"]
