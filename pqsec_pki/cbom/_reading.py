"""From files to assets; what cannot be read is returned beside them."""

import os
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import is_folder
from pqsec_pki._progress import counted
from pqsec_pki.algorithms import Profile, is_encrypted, unpem
from pqsec_pki.cbom import _material, _protocols
from pqsec_pki.cbom._assets import Assets
from pqsec_pki.certificates import Certificate, CertificateRequest, RevocationList
from pqsec_pki.credentials import ALT_KEY, CERTIFICATE, KEY
from pqsec_pki.documents import DomainRule
from pqsec_pki.errors import MalformedError, PqsecError
from pqsec_pki.keystore import GENERATIONS, layout
from pqsec_pki.lint import CertificateFile, File, GovernanceFile, Inventory, take_inventory
from pqsec_pki.tokens import is_reference

_REQUEST = "CERTIFICATE REQUEST"
_HINT = "pass certificates, keys, lists and documents, or folders with them"


def read_assets(paths: tuple[Path, ...], now: datetime) -> tuple[Assets, list[tuple[Path, str]]]:
    """(assets, [(path, reason)]) of all files below `paths`. FileError if one does not exist.

    The CAs that a keystore has replaced count too: their keys are still there.
    """
    replaced = [each for path in paths for each in _replaced(path)]
    reader = _Reader(paths, take_inventory([*paths, *replaced], now=now))
    reader.read()
    return reader.assets, reader.unread


def _replaced(path: Path) -> Iterator[Path]:
    """The folders of replaced CAs, in a keystore, of each set of credentials."""
    if is_folder(path / GENERATIONS):
        yield path / GENERATIONS
    yield from sorted(path.glob(f"{layout.SETS}/*/{GENERATIONS}"))


class _Reader:
    def __init__(self, paths: tuple[Path, ...], inventory: Inventory) -> None:
        self.assets = Assets()
        self.unread: list[tuple[Path, str]] = []
        self._paths, self._inventory = paths, inventory
        self._certificates = {each.path: each for each in inventory.certificates}
        self._binary = dict(_binary_certificates(inventory.files))
        known = [each for file in inventory.certificates for each in file.certificates]
        self._issuers = _material.Issuers([*known, *self._binary.values()])

    def read(self) -> None:
        """Fill `assets` and `unread`."""
        files = self._inventory.files
        for file in counted(files, len(files), "files"):
            if file.unreadable:
                self.unread.append((file.path, file.unreadable))
                continue
            try:
                self._file(file)
            except PqsecError as error:
                self.unread.append((file.path, str(error)))
        if self._inventory.interrupted_change:
            reason = "a change was interrupted: the next command that writes finishes it"
            self.unread.append((self._inventory.interrupted_change, reason))
        _protocols.add_authentication(self.assets, self._participants())
        _protocols.add_protection(self.assets, self._domain_rules())

    def _file(self, file: File) -> None:
        place = self._place(file.path)
        if file.path in self._certificates:
            self._add_certificates(self._certificates[file.path], place)
        if file.is_signed:
            if file.listed is None:
                raise MalformedError(file.signature_error or "its signatures cannot be read")
            _material.add_signatures(
                self.assets, file.data, file.listed.signers, place, self._issuers
            )
        if _REQUEST in file.labels:
            _material.add_request(self.assets, CertificateRequest.from_pem(file.data), place)
        if file.is_revocation_list:
            crl = RevocationList.from_pem(file.data)
            _material.add_list(self.assets, crl, place, self._issuers)
        if "PUBLIC KEY" in file.labels:
            for _, der in unpem(file.data, "public key"):
                _material.add_public_key(self.assets, der, place)
        if file.is_private_key or is_reference(file.data):
            self._add_private_key(file, place)
        elif not file.labels and file.data[:1] == b"\x30" and not file.is_signed:
            self._add_binary(file, place)

    def _add_certificates(self, found: CertificateFile, place: str) -> None:
        for each in found.certificates:
            _material.add_certificate(self.assets, each, place, self._issuers)
        self.unread += [(found.path, reason) for reason in found.reasons]

    def _add_binary(self, file: File, place: str) -> None:
        if file.path in self._binary:
            certificate = self._binary[file.path]
            _material.add_certificate(self.assets, certificate, place, self._issuers)
            return
        try:
            crl = RevocationList.from_der(file.data)
        except PqsecError:
            try:
                request = CertificateRequest.from_der(file.data)
            except PqsecError:
                raise MalformedError("DER of a kind that is not known here", hint=_HINT) from None
            _material.add_request(self.assets, request, place)
        else:
            _material.add_list(self.assets, crl, place, self._issuers)

    def _add_private_key(self, file: File, place: str) -> None:
        if is_reference(file.data):
            spki = self._spki_beside(file.path)
            _material.add_private_key(self.assets, place, spki, None, elsewhere=True)
            return
        found = file.private_key
        if found.reason:
            # After a colon it could quote the key.
            raise MalformedError(found.reason.partition(":")[0])
        encryption = None
        if is_encrypted(file.data):
            blocks = [der for label, der in unpem(file.data, "key") if "ENCRYPTED" in label]
            encryption = _material.encryption_of(blocks[0]) if blocks else None
        spki = found.spki or self._spki_beside(file.path)
        _material.add_private_key(self.assets, place, spki, encryption)

    def _spki_beside(self, path: Path) -> bytes | None:
        """The public key of an encrypted private key, by the certificate that belongs to it.

        `x.key.pem` belongs to `x.cert.pem` here or in `../public`. `x.alt.key.pem` belongs to
        `x.alt.cert.pem`, else it is the alternative key of `x.cert.pem`.
        """
        if not path.name.endswith(KEY):
            return None
        stem = path.name.removesuffix(KEY)
        folders = (path.parent, path.parent.parent / "public")
        for folder in folders:
            if found := self._first(folder / f"{stem}{CERTIFICATE}"):
                return found.spki
        if path.name.endswith(ALT_KEY):
            for folder in folders:
                found = self._first(folder / f"{path.name.removesuffix(ALT_KEY)}{CERTIFICATE}")
                if found and found.alternative_spki:
                    return found.alternative_spki
        return None

    def _first(self, path: Path) -> Certificate | None:
        found = self._certificates.get(path)
        return found.first if found else None

    def _participants(self) -> Iterator[tuple[Certificate, str, Profile | None]]:
        """Certificates, their places, and the profiles of their sets of credentials."""
        for file in self._inventory.certificates:
            profile = self._inventory.profile_of(file.path)
            for each in file.certificates:
                if not each.is_self_issued:
                    yield each, self._place(file.path), profile

    def _domain_rules(self) -> Iterator[tuple[DomainRule, str]]:
        for document in self._inventory.documents:
            if isinstance(document, GovernanceFile):
                for rule in document.domain_rules:
                    yield rule, self._place(document.path)

    def _place(self, path: Path) -> str:
        """`path` below what the user named; with that, if the user named several."""
        for root in self._paths:
            if path.is_relative_to(root):
                inner = path.relative_to(root)
                shown = Path(path.name) if inner == Path() else inner
                return text_of(path if len(self._paths) > 1 else shown)
        return text_of(path)


def _binary_certificates(files: Iterable[File]) -> Iterator[tuple[Path, Certificate]]:
    for file in files:
        if not file.labels and file.data[:1] == b"\x30":
            try:
                yield file.path, Certificate.from_der(file.data)
            except PqsecError:
                continue


def text_of(path: Path) -> str:
    """The path as text that UTF-8 can write, whatever bytes are in it."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")
