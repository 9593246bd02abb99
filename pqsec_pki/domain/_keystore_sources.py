"""Reads keystores, pqsec's and those of SROS2, as sources of a domain file."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.domain._sources import ImportSource, common_name_in, lifetime
from pqsec_pki.errors import FileError, MissingError, PqsecError, located
from pqsec_pki.keystore import (
    Files,
    Keystore,
    Overlap,
    ParticipantState,
    layout,
    load_certificate,
    status,
)
from pqsec_pki.lifecycle import adoptable

_CA_NAME = " Identity CA"
"""What the name of a keystore's identity CA ends with."""


def keystore_source(keystore: Keystore, now: datetime) -> ImportSource:
    anchors = keystore.issuing_cas
    source = _with_shared(keystore, anchors)
    source.groups, source.stock = keystore.groups, keystore.stock
    source.approvals = keystore.approvals
    ca = keystore.identity_ca
    source.ca_validity = lifetime(ca.not_before, ca.not_after)
    states = {
        each.name: each for each in status(keystore, now=now, compare_files=True).participants
    }
    overlap = any(map(Overlap.of, keystore.sets))
    for name in sorted({*states, *keystore.names()}):
        held = states.get(name)
        if held is None:
            source.leave_out(name, "is not in the ledger", refused=True)
        elif why := next(_why_not(held, now, overlap=overlap), None):
            refused = held.files in {Files.OTHER_CERTIFICATE, Files.OTHER_PERMISSIONS}
            source.leave_out(name, why, refused=refused)
        else:
            elsewhere = held.requested and not keystore.has_key(name)
            _add_signed(source, keystore, anchors, name, now, key_elsewhere=elsewhere)
    return source


def other_keystore_source(root: Path, now: datetime) -> ImportSource:
    found = adoptable(root, now=now)
    anchors = found.keystore.issuing_cas
    source = _with_shared(found.keystore, anchors)
    if not found.fitting:
        source.profiles = ()
    for name in found.keystore.names():
        if name in found.revoked:
            source.leave_out(name, "was revoked")
        elif name not in found.participants:
            why = found.refused.get(f"{layout.enclave_folder(name)}/{layout.CERTIFICATE}")
            source.leave_out(name, why or "its certificate is refused", refused=True)
        else:
            _add_signed(source, found.keystore, anchors, name, now)
    return source


def _with_shared(keystore: Keystore, anchors: TrustAnchors) -> ImportSource:
    """The governance, profile and name of CAs. VerificationError for a bad signature."""
    with located(keystore.folder / layout.ENCLAVES / layout.GOVERNANCE):
        signed = anchors.signed(keystore.governance)
        governance = Governance.from_xml(signed.document)
    ca = common_name_in(keystore.identity_ca.subject_name)
    return ImportSource(
        keystore.root,
        governance=governance,
        ca_name=ca.removesuffix(_CA_NAME) if ca.endswith(_CA_NAME) else "",
        profiles=tuple(each.name for each in keystore.profiles),
    )


def _why_not(held: ParticipantState, now: datetime, *, overlap: bool) -> Iterator[str]:
    """Why the file should not have the participant."""
    if held.revoked:
        yield "was revoked"
    if held.files is Files.GONE:
        yield "its certificate is missing"
    if held.files is Files.ELSEWHERE:
        yield "its files are on another machine"
    if held.files is Files.OTHER_CERTIFICATE:
        yield "its certificate is not the one issued last"
    if held.issued_by_previous_ca and not overlap:
        yield "its CA was replaced"
    if held.not_after < now:
        yield "expired"
    if held.files is Files.OTHER_PERMISSIONS:
        yield "its permissions are not the ones signed last"


def _add_signed(  # noqa: PLR0913 -- the last by name
    source: ImportSource,
    keystore: Keystore,
    anchors: TrustAnchors,
    name: str,
    now: datetime,
    *,
    key_elsewhere: bool = False,
) -> None:
    """Add a participant by its certificate and its permissions, with their signatures verified."""
    folder = keystore.folder / layout.enclave_folder(name)
    try:
        certificate = load_certificate(folder / layout.CERTIFICATE)
        with located(folder / layout.PERMISSIONS):
            signed = anchors.signed(read(folder / layout.PERMISSIONS))
            permissions = Permissions.from_xml(signed.document)
            grants = permissions.grants_for(certificate.subject_name)
    except PqsecError as error:
        if isinstance(error, FileError) and not isinstance(error, MissingError):
            raise  # the file may be right
        source.leave_out(name, str(error), refused=True)
        return
    if certificate.not_after < now:
        source.leave_out(name, "expired")
        return
    validity = lifetime(certificate.not_before, certificate.not_after)
    source.add(name, grants, now, validity, key_elsewhere=key_elsewhere)
