"""OpenDDS: an ini file that turns security on, and a header with the participant's properties.

OpenDDS reads the names of credentials only from the participant's QoS, which the program sets; a
configuration file cannot contain them. 3.13.3 was run with the files that are written here.
"""

from contextlib import suppress

from pqsec_pki._files import read
from pqsec_pki.credentials import GOVERNANCE
from pqsec_pki.documents import Governance, ProtectionKind
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.smime import document_in
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import StackEnclave, password_note, standard_properties
from pqsec_pki.vendors.exports import FOLDER, PASSWORD_VARIABLE, Export, Options

INI, HEADER = "opendds.ini", "pqsec_participant.h"
PROTECTS_RTPS = (3, 14)
"""The first version that can protect RTPS messages (its source); 3.13.3 creates no participant."""
RUN = (3, 13, 3)
_NOT_RUN = "run with 3.13.3; later versions were not run with it, their source was read"
_WAY_OUT = (
    "set rtps_protection_kind to NONE and sign the governance again (`pqsec sign-governance`), for"
    " all participants; or update OpenDDS to 3.14 or later"
)
_WRONG = (
    "with a wrong one OpenDDS creates a participant that no peer accepts; without one the header"
    " ends the program"
)


def export(enclave: StackEnclave, options: Options) -> Export:
    """The ini file and the header."""
    if options.password is not None:
        raise UsageError(
            "a header is not a place for a passphrase",
            hint=f"leave --password-file out, and set {PASSWORD_VARIABLE} for the process",
        )
    problem = _unprotectable(enclave, options)
    certain = len(options.release) >= len(PROTECTS_RTPS)
    if problem and certain and not options.anyway:
        raise VerificationError(problem, hint=_WAY_OUT)
    warnings = [problem] if problem else []
    if options.release != RUN:
        warnings += [_NOT_RUN]
    if enclave.has_crl:
        warnings += ["OpenDDS reads no revocation list (crl.pem): it accepts revoked participants"]
    return Export(
        stack=Stack.OPENDDS,
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
        notes=(*password_note(enclave, options), *([_WRONG] if enclave.key_is_encrypted else [])),
        warnings=tuple(warnings),
    )


def _unprotectable(enclave: StackEnclave, options: Options) -> str:
    """What OpenDDS of that version, or of any version if none is given, cannot protect."""
    if options.release[:2] >= PROTECTS_RTPS:
        return ""
    with suppress(PqsecError):  # the check reports what is wrong with the document
        governance = Governance.from_xml(document_in(read(enclave.folder / GOVERNANCE)))
        kinds = {rule.rtps_protection_kind for rule in governance.domain_rules}
        if kinds != {ProtectionKind.NONE}:
            return (
                "OpenDDS before 3.14 creates no participant if the governance protects RTPS"
                " messages (rtps_protection_kind): 3.13.3 says 'RTPS protection is unsupported'"
            )
    return ""
