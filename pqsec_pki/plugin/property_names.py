"""The security properties that a participant may have, and other stacks' names for them.

An unknown security property must not be ignored: a user who gives a revocation list under
another stack's name expects it to apply. So a property in a security name space is known here,
or the participant is not created. Other properties belong to the application.
"""

from collections.abc import Iterable, Mapping

from pqsec_pki.errors import UsageError, shown

REVOCATION_LIST = "org.eclipse.cyclonedds.sec.auth.crl"
"""Cyclone DDS's name, which the rest of this room uses."""
_REVOCATION_LISTS = (
    REVOCATION_LIST,
    "dds.sec.auth.builtin.PKI-DH.identity_crl",  # Fast DDS 2.9 to 3.x
    "dds.sec.auth.identity_crl",  # the same without the plugin's name, like DDS-Security's names
    "dds.sec.auth.crl",  # used by adapters for OpenDDS, which has no such property
)
_UNDERSTOOD = (
    "dds.sec.auth.identity_ca",
    "dds.sec.auth.identity_certificate",
    "dds.sec.auth.private_key",
    "dds.sec.auth.password",
    "dds.sec.auth.trusted_ca_dir",
    "dds.sec.access.permissions_ca",
    "dds.sec.access.governance",
    "dds.sec.access.permissions",
)
_OF_THE_STACK = (
    # Cyclone DDS 0.10 and 11 (dds_security_api_defs.h): its libraries, and its crypto plugin's.
    *(
        f"dds.sec.{plugin}.library.{what}"
        for plugin in ("auth", "access", "crypto")
        for what in ("path", "init", "finalize")
    ),
    "dds.sec.crypto.keysize",
)
_KNOWN = frozenset((*_REVOCATION_LISTS, *_UNDERSTOOD, *_OF_THE_STACK))
_SPACES = (
    "dds.sec.",
    "org.eclipse.cyclonedds.sec.",
    "com.rti.serv.secure",
    "pqsec.",
)
"""Security name spaces: those of DDS-Security, Cyclone DDS, RTI and this project."""

_CLOSE = 0.85
"""Similarity by difflib: names that end in crl and clr reach it, crl and ocsp do not."""


def understood(pairs: Iterable[tuple[str, str]]) -> Mapping[str, str]:
    """A participant's properties, with a revocation list under REVOCATION_LIST.

    UsageError for a security property that is unknown, or has two values.
    """
    found: dict[str, str] = {}
    for given, value in pairs:
        _refuse_unknown(given)
        name = REVOCATION_LIST if given in _REVOCATION_LISTS else given
        if name in _KNOWN and found.get(name, value) != value:
            raise UsageError(f"the property {given} has two values, perhaps under two names")
        found[name] = value
    return found


def _refuse_unknown(name: str) -> None:
    if name in _KNOWN or not name.lower().startswith(_SPACES):
        return
    near = _near(name)
    raise UsageError(
        f"the property {shown(name)} is unknown to pqsec's plugin, and is not ignored",
        hint=f"did you mean {near[0]}?" if near else "docs/reference/plugin.md lists them all",
    )


def _near(name: str) -> list[str]:
    """The known name that is most similar: by its ending, as another stack's, or its spelling."""
    from difflib import get_close_matches  # noqa: PLC0415 -- few errors need it

    last = name.rpartition(".")[2]
    alike = [each for each in _UNDERSTOOD if each.endswith(f".{last}")]
    return alike or get_close_matches(name, sorted(_KNOWN), n=1, cutoff=_CLOSE)
