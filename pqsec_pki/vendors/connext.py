"""RTI Connext: a QoS profile in XML.

Names of properties and variables are those of RTI's documents and public examples; Connext was
not run. Connext replaces $(NAME) in a value by the variable.
"""

from pqsec_pki.errors import UsageError
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import StackEnclave, password_note, standard_properties
from pqsec_pki.vendors.exports import FOLDER, PASSWORD_VARIABLE, Export, Options

FILE = "connext.xml"
LOADING = {
    "com.rti.serv.load_plugin": "com.rti.serv.secure",
    "com.rti.serv.secure.library": "nddssecurity",
    "com.rti.serv.secure.create_function": "RTI_Security_PluginSuite_create",
}
_VARIABLE = "$("
_NO_CRL = (
    "crl.pem is not in it, because its property's name is not known: Connext accepts revoked"
    " participants until you add it"
)


def export(enclave: StackEnclave, options: Options) -> Export:
    """The file of profiles, and the environment variable that names it."""
    properties = LOADING | standard_properties(enclave)
    if _VARIABLE in "".join([*properties.values(), options.password or ""]):
        raise UsageError(
            f"a path or the passphrase contains {_VARIABLE}, which Connext would replace",
            hint="put the keystore elsewhere, or choose another passphrase",
        )
    warnings = ["written from RTI's documents: Connext was not run with it"]
    if enclave.key_is_encrypted:
        properties["dds.sec.auth.password"] = options.password or f"$({PASSWORD_VARIABLE})"
        warnings += ["Connext may expect the passphrase in another encoding: it is not encoded"]
    if enclave.has_crl:
        warnings += [_NO_CRL]
    return Export(
        stack=Stack.CONNEXT,
        participant=enclave.name,
        files={FILE: render("connext.xml", properties=properties)},
        environment={"NDDS_QOS_PROFILES": f"file://{FOLDER}/{FILE}"},
        notes=password_note(enclave, options),
        warnings=tuple(warnings),
        is_private=options.password is not None,
        unfit_folder=";|[]",  # NDDS_QOS_PROFILES is a list of groups
    )
