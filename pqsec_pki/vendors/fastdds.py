"""Fast DDS: a default participant profile in XML, for 2.x and 3.x.

The two differ in the name space, which only `fastdds xml validate` looks at, and in the
variable that names the file. From 2.12 on, ${NAME} in a value is replaced by the variable;
it cannot be escaped.

pqsec's own plugin takes the place of Fast DDS's under the same names. Fast DDS runs without
security if it does not know a plugin's name, so a process that does not preload ours must find
the names of Fast DDS's, which refuse post-quantum keys.
"""

import re

from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    PERMISSIONS,
    PERMISSIONS_CA,
    REVOCATION_LIST,
)
from pqsec_pki.errors import UsageError
from pqsec_pki.lint import Finding, Severity
from pqsec_pki.stacks import FAST_DDS_LIMIT, Stack
from pqsec_pki.vendors import _preload, own_plugin
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import FOLDER, Export, Options

FILE = "fastdds.xml"
NAMESPACES = {
    2: "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles",
    3: "http://www.eprosima.com",
}
VARIABLES = {2: "FASTRTPS_DEFAULT_PROFILES_FILE", 3: "FASTDDS_DEFAULT_PROFILES_FILE"}
OVER_LIMIT = "PQS501"
"""The rule of the check about handshakes over 8192 bytes."""

_AUTH, _ACCESS = "dds.sec.auth.builtin.PKI-DH", "dds.sec.access.builtin.Access-Permissions"
_RESENDING = {
    f"{_AUTH}.max_handshake_requests": "100",
    f"{_AUTH}.handshake_resend_period_gain": "1.1",
}
"""By default Fast DDS 3.1.2 gives a peer up for good after ten Requests. A post-quantum message has
many datagrams and is lost with any of them: of six pairs with datagrams of 1400 bytes and a loss of
one in ten, three never met; with 400 Requests all of 14 did, within 23 s. 2.9.1 ignores both."""
_UNREAD = (
    f"if Fast DDS cannot read {FILE}, the file that its variable names, it only logs a message and"
    " runs unsecured"
)
_ENGINE = (
    "Fast DDS asks the token by OpenSSL's engine pkcs11 (libengine-pkcs11-openssl), which wants the"
    " token's library in PKCS11_MODULE_PATH, unless p11-kit knows it, and the PIN in"
    " FASTDDS_PKCS11_PIN, or in the file that the key's URI names (pin-source), without a line end:"
    " with none, it tries an empty PIN"
)
_REPLACED = re.compile(r"\$\{[A-Z_][A-Z0-9_]*\}")


def export(enclave: StackEnclave, options: Options) -> Export:
    """The file of profiles, and the variable that names it to the process."""
    generations = [options.release[0]] if options.release else [2, 3]
    properties = _properties(enclave, options)
    environment = {VARIABLES[each]: f"{FOLDER}/{FILE}" for each in generations}
    notes: tuple[str, ...] = (_UNREAD,)
    if enclave.key_uri and not options.plugin:
        notes += (_ENGINE,)
    if options.plugin:
        path = _preload.preloaded(options.plugin, options, options.release)
        environment[_preload.VARIABLE] = str(path)
        notes += (own_plugin.NOTE, _preload.NOTE)
    if any(map(_REPLACED.search, properties.values())):
        raise UsageError(
            "a path or the passphrase contains ${NAME}, which Fast DDS would replace",
            hint="put the keystore elsewhere, or choose another passphrase",
        )
    return Export(
        stack=Stack.FASTDDS,
        participant=enclave.name,
        files={
            FILE: render(
                "fastdds.xml",
                enclave=enclave,
                namespace=NAMESPACES[generations[0]],
                properties=properties,
                loopback=options.loopback,
                transport="loopback" if options.loopback else "udp" if options.udp_only else None,
            )
        },
        environment=environment,
        notes=notes,
        is_private=options.password is not None,
    )


def severity(finding: Finding, options: Options) -> Severity | None:
    """Messages over 8192 bytes stop some versions, and do not matter to others or to our plugin."""
    if options.plugin:
        return own_plugin.severity(finding, options)
    meant = options.release
    if finding.rule.id != OVER_LIMIT:
        return finding.severity
    if meant[:3] in FAST_DDS_LIMIT.versions:
        return Severity.ERROR
    may_be = any(each[: len(meant)] == meant for each in FAST_DDS_LIMIT.versions)
    return Severity.WARNING if may_be else None


def _properties(enclave: StackEnclave, options: Options) -> dict[str, str]:
    found = {
        "dds.sec.auth.plugin": "builtin.PKI-DH",
        f"{_AUTH}.identity_ca": enclave.uri(IDENTITY_CA),
        f"{_AUTH}.identity_certificate": enclave.uri(CERTIFICATE),
        f"{_AUTH}.private_key": _private_key(enclave, options),
    }
    if enclave.key_is_encrypted:
        found[f"{_AUTH}.password"] = _password(options)
    if enclave.has_crl:
        found[f"{_AUTH}.identity_crl"] = enclave.uri(REVOCATION_LIST)
    if options.plugin:
        found |= _RESENDING
    else:
        # 2.10.7, 2.14.5, 3.0.2, 3.1.1 and later; other versions ignore it and use DH.
        found[f"{_AUTH}.preferred_key_agreement"] = "ECDH"
    found |= {
        "dds.sec.access.plugin": "builtin.Access-Permissions",
        f"{_ACCESS}.permissions_ca": enclave.uri(PERMISSIONS_CA),
        f"{_ACCESS}.governance": enclave.uri(GOVERNANCE),
        f"{_ACCESS}.permissions": enclave.uri(PERMISSIONS),
        "dds.sec.crypto.plugin": "builtin.AES-GCM-GMAC",
    }
    return found


def _private_key(enclave: StackEnclave, options: Options) -> str:
    """The key's URI; Fast DDS's own plugin cannot read a file that refers to a key."""
    return enclave.uri(KEY) if options.plugin or not enclave.key_uri else enclave.key_uri


def _password(options: Options) -> str:
    """From 2.12 on, a reference to a variable is possible. It is not used: if the variable is not
    set, 3.1.2 drops the whole profile, and runs unsecured."""
    if options.password is None:
        raise UsageError(
            "the participant's key is encrypted, and Fast DDS can take its passphrase from the"
            " profile only",
            hint="--password-file writes it there; or decrypt the key",
        )
    if not options.password.strip():
        raise UsageError(
            "Fast DDS drops a profile in which a value is only spaces, and runs unsecured",
            hint="choose another passphrase",
        )
    return options.password
