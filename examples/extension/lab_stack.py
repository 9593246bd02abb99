"""A stack of this lab: its programs read the properties of DDS-Security from a file."""

from pqsec_pki.errors import UsageError
from pqsec_pki.stacks import OtherStack
from pqsec_pki.vendors import (
    FOLDER,
    Export,
    Exporter,
    Options,
    StackEnclave,
    standard_properties,
)


def write(enclave: StackEnclave, options: Options) -> Export:
    """The properties of DDS-Security 1.1, one in a line."""
    properties = standard_properties(enclave)
    if enclave.key_is_encrypted:
        if options.password is None:
            raise UsageError("Lab DDS does not ask for a passphrase", hint="give --password-file")
        properties["dds.sec.auth.password"] = options.password
    text = "".join(f"{name}={value}\n" for name, value in properties.items())
    return Export(
        stack=LAB_DDS.stack,
        participant=enclave.name,
        files={"participant.properties": text},
        steps=(f"lab_node --security {FOLDER}/participant.properties",),
    )


LAB_DDS = Exporter(
    stack=OtherStack("labdds", "Lab DDS"),
    writer=write,
    versions="2.x",
    first=(2,),
    end=(3,),
    evidence="run in this lab",
)
