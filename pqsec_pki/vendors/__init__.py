"""Writes the configuration of DDS stacks with a participant's credentials.

For `pqsec export`, and for code that starts a stack with them. A module for each stack makes an
`Export` from a template; `export` first checks whether the stack would accept the credentials.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.vendors._ros2_environment import ENCLAVE_OVERRIDE, SECURED
    from pqsec_pki.vendors.cyclone_plugins import agree, find_cyclone_plugins, in_words
    from pqsec_pki.vendors.elf import Library, read_library, runs_here
    from pqsec_pki.vendors.enclave import StackEnclave, standard_properties
    from pqsec_pki.vendors.exporters import EXPORTERS, Exporter, exporter_of
    from pqsec_pki.vendors.exports import FOLDER, Export, Options, write
    from pqsec_pki.vendors.fastdds_library import FastDds, examine, find_fastdds
    from pqsec_pki.vendors.foreign import foreign_stacks
    from pqsec_pki.vendors.messages import MessageKind, Recognised, fit_for_a_command, recognise
    from pqsec_pki.vendors.opendds_adapter import OpenDdsPlugin, install_opendds
    from pqsec_pki.vendors.opendds_library import OpenDds, find_opendds
    from pqsec_pki.vendors.own_plugin import FASTRTPS
    from pqsec_pki.vendors.plugin_files import (
        InstalledPlugin,
        files_of_plugins,
        installed_plugins,
        remove_plugins,
    )
    from pqsec_pki.vendors.rollover import TRUST
    from pqsec_pki.vendors.ros2 import preflight
    from pqsec_pki.vendors.ros2_check import Check
    from pqsec_pki.vendors.stacks import export
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "ENCLAVE_OVERRIDE",
    "EXPORTERS",
    "FASTRTPS",
    "FOLDER",
    "SECURED",
    "TRUST",
    "Check",
    "Export",
    "Exporter",
    "FastDds",
    "InstalledPlugin",
    "Library",
    "MessageKind",
    "OpenDds",
    "OpenDdsPlugin",
    "Options",
    "Recognised",
    "StackEnclave",
    "agree",
    "examine",
    "export",
    "exporter_of",
    "files_of_plugins",
    "find_cyclone_plugins",
    "find_fastdds",
    "find_opendds",
    "fit_for_a_command",
    "foreign_stacks",
    "in_words",
    "install_opendds",
    "installed_plugins",
    "preflight",
    "read_library",
    "recognise",
    "remove_plugins",
    "runs_here",
    "standard_properties",
    "write",
]
