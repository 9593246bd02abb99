"""Writes the configuration of DDS stacks with a participant's credentials.

For `pqsec export`, and for code that starts a stack with them. A module for each stack makes an
`Export` from a template; `export` first checks whether the stack would accept the credentials.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.vendors.enclave import StackEnclave
    from pqsec_pki.vendors.exports import Export, Options, write
    from pqsec_pki.vendors.stacks import EXPORTERS, Exporter, export, exporter_of
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "EXPORTERS",
    "Export",
    "Exporter",
    "Options",
    "StackEnclave",
    "export",
    "exporter_of",
    "write",
]
