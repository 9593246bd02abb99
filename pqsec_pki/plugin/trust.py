"""The trust anchors of a local participant, from its properties."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import field, replace
from datetime import datetime
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate, verify_authority
from pqsec_pki.credentials import (
    ALT_KEY,
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    PROOF,
    REVOCATION_LIST,
    TrustAnchors,
    distinct,
    verify_logged,
)
from pqsec_pki.errors import PqsecError, UsageError, VerificationError, located
from pqsec_pki.plugin import credentials
from pqsec_pki.plugin.credentials import FileState, Properties, Source, state_of
from pqsec_pki.plugin.property_names import REVOCATION_LIST as LIST_PROPERTY
from pqsec_pki.plugin.settings import AgentSettings, SettingsFile
from pqsec_pki.problems import Problem

PROPERTIES: Mapping[str, str] = {
    CERTIFICATE: "dds.sec.auth.identity_certificate",
    KEY: credentials.PRIVATE_KEY,
    IDENTITY_CA: "dds.sec.auth.identity_ca",
    PERMISSIONS_CA: "dds.sec.access.permissions_ca",
    GOVERNANCE: "dds.sec.access.governance",
    PERMISSIONS: "dds.sec.access.permissions",
    REVOCATION_LIST: LIST_PROPERTY,
}
"""File of an enclave -> the property that names it."""
_NEIGHBOURS: Mapping[str, str] = {ALT_KEY: KEY, PERMISSIONS_ALT_CA: PERMISSIONS_CA}
"""File that no property names -> the file that it is beside."""
TRUSTED = "dds.sec.auth.trusted_ca_dir"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantTrust:
    """The participant's certificate and its trust anchors, which both plugins read first."""

    properties: Properties = field(repr=False)
    """Those that name its files."""
    certificate: Certificate
    settings: AgentSettings
    anchors: TrustAnchors
    proof: Path | None
    """The proof beside the certificate, if there is one and it is demanded."""
    list_at: Source | None
    """Its revocation list."""
    list_state: FileState
    """The state of the list's file before it was read."""

    @classmethod
    def of(
        cls,
        properties: Properties,
        now: datetime,
        file: SettingsFile | None = None,
        *,
        strongest: bool = True,
    ) -> Self:
        """Read both from the properties. Only CAs in a folder are verified, at `now`.

        `file` is the file of settings, by default that beside the certificate; `strongest` whether
        this is the only set, or the strongest. MalformedError or FileError, which name the file;
        UsageError for a property or a setting.
        """
        source = properties.source(PROPERTIES[CERTIFICATE])
        certificate = credentials.certificate_at(source)
        made = AgentSettings.of if strongest else AgentSettings.of_weaker
        settings = made(certificate, SettingsFile.beside(source) if file is None else file)
        own = credentials.certificates_at(properties.source(PROPERTIES[IDENTITY_CA]))
        signer = properties.source(PROPERTIES[PERMISSIONS_CA])
        second, revoked = beside(properties, PERMISSIONS_ALT_CA), list_source(properties)
        state = state_of(revoked)
        anchors = TrustAnchors(
            identity_cas=(*own, *_others(properties, own, now)),
            permissions_ca=credentials.certificate_at(signer),
            countersigner=credentials.certificate_at(second) if second else None,
            revocation_list=credentials.revocation_list_at(revoked) if revoked else None,
            stock_peers=settings.stock_peers,
        )
        proof = source.beside(PROOF) if settings.proofs else None
        return cls(
            properties=properties,
            certificate=certificate,
            settings=settings,
            anchors=anchors,
            proof=proof,
            list_at=revoked,
            list_state=state,
        )

    def refuse_unproven(self, governance: bytes, permissions: bytes) -> None:
        """VerificationError or MalformedError without a proof that holds, if it is demanded."""
        if not self.settings.proofs:
            return
        from pqsec_pki.transparency import LedgerProof  # noqa: PLC0415 -- few demand it

        proof = None
        if self.proof:
            with located(self.proof):
                proof = LedgerProof.from_bytes(credentials.octets_of(self.proof))
        pem = self.certificate.pem
        files = {CERTIFICATE: pem, GOVERNANCE: governance, PERMISSIONS: permissions}
        name = self.certificate.subject_name
        verify_logged(name, self.anchors, files, proof, demanded=True)


def list_source(properties: Properties) -> Source | None:
    """Its revocation list; None without one. UsageError if it has a folder of trusted CAs too."""
    if not properties.optional(LIST_PROPERTY):
        return None
    if properties.optional(TRUSTED):
        raise UsageError(
            "a revocation list and a folder of trusted CAs exclude each other, as in Cyclone DDS",
            hint="the list is the identity CA's; for the others there would be none",
        )
    return properties.source(LIST_PROPERTY)


def beside(properties: Properties, file: str) -> Source | None:
    """The alternative key or the countersigner; None if the file does not exist."""
    source = properties.source(PROPERTIES[_NEIGHBOURS[file]])
    path = _path_beside(source, file)
    return replace(source, path=path) if path and source.beside(path.name) else None


def places(properties: Properties) -> Mapping[str, str]:
    """File -> the path or property with which `refusal` names it."""
    found = {
        file: properties.source(name).where
        for file, name in PROPERTIES.items()
        if properties.optional(name)
    }
    for file, neighbour in _NEIGHBOURS.items():
        path = _path_beside(properties.source(PROPERTIES[neighbour]), file)
        if path:
            found[file] = str(path)
    return found


def refusal(
    problems: Collection[Problem], where: Mapping[str, str], *, hint: str | None = None
) -> VerificationError:
    """An error with each of `problems` once, with its place in `where` instead of its file."""
    found = distinct(problems)
    placed = (replace(each, subject=where.get(each.subject, each.subject)) for each in found)
    return VerificationError(*placed, hint=hint)


def _path_beside(source: Source, file: str) -> Path | None:
    """The path of `file`; None if its neighbour is not a file, or has an unusual name."""
    if source.path is None:
        return None
    name = source.path.name
    other = f"alt.{name}" if file == ALT_KEY else name.replace(".cert.pem", ".alt.cert.pem")
    return source.path.with_name(other) if other != name else None


def _others(
    properties: Properties, own: tuple[Certificate, ...], now: datetime
) -> Iterator[Certificate]:
    """The valid identity CAs in a folder, each key once. Invalid ones are ignored: only their
    participants are refused."""
    folder, known = properties.folder(TRUSTED), {each.spki for each in own}
    for each in credentials.certificates_below(folder) if folder else ():
        with suppress(PqsecError):
            verify_authority(each, now=now)
            if each.spki not in known:
                known.add(each.spki)
                yield each
