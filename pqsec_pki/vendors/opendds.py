"""OpenDDS: an ini file that turns security on, and a header with the participant's properties.

OpenDDS reads the names of credentials only from the participant's QoS, which the program sets; a
configuration file cannot contain them. 3.13.3 was run with the files that are written here. With
pqsec's own plugin, the header loads it too.
"""

import re
from contextlib import suppress
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.credentials import GOVERNANCE, REVOCATION_LIST
from pqsec_pki.documents import Governance, ProtectionKind
from pqsec_pki.errors import FileError, PqsecError, UsageError, VerificationError, shown
from pqsec_pki.smime import document_in
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.cyclone_plugins import agree, in_words
from pqsec_pki.vendors.enclave import StackEnclave, password_note, standard_properties
from pqsec_pki.vendors.exports import FOLDER, PASSWORD_VARIABLE, Export, Options, Version
from pqsec_pki.vendors.opendds_adapter import (
    OPENDDS_FACTORY,
    OPENDDS_LINK,
    InstalledOpenDds,
    installed_opendds,
)

INI, HEADER = "opendds.ini", "pqsec_participant.h"
DIRECTIVE = "dynamic Pqsec Service_Object * {}:{}()"
"""How ACE loads a library by its path."""
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
_NO_LIST = "OpenDDS reads no revocation list (crl.pem): it accepts revoked participants"
_CRL = "dds.sec.auth.identity_crl"
"""pqsec's plugin reads it; OpenDDS's own has no such property."""
_UNFIT = re.compile(r"""[^!-~]|[:*(){}'"#%$]""")
"""Characters that ACE does not accept in a path, or replaces."""
_UNMODIFIED = (
    "a program that sets these properties without the header loads the plugin if {} is first in"
    " LD_LIBRARY_PATH"
)
_STAYS = "OpenDDS does not disconnect a peer that is revoked or expires after it authenticated"


def export(enclave: StackEnclave, options: Options) -> Export:
    """The ini file and the header."""
    if options.password is not None:
        raise UsageError(
            "a header is not a place for a passphrase",
            hint=f"leave --password-file out, and set {PASSWORD_VARIABLE} for the process",
        )
    properties, directive = standard_properties(enclave), None
    warnings = _warnings(enclave, options)
    if options.plugin:
        directive = _directive(options.plugin)
        if enclave.has_crl:
            properties[_CRL] = enclave.uri(REVOCATION_LIST)
    header = render(
        "opendds.h",
        enclave=enclave,
        properties=properties,
        directive=directive,
        password_variable=PASSWORD_VARIABLE if enclave.key_is_encrypted else None,
    )
    return Export(
        stack=Stack.OPENDDS,
        participant=enclave.name,
        files={INI: render("opendds.ini"), HEADER: header},
        steps=(
            f"# in your program: #include <{HEADER}> (-I {FOLDER}) and pqsec::secure(qos)",
            f"your_program -DCPSConfigFile {FOLDER}/{INI}",
        ),
        notes=(*password_note(enclave, options), *_notes(enclave, options)),
        warnings=warnings,
    )


def _warnings(enclave: StackEnclave, options: Options) -> tuple[str, ...]:
    """What that OpenDDS cannot do; VerificationError if it would create no participant."""
    here = _installed(options)
    release = options.release or (here.release if here else ())
    problem = _unprotectable(enclave, release)
    if problem and len(release) >= len(PROTECTS_RTPS) and not options.anyway:
        raise VerificationError(problem, hint=_WAY_OUT)
    unread = _STAYS if options.plugin else _NO_LIST
    found = (problem, _NOT_RUN if release != RUN else "", unread if enclave.has_crl else "")
    return tuple(filter(None, found))


def _notes(enclave: StackEnclave, options: Options) -> tuple[str, ...]:
    if options.plugin:
        first = options.plugin.absolute() / OPENDDS_LINK.parent
        return own_plugin.NOTE, _UNMODIFIED.format(first)
    return (_WRONG,) if enclave.key_is_encrypted else ()


def _installed(options: Options) -> InstalledOpenDds | None:
    """The plugin that is to run, if it is to run here; FileError if it would not."""
    if options.plugin is None or options.at:
        return None
    found = installed_opendds(options.plugin.absolute())
    problem = found.problem if found else "`pqsec plugin install` did not install it"
    if found is None or problem:
        raise FileError(
            f"the plugin in {shown(str(options.plugin))} does not run in OpenDDS: {problem}",
            hint="`pqsec plugin install opendds` compiles it again",
        )
    if not agree(found.release, options.release):
        raise FileError(
            f"the plugin in {shown(str(options.plugin))} is for OpenDDS {in_words(found.release)}",
            hint="`pqsec plugin install opendds --root DIR` compiles it for another one",
        )
    return found


def _directive(folder: Path) -> str:
    """The directive that loads the plugin in `folder`; UsageError if ACE cannot express the
    folder."""
    path = folder.absolute() / own_plugin.OPENDDS
    if unfit := _UNFIT.search(str(path)):
        raise UsageError(
            f"{shown(str(folder))}: OpenDDS loads nothing from a folder with {unfit[0]!r} in its"
            " name",
            hint="install the plugin elsewhere: `pqsec plugin install opendds --dir DIR`",
        )
    return DIRECTIVE.format(path, OPENDDS_FACTORY)


def _unprotectable(enclave: StackEnclave, release: Version) -> str:
    """What OpenDDS of that version, or of any version if none is given, cannot protect."""
    if release[:2] >= PROTECTS_RTPS:
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
