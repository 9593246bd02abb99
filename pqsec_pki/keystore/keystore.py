"""A keystore: created once by `ca init`, and opened by every later command."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from datetime import datetime, timedelta
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Self

from pqsec_pki import credentials
from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import (
    disk_errors,
    exists,
    read,
    read_within,
    real_path,
    refuse_without_links,
)
from pqsec_pki.algorithms import PrivateKey, Profile, is_encrypted
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.credentials import CA_FILES, NEEDED, Credentials, TrustAnchors
from pqsec_pki.documents import DomainSet, Governance
from pqsec_pki.errors import (
    ExistsError,
    FileError,
    InterruptedChangeError,
    KeystoreError,
    MissingError,
    located,
    shown,
)
from pqsec_pki.keystore import _journal, _settings, _shared, layout
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore._chain import Entry, Line
from pqsec_pki.keystore._file_store import FileStore
from pqsec_pki.keystore._folder import Folder
from pqsec_pki.keystore._gitignore import GITIGNORE, keystore_ignored
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.authorities import Authorities, unlock
from pqsec_pki.keystore.ca_keys import SigningCa, ca_key_files, read_ca_key
from pqsec_pki.keystore.groups import read_groups
from pqsec_pki.keystore.heads import compared
from pqsec_pki.keystore.participant import (
    enclave_files,
    load_first_certificate,
    load_participant,
    load_revocation_list,
    refuse_unknown,
)
from pqsec_pki.keystore.patterns import GROUP, expanded, is_several
from pqsec_pki.keystore.sets import created, stage_cas, stage_governance, together
from pqsec_pki.keystore.stock import stock_of
from pqsec_pki.tokens import Pin, is_reference, uri_in, without_pin

if TYPE_CHECKING:
    from pqsec_pki.approvals import ApprovalPolicy, Covered


@dataclass(frozen=True, slots=True)
class Keystore:
    """One set of credentials of the keystore in the folder `root`, which has one or more.

    Each set has CAs, a governance and enclaves of one profile. All share the ledger, the journal,
    the settings and the default domains. `sets` has a value for each of them.
    """

    root: Path
    """The folder with the settings, the journal and, in its `private/`, the ledger."""
    profiles: tuple[Profile, ...]
    """Those of all sets, that of the first one first."""
    domains: DomainSet
    """Domains of participants that are not issued for other domains."""
    to_change: bool = field(default=False, compare=False, repr=False)
    """Whether it was opened for changes; otherwise nothing is written in it."""
    approved: bool = field(default=False, compare=False, repr=False)
    """Whether what is done with this value was approved by the people that the policy wants."""

    set_name: str = layout.FIRST
    """Which set this is: empty for the first one, otherwise the name of its profile."""
    is_as_found: bool = field(default=False, compare=False, repr=False)
    """Whether its ledger is read as it is: nothing may be decided by it."""

    @classmethod
    def create(  # noqa: PLR0913 -- each is a choice of the user's, and all by name
        cls,
        root: Path,
        *profiles: Profile,
        name: str,
        domains: DomainSet,
        validity: timedelta,
        passphrase: bytes | None,
        keys: Mapping[str, PrivateKey] | None = None,
        ledger: LedgerAddress | None = None,
        gitignore: bool = False,
        now: datetime,
    ) -> Self:
        """Create two CAs and a signed default governance for each profile in the folder `root`.

        `keys` are CA keys that are there already, by the names of `ca_key_places`.
        The ledger begins in the database at `ledger` [default: in a file of the keystore]. With
        `gitignore`, for a keystore that a user keeps, a `.gitignore` leaves its secrets out of git.

        ExistsError if a keystore is there already: CA keys are never overwritten. UsageError for
        domains that stacks read differently, and for a profile that is given twice.
        """
        cls.refuse_occupied(root)
        refuse_without_links(root, "a keystore", hard=True)
        settings = _settings.settings_file(profiles, domains, ledger)
        made = cls(root, profiles, domains, to_change=True)
        authorities = created(profiles, name, now=now, validity=validity, keys=keys)
        governance = Governance.protected(domains).to_xml()
        with _journal.change(root, address=ledger) as transaction:
            cls.refuse_occupied(root)
            transaction.refuse_lines()
            transaction.authorities = authorities
            for each in authorities.sets:
                part = transaction.of(each.set_name)
                stage_cas(part, each, passphrase, now)
                stage_governance(part, each, governance, now=now)
            beside = transaction.folder(".", private=False)
            beside.public(layout.SETTINGS, settings)
            if gitignore:
                beside.public(GITIGNORE, keystore_ignored(root))
        return made

    @classmethod
    def open(cls, root: Path, *, to_change: bool = False) -> Self:
        """Open the keystore at `root`; KeystoreError if there is none.

        Opening it for reading writes nothing: InterruptedChangeError if a change is unfinished.
        With `to_change` that change is finished first; KeystoreError if another user owns the
        keystore or may write there.
        """
        if to_change:
            _journal.recover(root)
        else:
            _journal.refuse_interrupted(root)
        path = root / layout.SETTINGS
        with disk_errors(path):
            there = path.is_file()
        if not there:
            raise _not_a_keystore(root)
        if to_change:
            _journal.check(root)
        profiles, domains = _settings.read_settings(path)
        return cls(root, profiles, domains, to_change)

    @classmethod
    def find(cls, root: Path, *, to_change: bool = False) -> Self | None:
        """Like `open`, but None if the folder `root` has no part of a keystore."""
        try:
            return cls.open(root, to_change=to_change)
        except KeystoreError as error:
            if isinstance(error, InterruptedChangeError) or _parts_in(root):
                raise
            return None

    @staticmethod
    def recover(root: Path) -> bool:
        """Finish an interrupted change of the keystore at `root`; True if there was one.

        Then get the governance and the list that other machines with its ledger wrote.
        KeystoreError if there is no keystore, or another user owns it or may write there.
        """
        finished = _journal.recover(root)
        if Keystore.open(root, to_change=True).ledger_address:
            with _journal.change(root):
                pass  # each change begins with these files
        return finished

    @staticmethod
    def refuse_occupied(root: Path) -> None:
        """ExistsError if the folder `root` has any part of a keystore already."""
        if taken := _parts_in(root):
            hint = "CA keys are never overwritten: choose another folder"
            if _journal.is_interrupted(root):
                hint = (
                    f"a killed command began it: `pqsec -k {quote(str(root))} ca recover` ends that"
                )
            raise ExistsError(f"{root} already has {', '.join(taken)}", hint=hint)

    @property
    def profile(self) -> Profile:
        """The profile of this set."""
        return next(
            (each for each in self.profiles if each.name == self.set_name), self.profiles[0]
        )

    @property
    def folder(self) -> Path:
        """The folder with this set's `public/`, `private/` and `enclaves/`."""
        return self.root / layout.in_set(self.set_name, "")

    @property
    def sets(self) -> tuple[Self, ...]:
        """The sets of this keystore, the first one first, each as a value like this one."""
        names = (layout.FIRST, *(each.name for each in self.profiles[1:]))
        return tuple(replace(self, set_name=each) for each in names)

    def of_profile(self, name: str) -> Self:
        """The set of the profile called `name`; KeystoreError if there is none."""
        for each in self.sets:
            if each.profile.name == name:
                return each
        known = ", ".join(each.name for each in self.profiles)
        raise KeystoreError(f"the keystore has no set of profile {shown(name)}: it has {known}")

    @property
    def identity_ca(self) -> Certificate:
        """The identity CA's certificate."""
        return load_first_certificate(self.folder / layout.PUBLIC / layout.IDENTITY_CA)

    @property
    def permissions_ca_path(self) -> Path:
        """The path of the permissions CA's certificate."""
        return self.folder / layout.PUBLIC / layout.PERMISSIONS_CA

    @property
    def permissions_ca(self) -> Certificate:
        """The permissions CA's certificate."""
        return load_first_certificate(self.permissions_ca_path)

    @property
    def countersigner(self) -> Certificate | None:
        """The certificate of the permissions CA's countersigner, if the profile has one."""
        path = self.folder / layout.PUBLIC / layout.PERMISSIONS_ALT_CA
        return load_first_certificate(path) if exists(path) else None

    @property
    def anchors(self) -> TrustAnchors:
        """The CAs that the participants trust, and their revocation list.

        MalformedError for an invalid file of the CAs.
        """
        public = self.folder / layout.PUBLIC
        there = [each for each in CA_FILES if each in NEEDED or exists(public / each)]
        anchors = TrustAnchors.of({each: read(public / each) for each in there}, folder=str(public))
        return replace(anchors, revocation_list=self.revocation_list)

    @property
    def issuing_cas(self) -> TrustAnchors:
        """The CAs that issue and sign, each the first one in its file."""
        return TrustAnchors(
            identity_cas=(self.identity_ca,),
            permissions_ca=self.permissions_ca,
            countersigner=self.countersigner,
        )

    @property
    def governance(self) -> bytes:
        """The signed governance document."""
        return read(self.folder / layout.ENCLAVES / layout.GOVERNANCE)

    @property
    def revocation_list(self) -> RevocationList | None:
        """The identity CA's revocation list; None if there is none."""
        return load_revocation_list(self.revocation_list_path) if self.has_revocation_list else None

    @property
    def has_revocation_list(self) -> bool:
        """Whether there is a revocation list, readable or not."""
        return exists(self.revocation_list_path)

    @property
    def revocation_list_path(self) -> Path:
        """The path of the revocation list; each enclave links to it as crl.pem."""
        return self.folder / layout.PUBLIC / layout.CA_LIST

    @contextmanager
    def hold(self, *, keep_connection: bool = False) -> Iterator[None]:
        """Lock the keystore against other commands; the holder may make any number of changes.

        KeystoreError if another command locks it for half a minute. With `keep_connection`, the
        connection to the ledger's database stays open for the next lock.
        """
        with _journal.hold(self.root, keep_connection=keep_connection):
            yield

    @property
    def head(self) -> str:
        """The chain value of the ledger's last line; every change gives another value."""
        with self.open_ledger() as ledger:
            return ledger.head

    def unlock(
        self,
        passphrase: bytes | None,
        pin: Pin | None = None,
        cas: Collection[SigningCa] = (),
        *,
        without: Collection[str] = (),
    ) -> Authorities:
        """The CAs with their private keys; PassphraseError if `passphrase` or a PIN is wrong.

        `pin` gives the PIN of a token [default: only files that the keys' URIs name]. With `cas`,
        only their keys are read, and can sign; those of others may be on another machine. Those of
        the sets called `without` are not read either: they may be lost.
        """
        found = [
            unlock(
                each.folder,
                each.profile,
                passphrase,
                pin,
                () if each.set_name in without else cas or tuple(SigningCa),
                set_name=each.set_name,
            )
            for each in self.sets
        ]
        return together(found)

    def is_locked(self, cas: Collection[SigningCa] = (), *, without: Collection[str] = ()) -> bool:
        """Whether a key of `cas`, or of any CA, is encrypted; an adopted keystore may have one.

        Those of the sets called `without` are not read.
        """
        read = (each for each in self.sets if each.set_name not in without)
        return any(is_encrypted(data) for each in read for data in _ca_keys(each, cas).values())

    def has_keys_in_files(self, *, without: Collection[str] = ()) -> bool:
        """Whether a key of a CA, of the sets not called `without`, is in a file: under a passphrase
        that those of all sets have."""
        read = (each for each in self.sets if each.set_name not in without)
        return not all(is_reference(data) for each in read for data in _ca_keys(each, ()).values())

    def has_key_files(self, ca: SigningCa) -> bool:
        """Whether all keys of `ca` are in files here, and not in a token or on another machine."""
        try:
            files = [data for each in self.sets for data in _ca_keys(each, (ca,)).values()]
        except (FileError, KeystoreError):
            return False
        return not any(map(is_reference, files))

    def key_uris(self, cas: Collection[SigningCa] = ()) -> dict[str, str]:
        """The URIs of the keys of `cas`, or of all CAs, that are not in files, by file name.

        MalformedError for a damaged reference; other errors as of `read_ca_key`.
        """
        found = {}
        for name, data in _ca_keys(self, cas).items():
            with located(self.folder / layout.PRIVATE / name):
                if is_reference(data):
                    found[name] = without_pin(uri_in(data))
        return found

    def names(self) -> list[str]:
        """The participants' names, sorted; FileError if a folder cannot be read."""
        return layout.names_in(self.folder)

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """The members of each group of the domain file that was applied last.

        Errors as of `read_groups`.
        """
        return read_groups(self.root)

    @property
    def approvals(self) -> "ApprovalPolicy | None":
        """Whose approvals changes need, by the ledger; None if they need none.

        KeystoreError if the line is damaged.
        """
        with self.open_ledger() as ledger:
            if not ledger.newest("approvals"):
                return None
            from pqsec_pki.keystore.approving import policy_of  # noqa: PLC0415 -- few have some

            return policy_of(ledger)

    @property
    def stock(self) -> tuple[str, ...]:
        """Names and patterns of participants that may be met with the first set of credentials.

        By the ledger, where `pqsec apply` puts those of the domain file; all others are met with
        the strongest set only.
        """
        with self.open_ledger() as ledger:
            return stock_of(ledger)

    def refuse_unapproved(self, *kinds: "Covered") -> None:
        """KeystoreError if changes of these kinds need approvals, and were not approved."""
        policy = None if self.approved else self.approvals
        if policy:
            policy.refuse(kinds)

    def named(self, names: Iterable[str], known: Sequence[str] | None = None) -> list[str]:
        """The names, each once; for a pattern or a group those of `known` that it stands for.

        `known` is [default: the participants]. Errors as of `expanded` and `read_groups`.
        """
        given = list(names)
        if known is None:
            known = self.names() if any(map(is_several, given)) else ()
        has_groups = any(each.startswith(GROUP) for each in given)
        return expanded(given, known, self.groups if has_groups else {})

    def names_of_all(self) -> list[str]:
        """`names`, and then the enclaves with files but no certificate; FileError likewise."""
        names, incomplete = layout.enclaves_in(self.folder)
        return [*names, *incomplete]

    def has(self, name: str) -> bool:
        """Whether there is any file of a participant called `name`."""
        return layout.is_there(self.folder, layout.enclave_name(name))

    def has_key(self, name: str) -> bool:
        """Whether the private key of the participant called `name` is in the keystore.

        It is not if the robot has it, or a token.
        """
        path = self._enclave(name) / layout.KEY
        return exists(path, follow=False) and layout.KEY not in self.keys_outside(name)

    def keys_outside(self, name: str) -> frozenset[str]:
        """The names of the files of that participant that refer to a key in a token.

        Not of those that cannot be read.
        """
        folder, found, root = self._enclave(name), set(), real_path(self.folder)
        for each in layout.KEYS:
            with suppress(FileError):
                if is_reference(read_within(root, folder / each, follow=False)):
                    found.add(each)
        return frozenset(found)

    def _enclave(self, name: str) -> Path:
        return self.folder / layout.enclave_folder(layout.enclave_name(name))

    def refuse_unknown(self, name: str) -> None:
        """KeystoreError if there is no participant called `name`, or it has no certificate."""
        name = layout.enclave_name(name)
        if self.elsewhere([name]):
            raise KeystoreError(
                f"the files of {name} are on another machine with this ledger",
                hint=f"work there; or issue it here: `pqsec issue {name} --force`, with all its"
                " rights",
            )
        refuse_unknown(self.folder, name)

    def elsewhere(self, names: Iterable[str]) -> list[str]:
        """The participants of these whose files another machine with the same ledger has."""
        missing = [name for name in map(layout.enclave_name, names) if not self.has(name)]
        if not missing or not self.ledger_address:
            return []
        with self.open_ledger() as ledger:
            return [row[0] for row in ledger.participants(missing)]

    def participant(self, name: str, passphrase: bytes | None = None) -> Credentials:
        """The participant called `name`; KeystoreError if there is none."""
        return load_participant(self.folder, layout.enclave_name(name), passphrase)

    def verified(
        self, name: str, passphrase: bytes | None = None, *, now: datetime
    ) -> "credentials.VerifiedCredentials":
        """The credentials of the participant called `name`, verified at `now`.

        Verified twice: with the CAs of its enclave, as its own stack does, and with those of the
        keystore. Its private keys may be missing. VerificationError lists everything that is
        wrong; KeystoreError if there is no such participant, or a file is missing;
        PassphraseError for an encrypted key without `passphrase`.
        """
        name = layout.enclave_name(name)
        folder = self.folder / layout.enclave_folder(name)
        files = enclave_files(self.folder, name)
        found = Credentials.of(name, files, passphrase, folder=folder)
        credentials.verify_credentials(found, now=now)
        return credentials.verify_credentials(replace(found, anchors=self.anchors), now=now)

    def ledger(self) -> list[Entry]:
        """Everything that was ever issued, signed or revoked here, oldest first."""
        return [line.entry for line in self.lines()]

    def lines(self) -> list[Line]:
        """The ledger's lines with their chain, oldest first."""
        with self.open_ledger() as ledger:
            return list(ledger.lines())

    @property
    def ledger_address(self) -> LedgerAddress | None:
        """The address of the ledger, if it is not in a file of this keystore."""
        return _settings.read_ledger(self.root / layout.SETTINGS)

    def kept(self, wanted: Collection[str]) -> dict[str, bytes]:
        """The files with these SHA-256 that the ledger's database keeps; none without a database.

        KeystoreError if it does not answer, or its role may not read them.
        """
        with (
            disk_errors(self.root),
            Folder.opened(self.root) as root,
            _shared.reading(self.root, root) as database,
        ):
            return database.kept(wanted) if database else {}

    def open_ledger(self) -> Ledger:
        """The ledger, for this package's modules.

        KeystoreError if it lacks lines of which the CAs signed the newest head (`heads.compared`):
        what a ledger from before says is not decided by. `as_found` opens it all the same.
        """
        if self.is_as_found:
            return self._read_ledger()
        return compared(self.root, self._read_ledger)

    @property
    def as_found(self) -> Self:
        """This keystore, to show what its ledger says although the CAs signed something else."""
        return replace(self, is_as_found=True)

    def _read_ledger(self) -> Ledger:
        with (
            _told_of_private(),
            disk_errors(self.root / layout.PRIVATE),
            Folder.opened(self.root) as root,
            root.below(layout.PRIVATE) as private,
            _shared.reading(self.root, root) as database,
        ):
            return Ledger(database or FileStore(private), self.set_name)


