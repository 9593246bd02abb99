"""OpenDDS: an ini file that turns security on, and a header with the participant's properties.

OpenDDS reads the names of credentials from the participant's QoS alone, which a program fills
in: no file of its configuration can hold them. 3.13.3 was run with what is written here.
"""

from contextlib import suppress

from pqsec_pki._files import read
from pqsec_pki.credentials import GOVERNANCE
from pqsec_pki.documents import Governance, ProtectionKind
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.smime import document_in
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import Enclave, password_note, standard_properties
from pqsec_pki.vendors.export import FOLDER, PASSWORD_VARIABLE, Export, Options

INI, HEADER = "opendds.ini", "pqsec_participant.h"
PROTECTS_RTPS = (3, 14)
"""The first version that can protect RTPS messages (its source); 3.13.3 makes no participant."""
RUN = (3, 13, 3)
_NOT_RUN = "run with 3.13.3; later versions were not run with it, their source was read"
_WAY_OUT = (
    "set rtps_protection_kind to NONE and sign the governance again (`pqsec sign-governance`), for"
    " all participants; or update OpenDDS to 3.14 or later"
)
_WRONG = (
    "OpenDDS makes a participant with a wrong one all the same, and no peer accepts it; without"
    " one the header ends the program"
)


def export(enclave: Enclave, options: Options) -> Export:
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
        notes=(*password_note(enclave, options), *([_WRONG] if enclave.key_is_encrypted else [])),
        warnings=tuple(warnings),
    )


def _unprotectable(enclave: Enclave, options: Options) -> str:
    """What an OpenDDS of that version, or of any if it is not said, cannot protect."""
    if options.release[:2] >= PROTECTS_RTPS:
        return ""
    with suppress(PqsecError):  # the check tells what is wrong with the document
        governance = Governance.from_xml(document_in(read(enclave.folder / GOVERNANCE)))
        kinds = {rule.rtps_protection_kind for rule in governance.domain_rules}
        if kinds != {ProtectionKind.NONE}:
            return (
                "OpenDDS before 3.14 makes no participant where the governance protects RTPS"
                " messages (rtps_protection_kind): 3.13.3 says 'RTPS protection is unsupported'"
            )
    return ""
