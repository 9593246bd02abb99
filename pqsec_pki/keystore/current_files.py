"""The files that leave a keystore: those that the newest lines of its ledger are about.

A file in its place may be an older one: another machine with this ledger wrote a newer one, or
somebody put an earlier copy back, whose signatures are as valid. So everything that writes
bundles, exports and answers, or shows the CAs to trust, gets the files here. Older ones come
from the ledger's database, or are refused.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.certificates import RevocationList
from pqsec_pki.credentials import TrustAnchors, certificates_in, only_list
from pqsec_pki.errors import FileError, KeystoreError, PqsecError, VerificationError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._fetched_files import WAYS_OUT
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._replaced_cas import expected_cas
from pqsec_pki.keystore._shared_files import (
    LedgerFile,
    digest_of,
    newest_governance,
    newest_list,
    newest_of,
)
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import enclave_files
from pqsec_pki.problems import Code

_CAS = (layout.IDENTITY_CA, layout.PERMISSIONS_CA, layout.PERMISSIONS_ALT_CA)
_LIST = layout.LIST_TARGET[layout.LIST]
_PLACES = {
    **layout.CA_TARGETS,
    **layout.ALT_TARGET,
    **layout.LIST_TARGET,
    layout.GOVERNANCE: f"{layout.ENCLAVES}/{layout.GOVERNANCE}",
}
"""Where the files are that enclaves link to."""
_NAMES = {"participant": "certificate", "crl": "revocation list"}
"""What a file is, if its line has another word."""
_COPY = "copy it from the machine that made it: docs/how-to/postgresql.md"


@dataclass(frozen=True, slots=True)
class CurrentFiles:
    """The current files of a keystore, by its open ledger."""

    keystore: Keystore
    ledger: Ledger = field(repr=False)
    linked: dict[str, bytes] = field(default_factory=dict, repr=False)
    """The files that enclaves share, as of `enclave_files`."""
    _placed: Mapping[str, Entry] = field(default_factory=dict, repr=False)
    """The permissions that were signed by hand, by their folders."""
    _shared: dict[str, bytes] = field(default_factory=dict, repr=False)

    @classmethod
    @contextmanager
    def of(cls, keystore: Keystore) -> Iterator[Self]:
        """Those of `keystore`; errors as of `Keystore.open_ledger`."""
        with keystore.open_ledger() as ledger:
            yield cls.within(keystore, ledger)

    @classmethod
    def within(cls, keystore: Keystore, ledger: Ledger) -> Self:
        """Those of the set `keystore`, by the ledger that was opened for it or another set."""
        own = ledger.of(keystore.set_name)
        return cls(keystore, own, _placed=own.placed("permissions"))

    @classmethod
    @contextmanager
    def if_readable(cls, keystore: Keystore) -> Iterator[Self | None]:
        """Like `of`; None for a user who may not read the ledger, and so cannot compare."""
        try:
            ledger = keystore.open_ledger()
        except FileError:
            yield None
            return
        with ledger:
            yield cls.within(keystore, ledger)

    @property
    def anchors(self) -> TrustAnchors:
        """The CAs that the participants trust, without a list; errors as of `shared`."""
        found = {each: data for each, data in self.shared.items() if each in _CAS}
        return TrustAnchors.of(found, folder=str(self.keystore.folder / layout.PUBLIC))

    @property
    def revocation_list(self) -> RevocationList | None:
        """The identity CA's newest list; None if there is none. Errors as of `shared`."""
        data = self.shared.get(layout.LIST)
        return only_list(data, str(self.keystore.revocation_list_path)) if data else None

    @property
    def shared(self) -> Mapping[str, bytes]:
        """The files that all enclaves share, by their names there.

        KeystoreError for a file that is older than the newest, or missing, and not in the database;
        VerificationError for one of which the ledger has no line.
        """
        if not self._shared:
            self._shared.update(self._found())
        return self._shared

    def enclave(self, name: str) -> dict[str, bytes]:
        """The files of that participant, by their names, as `enclave_files`; its keys too.

        Errors as of `enclave_files` and `shared`.
        """
        return self._chosen(name, enclave_files(self.keystore.folder, name, self.linked))

    def refuse_others(self, name: str, here: Mapping[str, bytes]) -> None:
        """KeystoreError unless `here`, the `public_files` of the participant, are the current ones.

        It reads none of them again: what was compared is what the caller uses.
        """
        folder = self.keystore.folder / layout.enclave_folder(name)
        for file, data in self._chosen(name, here).items():
            self._refuse_other(folder / file, here.get(file), data)

    def refuse_others_of_all(self) -> None:
        """KeystoreError unless the files that enclaves link to are the current ones."""
        for file, data in self.shared.items():
            path = self.keystore.folder / _PLACES[file]
            self._refuse_other(path, read(path) if exists(path) else None, data)

    def newer_elsewhere(self) -> dict[Path, bytes]:
        """The content that files of all participants should have, by their paths, if they have
        another; errors as of `shared`."""
        places = {self.keystore.folder / _PLACES[file]: data for file, data in self.shared.items()}
        return {
            path: data for path, data in places.items() if not exists(path) or read(path) != data
        }

    def _refuse_other(self, path: Path, here: bytes | None, current: bytes) -> None:
        if here == current:
            return
        if self.keystore.ledger_address:
            raise KeystoreError(
                f"{path} is not the current one: another machine made that",
                hint="`pqsec ca recover` gets it",
            )
        raise KeystoreError(
            f"{path} is not the current one, which {layout.PUBLIC}/ or {layout.ENCLAVES}/ has",
            hint="put the link to that in its place, as other participants have it",
        )

    def _chosen(self, name: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
        others = {file: data for file, data in files.items() if file not in {*_CAS, layout.LIST}}
        found = {**others, **self.shared}
        folder = self.keystore.folder / layout.enclave_folder(name)
        if not (folder / layout.GOVERNANCE).is_symlink():
            found[layout.GOVERNANCE] = self._own_governance(name, files[layout.GOVERNANCE])
        for wanted in self._own(name):
            found[wanted.file] = self._content(wanted, files.get(wanted.file))
        return found

    def _found(self) -> Iterator[tuple[str, bytes]]:
        yield from self._cas()
        if governance := newest_governance(self.ledger):
            yield layout.GOVERNANCE, self._content(governance)
        wanted = newest_list(self.ledger)
        if wanted:
            yield layout.LIST, self._content(wanted)
        elif exists(path := self.keystore.folder / _LIST):
            raise KeystoreError(
                f"{path} exists, but by the ledger its CA has no list now",
                hint="remove it, or issue a list: `pqsec ca crl`",
            )

    def _cas(self) -> Iterator[tuple[str, bytes]]:
        expected = expected_cas(self.ledger, self.keystore.profile)
        for file in _CAS:
            path = self.keystore.folder / layout.PUBLIC / file
            data = read(path) if expected.get(file) or exists(path) else b""
            found = [each.fingerprint for each in certificates_in(data, str(path))] if data else []
            if found != expected.get(file, []):
                raise KeystoreError(
                    f"{path} does not have the CA certificates that the ledger has:"
                    f" {_few(found)} instead of {_few(expected.get(file, []))}",
                    hint=self._way_out_of_cas(),
                )
            if data:
                yield file, data

    def _way_out_of_cas(self) -> str:
        if self.keystore.ledger_address:
            return (
                "copy public/ and private/ from the machine where `pqsec ca rotate` ran:"
                " docs/how-to/postgresql.md"
            )
        return "restore it from a backup: whoever trusts that file trusts another CA"

    def _own(self, name: str) -> Iterator[LedgerFile]:
        """The participant's certificate and permissions by the ledger."""
        own = [*newest_of(self.ledger, name, self._placed)]
        if not own:
            raise KeystoreError(
                f"the ledger has no certificate for {name}",
                hint="move its folder out of enclaves/; or restore the ledger from a backup, if it"
                " was issued here",
            )
        return iter(own)

    def _own_governance(self, name: str, data: bytes) -> bytes:
        """A participant's own copy, as adopted keystores have them: the shared one or its own."""
        if data == self.shared.get(layout.GOVERNANCE):
            return data
        sha256 = digest_of(layout.GOVERNANCE, data)
        if not any(each.sha256 == sha256 for each in self.ledger.of_name("governance", name)[-1:]):
            folder = self.keystore.folder / layout.enclave_folder(name)
            raise KeystoreError(
                f"{folder / layout.GOVERNANCE} is not a governance that the ledger has for {name}",
                hint="put a link to that of the keystore in its place",
            )
        return data

    def _content(self, wanted: LedgerFile, here: bytes | None = None) -> bytes:
        """The content of the file in its place, if it is not older; else that of the database.

        `here` is what the file has, if it was read before.
        """
        path = self.keystore.folder / wanted.folder / wanted.file
        if here is None and exists(path):
            here = read(path)
        if here is not None and self._is_current(wanted, here):
            return here
        kept = {} if wanted.stays else self.keystore.kept({wanted.sha256})
        if (found := wanted.in_(kept)) is not None:
            return found
        raise self._refused(wanted, path, here)

    def _is_current(self, wanted: LedgerFile, data: bytes) -> bool:
        """Whether it is that file, or one of a newer line: `pqsec sign` may name its line else."""
        sha256 = digest_of(wanted.file, data) or ""
        if sha256 == wanted.sha256:
            return True
        newest = self.ledger.line_of((wanted.kind,), wanted.sha256)
        return wanted.is_document and self.ledger.line_of((wanted.kind,), sha256) > newest

    def _refused(self, wanted: LedgerFile, path: Path, here: bytes | None) -> PqsecError:
        """KeystoreError for an older file, VerificationError for one that the ledger lacks."""
        what = _NAMES.get(wanted.kind, wanted.kind)
        line, hint = self.ledger.line_of((wanted.kind,), wanted.sha256), self._way_out(wanted)
        if here is None:
            words = f"{path} is missing: the ledger has a {what} in line {line}"
            return KeystoreError(words, hint=hint)
        words = f"{path} is not the newest {what} that the ledger has"
        sha256 = digest_of(wanted.file, here) or ""
        if older := self.ledger.line_of((wanted.kind,), sha256):
            return KeystoreError(
                f"{words}: it is that of line {older}, not of line {line}", hint=hint
            )
        words = f"{words}: no line of the ledger has it"
        return VerificationError(words, code=Code.CONTENT_CHANGED, hint=hint)

    def _way_out(self, wanted: LedgerFile) -> str:
        name, elsewhere = wanted.name, self.keystore.ledger_address is not None
        if name and elsewhere:
            return (
                f"work there; or issue it here: `pqsec issue {name} --force`, with all its rights"
            )
        if name:
            return f"restore that file, or issue it again: pqsec issue {name} --force ..."
        return f"{_COPY}. Or {WAYS_OUT[wanted.kind]}" if elsewhere else WAYS_OUT[wanted.kind]


def _few(fingerprints: list[str]) -> str:
    return " and ".join(each[:16] for each in fingerprints) or "none"