def _ca_keys(keystore: Keystore, cas: Collection[SigningCa]) -> dict[str, bytes]:
    """The files of the keys of `cas`, or of all CAs of that set, by their names."""
    private = keystore.folder / layout.PRIVATE
    return {name: read_ca_key(private / name) for name in ca_key_files(keystore.profile, cas)}


@contextmanager
def _told_of_private() -> Iterator[None]:
    """Adds to a MissingError how to get the folder of the CA keys and the ledger."""
    try:
        yield
    except MissingError as error:
        error.hint = error.hint or (
            "private/ has the ledger and the CA keys, and git leaves it out: restore it from a"
            " backup, or use the keystore itself instead of this copy"
        )
        raise


def _not_a_keystore(root: Path) -> KeystoreError:
    """The error for a folder that has no settings, or is not there."""
    if not exists(root):
        hint = f"`pqsec -k {quote(str(root))} ca init` creates a keystore there; -k names another"
        return KeystoreError(f"{root} does not exist", hint=hint)
    hint = "make one with `pqsec ca init`, or name another with -k"
    parts, place = _parts_in(root), quote(str(root))
    if parts == [layout.ENCLAVES]:
        hint = f"what `pqsec install` wrote on a robot is not one: `pqsec check {place}` checks it"
    elif parts:
        hint = f"restore {layout.SETTINGS} from a backup, or `pqsec adopt {place}`"
    return KeystoreError(f"{root} is not a pqsec keystore: it has no {layout.SETTINGS}", hint=hint)


def _parts_in(root: Path) -> list[str]:
    """The parts of a keystore in the folder `root`; `ca init` refuses to overwrite them."""
    parts = (layout.SETTINGS, layout.PRIVATE, layout.PUBLIC, layout.ENCLAVES, layout.SETS)
    with disk_errors(root):
        return [name for name in parts if (root / name).exists()]
