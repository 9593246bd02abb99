"""May this participant do that? Governance and permissions in, a decision out.

For the self-check, the plugin and the command line. Questions follow DDS-Security 1.1,
9.4.3; where the stacks answer otherwise, the function says so.
"""

from pqsec_pki.access.decision import Decision
from pqsec_pki.access.join import may_join

__all__ = ["Decision", "may_join"]
