"""Writes the configuration of DDS stacks with a participant's credentials.

For `pqsec export`, and for code that starts a stack with them. A module for each stack makes an
`Export` from a template; `export` first checks whether the stack would accept the credentials.
"""

from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.export import Export, Options, write
from pqsec_pki.vendors.stacks import STACKS, Stack, export, stack_named

__all__ = [
    "STACKS",
    "Export",
    "Options",
    "Stack",
    "StackEnclave",
    "export",
    "stack_named",
    "write",
]
