"""OpenDDS: an ini file that turns security on, and a header with the participant's properties.

OpenDDS reads the names of credentials from the participant's QoS alone, which a program fills
in: no file of its configuration can hold them. Its source was read for this; it was not run.
"""

from pqsec_pki.errors import UsageError
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import Enclave, password_note, standard_properties
from pqsec_pki.vendors.export import FOLDER, PASSWORD_VARIABLE, Export, Options

INI, HEADER = "opendds.ini", "pqsec_participant.h"


def export(enclave: Enclave, options: Options) -> Export:
    """The ini file and the header."""
    if options.password is not None:
        raise UsageError(
            "a header is no place for a passphrase",
            hint=f"leave --password-file out, and set {PASSWORD_VARIABLE} for the process",
        )
    warnings = ["written by OpenDDS's source: it was not run with it"]
    if enclave.has_crl:
        warnings += ["OpenDDS reads no revocation list: it lets in who is revoked in crl.pem"]
    return Export(
        stack="opendds",
        participant=enclave.name,
        files={
            INI: render("opendds.ini"),
            HEADER: render(
                "opendds.h",
                enclave=enclave,
                properties=standard_properties(enclave),
                password_variable=PASSWORD_VARIABLE if enclave.key_is_encrypted else None,
            ),
        },
        steps=(
            f"# in your program: #include <{HEADER}> (-I {FOLDER}) and pqsec::secure(qos)",
            f"your_program -DCPSConfigFile {FOLDER}/{INI}",
        ),
        notes=password_note(enclave, options),
        warnings=tuple(warnings),
    )
