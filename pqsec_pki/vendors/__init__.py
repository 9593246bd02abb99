"""What DDS stacks are configured with: a participant's credentials in the words of each.

For `pqsec export` and for who starts a stack with them. One module for each stack makes an
`Export`, of a template; `export` asks first whether the stack would take the credentials.
"""

from pqsec_pki.vendors.enclave import Enclave
from pqsec_pki.vendors.export import Export, Options, write
from pqsec_pki.vendors.stacks import STACKS, Stack, export, stack_named

__all__ = [
    "STACKS",
    "Enclave",
    "Export",
    "Options",
    "Stack",
    "export",
    "stack_named",
    "write",
]
