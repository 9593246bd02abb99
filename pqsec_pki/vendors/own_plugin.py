"""pqsec's own plugin in place of a stack's: where it is, and whether it accepts a participant.

Rules of `pqsec check` about stacks describe their own plugins. Our plugin is run instead, with the
calls that a stack would make to its agent.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePosixPath

from pqsec_pki._places import refuse_outsiders
from pqsec_pki.credentials import KEY, REVOCATION_LIST
from pqsec_pki.errors import FileError, PqsecError, VerificationError
from pqsec_pki.lint import Finding, Severity
from pqsec_pki.plugin import LIBRARY, NAMES
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors.enclave import StackEnclave, standard_properties
from pqsec_pki.vendors.exports import Options

FASTRTPS = "fastrtps"
"""ROS 2's middleware on Fast DDS."""
PRELOAD = "libpqsec_fastdds.so"
"""The library that a process of Fast DDS preloads."""
OPENDDS = "libpqsec_opendds.so"
"""What a process of OpenDDS loads by a directive, or by the name of OpenDDS's own plugins."""
PATH = "LD_LIBRARY_PATH"
NOTE = (
    "the process starts pqsec's agent, or finds a running one by XDG_RUNTIME_DIR;"
    " PQSEC_AGENT=private starts one for this process only"
)
WAY_OUT = " Or run pqsec's plugin in it: --plugin."
"""Added to the fix of a finding that only concerns other plugins."""
_CRL, _PASSWORD = "org.eclipse.cyclonedds.sec.auth.crl", "dds.sec.auth.password"
_ANY_DOMAIN, _CANDIDATE = 0, bytes(16)


def refuse_missing(folder: Path, names: Iterable[str] = (LIBRARY,)) -> None:
    """FileError unless the plugin is in `folder`, by these names, and nobody else can change it."""
    if missing := [name for name in names if not _is_file(folder / name)]:
        stack = {PRELOAD: " fastdds", OPENDDS: " opendds"}.get(missing[0], "")
        command = f"pqsec plugin install{stack}"
        raise FileError(
            f"the plugin is not installed: {folder} has no {missing[0]}",
            hint=f"`{command}` installs it; --plugins names another folder",
        )
    words = "anyone who may write there can change what DDS processes load"
    refuse_outsiders((folder / name for name in names), words, roots=True)


def folder_in(variables: Mapping[str, str]) -> Path | None:
    """The folder where a stack that loads plugins by name finds ours; None if it finds others."""
    for folder in map(Path, filter(None, re.split("[:;]", variables.get(PATH, "")))):
        if _is_file(folder / NAMES[0]):
            return folder if (folder / NAMES[0]).resolve().name == LIBRARY else None
    return None


def severity(finding: Finding, options: Options) -> Severity | None:
    """The severity. Findings for the stacks' own plugins do not matter if ours runs."""
    return None if options.plugin and is_of_others(finding) else finding.severity


def is_of_others(finding: Finding) -> bool:
    """Whether it matters only to the stacks' own plugins."""
    return bool(finding.stacks) and set(finding.stacks) != {Stack.ROS2}


def refusal(enclave: StackEnclave, options: Options, now: datetime) -> VerificationError | None:
    """Why our plugin refuses the participant, if it is to run at all; empty if it accepts it.

    It is not run with a key that is on its robot or in a token, or is encrypted here.
    """
    if options.plugin is None:
        return None
    try:
        _ask(enclave, options, now)
    except PqsecError as error:
        words = f"pqsec's plugin refuses {enclave.name}: {error}"
        return VerificationError(words, hint=error.hint)
    return None


def _ask(enclave: StackEnclave, options: Options, now: datetime) -> None:
    from pqsec_pki.plugin.access_control import AccessControl  # noqa: PLC0415 -- heavy
    from pqsec_pki.plugin.credentials import Properties  # noqa: PLC0415 -- likewise
    from pqsec_pki.plugin.participant import Participant  # noqa: PLC0415 -- likewise

    pairs = tuple(_properties(enclave, options).items())
    is_open = enclave.key_uri is None and not enclave.key_is_encrypted
    if _is_file(enclave.folder / KEY) and (options.password or is_open):
        Participant.load(Properties(pairs, "/"), _CANDIDATE, now, lambda _: None)
    AccessControl(lambda: now).validate_local_permissions(0, _ANY_DOMAIN, "/", pairs)


def _properties(enclave: StackEnclave, options: Options) -> dict[str, str]:
    """The properties as the stack will give them, with the files where they are now."""
    here = replace(enclave, at=PurePosixPath(enclave.folder))
    found = standard_properties(here)
    if enclave.has_crl:
        found[_CRL] = here.uri(REVOCATION_LIST)
    if options.password is not None:
        found[_PASSWORD] = options.password
    return found


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:
        return False
