"""The newest certificate and permissions of participants, by the ledger and by their folders.

Other files in an enclave are refused. Permissions are read only after the permissions CA's
signature was verified.
"""

import hashlib
from collections.abc import Collection, Sequence
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import Permissions
from pqsec_pki.errors import KeystoreError, located, shown
from pqsec_pki.keystore import (
    Entry,
    Keystore,
    Ledger,
    ParticipantState,
    compromised_keys_in,
    layout,
    load_certificate,
    participant_states,
)


@dataclass(frozen=True, slots=True)
class Inspector:
    """Reads a participant's newest files, and refuses files that are not the newest."""

    keystore: Keystore
    anchors: TrustAnchors
    participants: dict[str, ParticipantState]
    """States by name."""
    known: dict[str, int]
    """SHA-256 of signed permissions -> number of their line."""
    compromised: dict[str, Entry]
    """Hash of a key -> the entry of the certificate that was revoked as compromised."""

    @classmethod
    def of(
        cls,
        keystore: Keystore,
        ledger: Ledger,
        names: Collection[str] | None = None,
        *,
        now: datetime,
    ) -> Self:
        """Read the ledger, on all participants or on `names`, while the keystore is locked."""
        return cls(
            keystore,
            keystore.issuing_cas,
            {each.name: each for each in participant_states(keystore, ledger, names, now=now)},
            ledger.numbers("permissions"),
            compromised_keys_in(keystore.folder, ledger),
        )

    def revoked_of(self, names: Sequence[str]) -> list[str]:
        """The names of `names` whose newest certificate was revoked."""
        known = filter(None, map(self.participants.get, names))
        return [each.name for each in known if each.revoked]

    def refuse_revoked(self, names: Sequence[str]) -> None:
        """KeystoreError if any of them was revoked."""
        revoked = self.revoked_of(names)
        if revoked:
            raise KeystoreError(
                f"revoked: {', '.join(revoked)}",
                hint="to admit it again: `pqsec issue` with --force --after-revocation",
            )

    def issued_by_previous_ca_of(self, names: Sequence[str]) -> list[str]:
        """The names of `names` whose newest certificate a previous identity CA issued."""
        known = filter(None, map(self.participants.get, names))
        return [each.name for each in known if each.issued_by_previous_ca]

    def refuse_previous_ca(self, names: Sequence[str]) -> None:
        """KeystoreError if any of them was issued by a CA that has been replaced."""
        issued_by_previous_ca = self.issued_by_previous_ca_of(names)
        if issued_by_previous_ca:
            raise KeystoreError(
                f"issued by a CA that has been replaced: {', '.join(issued_by_previous_ca)}",
                hint="issue it again: `pqsec issue` with --force and all its topics; with --csr"
                " if its key is on the robot",
            )

    def certificate(self, name: str, folder: Path) -> Certificate:
        """The newest certificate of `name`; KeystoreError if `folder` has another one."""
        self.keystore.refuse_unknown(name)
        path = folder / layout.CERTIFICATE
        found = load_certificate(path)
        known = self.participants.get(name)
        if known is None:
            raise KeystoreError(
                f"{path}: the ledger has no certificate for {shown(name)}",
                hint="move its folder out of enclaves/; or restore the ledger from a backup, if"
                " it was issued here",
            )
        if found.fingerprint != known.sha256:
            raise _stale(path, name, "certificate", self.keystore)
        return found

    def lacks_permissions(self, name: str, folder: Path) -> bool:
        """Whether `name` was certified, but no permissions were signed for it yet."""
        signed = self.participants[name].permissions_line or exists(folder / layout.PERMISSIONS)
        return not signed

    def signed_permissions(self, name: str, folder: Path) -> bytes:
        """The newest signed permissions of `name`; KeystoreError if `folder` has others."""
        if self.lacks_permissions(name, folder):
            raise KeystoreError(
                f"no permissions were signed for {name} yet",
                hint=f"`pqsec permit {name}` signs them, with the permissions CA's key",
            )
        path = folder / layout.PERMISSIONS
        signed = read(path)
        number = self.known.get(hashlib.sha256(signed).hexdigest(), 0)
        if number < max(self.participants[name].permissions_line, 1):
            raise _stale(path, name, "permissions", self.keystore)
        return signed

    def permissions(self, name: str, folder: Path) -> Permissions:
        """The newest permissions of `name`, with verified signatures."""
        signed = self.signed_permissions(name, folder)
        with located(folder / layout.PERMISSIONS):
            document = self.verified(signed)
            self._refuse_edited(folder / layout.PERMISSIONS_XML, document)
            return Permissions.from_xml(document)

    def config_digest(self, name: str, folder: Path) -> str:
        """The config digest of `name`; empty if its permissions were signed by hand since."""
        state = self.participants[name]
        signed = hashlib.sha256(read(folder / layout.PERMISSIONS)).hexdigest()
        return state.config_digest if signed == state.permissions else ""

    def verified(self, signed: bytes) -> bytes:
        """The document in a signed file; VerificationError if the CA did not sign it."""
        return self.anchors.signed(signed).document

    def _refuse_edited(self, path: Path, signed: bytes) -> None:
        """KeystoreError if permissions.xml has unsigned edits: they would be overwritten."""
        if path.exists() and read(path) not in (signed, signed.replace(b"\r\n", b"\n")):
            root, file = quote(str(self.keystore.root)), quote(str(path))
            raise KeystoreError(
                f"{path} is not what permissions.p7s says",
                hint=f"`pqsec -k {root} sign-permissions {file} --force` signs what it says now; or"
                f" remove {path}: it is written again from the signed document",
            )


def _stale(path: Path, name: str, what: str, keystore: Keystore) -> KeystoreError:
    if keystore.ledger_address:
        return KeystoreError(
            f"{path} is not the newest {what} of {name}: another machine has it",
            hint=f"work there; or issue it here: `pqsec issue {name} --force`, with all its rights",
        )
    return KeystoreError(
        f"{path} is not the newest {what} that the ledger has for {name}",
        hint=f"restore that file, or issue it again: pqsec issue {name} --force ...",
    )
