"""The CAs of a keystore with their private keys, for issuing and signing."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import PrivateKey, Profile, PublicKey, SignatureAlgorithm
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._entries import certificate_entry
from pqsec_pki.keystore._settings import set_names
from pqsec_pki.keystore._transaction import StagedFolder
from pqsec_pki.keystore.ca_keys import SigningCa, ca_key_files, key_algorithms, load_ca_key
from pqsec_pki.keystore.participant import load_first_certificate
from pqsec_pki.smime import Signer, sign
from pqsec_pki.tokens import Pin, key_file

Done = TypeVar("Done")
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, eq=False)
class _ClosedKey(PrivateKey):
    """The key of a CA that was not opened; its file was not read, and need not exist."""

    def sign(self, data: bytes) -> bytes:
        """KeystoreError: a command opens the keys that it signs with."""
        del data
        raise KeystoreError("the CA's private key was not opened")

    @classmethod
    def of(cls, public: PublicKey) -> Self:
        """The closed key with that public key."""
        return cls(public.algorithm, public, None)


@dataclass(frozen=True, slots=True, eq=False)
class Authorities:
    """The identity CA, the permissions CA, and the permissions CA's countersigner.

    The two CAs always have different keys: with one CA for both roles, a participant's key
    could sign permissions (CVE-2023-24010).
    """

    identity: Authority
    permissions: Authority
    countersigner: Authority | None
    """The ML-DSA half of the permissions CA. It has its own certificate, which documents need
    not carry: they are sent in every handshake."""
    embed_certificate: bool
    set_name: str = layout.FIRST
    """The set of credentials that they are for."""
    others: tuple["Authorities", ...] = ()
    """The CAs of the further sets; only those of the first set have them."""
    compares_clock: bool = False
    """Whether `now` is what this machine's clock says, as in all commands: then nothing is signed
    if the keystore says that it is wrong (`signing_clock`)."""

    @classmethod
    def create(
        cls,
        profile: Profile,
        name: str,
        *,
        now: datetime,
        validity: timedelta,
        keys: Mapping[str, PrivateKey] | None = None,
    ) -> Self:
        """Create the profile's CAs, named `name` Identity CA and `name` Permissions CA.

        `keys` are those that are there already, by the names of their files; UsageError if one of
        them is not of the profile's algorithm, or two are the same.
        """
        wanted, there = key_algorithms(profile), dict(keys or {})
        _refuse_unfit(wanted, there)
        found = {key: there.get(key) or row.generate() for key, row in wanted.items()}
        second, signing = profile.alternative_key, f"{name} Permissions CA".strip()

        def make(name: str, key: str, other: str = "") -> Authority:
            return Authority.self_signed(
                name, found[key], found.get(other), now=now, validity=validity
            )

        return cls(
            identity=make(
                f"{name} Identity CA".strip(), layout.IDENTITY_KEY, layout.IDENTITY_ALT_KEY
            ),
            permissions=make(signing, layout.PERMISSIONS_KEY),
            countersigner=make(f"{signing} {second.name}", layout.PERMISSIONS_ALT_KEY)
            if second
            else None,
            embed_certificate=profile.runs_in_stock,
        )

    @property
    def sets(self) -> tuple["Authorities", ...]:
        """The CAs of each set, in the order of `Keystore.sets`."""
        return (self, *self.others)

    def of(self, set_name: str) -> "Authorities":
        """The CAs of the set called `set_name`; ValueError if it has none."""
        found = [each for each in self.sets if each.set_name == set_name]
        if not found:
            raise ValueError(f"no CAs of the set {set_name}")
        return found[0]

    def with_set(self, new: "Authorities") -> "Authorities":
        """The CAs of all sets, with `new` in place of those of its set."""
        first, *others = (new if each.set_name == new.set_name else each for each in self.sets)
        return replace(first, others=tuple(others))

    @property
    def all(self) -> tuple[Authority, ...]:
        """The CAs of this set."""
        return (self.identity, *self.document_signers)

    @property
    def document_signers(self) -> tuple[Authority, ...]:
        """The CAs that sign the documents of this set."""
        return (self.permissions, *((self.countersigner,) if self.countersigner else ()))

    @property
    def signers(self) -> tuple[Authority, ...]:
        """The CAs that sign heads of the ledger: those that sign documents, of all sets."""
        return tuple(ca for each in self.sets for ca in each.document_signers)

    @property
    def can_sign(self) -> bool:
        """Whether the keys of the signers were opened."""
        return not any(isinstance(each.key, _ClosedKey) for each in self.signers)

    def sign(
        self,
        document: bytes,
        *,
        number: int | None = None,
        now: datetime,
        embed_certificate: bool = False,
    ) -> bytes:
        """The S/MIME file of a document; KeystoreError if a signer has expired.

        `number` is its sequence number, `Transaction.number` [default: none, for what no robot
        installs].
        """
        counter = self.countersigner
        for each in self.document_signers:
            end = each.certificate.not_after
            if now > end:
                name = each.certificate.subject_name
                raise KeystoreError(
                    f"{name} expired on {said(end)}: it can no longer sign",
                    hint="replace the CAs with `pqsec ca rotate`, or correct the clock",
                )
        return sign(
            document,
            Signer(self.permissions.certificate, self.permissions.key),
            countersigner=Signer(counter.certificate, counter.key) if counter else None,
            embed_certificate=self.embed_certificate or embed_certificate,
            number=number,
            now=now,
        )

    def write(
        self,
        public: StagedFolder,
        private: StagedFolder,
        passphrase: bytes | None,
        *,
        trusted: Certificate | None = None,
    ) -> None:
        """Stage the certificates and, encrypted under `passphrase`, the keys.

        `trusted` is another identity CA that participants trust; it is added to the file.
        """
        for name, certificate in _certificates(self):
            second = trusted.pem if trusted and name == layout.IDENTITY_CA else b""
            public.public(name, certificate.pem + second)
        self.write_keys(private, passphrase)

    def write_keys(self, private: StagedFolder, passphrase: bytes | None) -> None:
        """Stage the keys, encrypted under `passphrase`; not encrypted for None."""
        keys = list(_keys(self))
        pems = _each(lambda item: key_file(item[1], passphrase), keys, passphrase)
        for (name, _), pem in zip(keys, pems, strict=True):
            private.private(name, pem)

    def refuse_outdated(self, root: Path) -> None:
        """KeystoreError if the CAs of the keystore at `root` have been replaced, or it has
        other sets now.

        Call it while the keystore is locked.
        """
        if set_names(root) != tuple(each.set_name for each in self.sets):
            raise KeystoreError(
                f"{root} has other sets of credentials meanwhile", hint="run the command again"
            )
        for each in self.sets:
            public = root / layout.in_set(each.set_name, layout.PUBLIC)
            for name, certificate in _certificates(each):
                if load_first_certificate(public / name).der != certificate.der:
                    raise KeystoreError(
                        f"{certificate.subject_name} has been replaced by another CA meanwhile",
                        hint="run the command again",
                    )

    def entries(self, now: datetime) -> Iterator[Entry]:
        """The CAs' entries for the ledger."""
        for name, certificate in _certificates(self):
            kind = "identity-ca" if name == layout.IDENTITY_CA else "permissions-ca"
            yield certificate_entry(kind, certificate.subject_name, certificate, now)


def unlock(  # noqa: PLR0913 -- as `Keystore.unlock` gives them
    folder: Path,
    profile: Profile,
    passphrase: bytes | None,
    pin: Pin | None,
    cas: Collection[SigningCa],
    *,
    set_name: str,
) -> Authorities:
    """The CAs of the set in `folder`; `pin` gives the PINs of tokens.

    Only the keys of `cas` are read; signing with another raises KeystoreError. KeystoreError
    if a file is missing or a key does not fit its certificate, PassphraseError if the keys are
    encrypted and `passphrase` is missing or wrong, or a PIN is.
    """
    names = ca_key_files(profile, cas) if cas else []
    private, public = folder / layout.PRIVATE, folder / layout.PUBLIC
    loaded = _each(lambda name: load_ca_key(private / name, passphrase, pin), names, passphrase)
    keys = dict(zip(names, loaded, strict=True))

    def authority(ca: SigningCa, certificate: str, key: str, second: str = "") -> Authority:
        found = load_first_certificate(public / certificate)
        if ca in cas:
            return Authority(found, keys[key], keys.get(second))
        closed = map(_ClosedKey.of, filter(None, (found.public_key, found.alternative_key)))
        return Authority(found, *closed)

    signing = SigningCa.PERMISSIONS
    authorities = Authorities(
        identity=authority(
            SigningCa.IDENTITY, layout.IDENTITY_CA, layout.IDENTITY_KEY, layout.IDENTITY_ALT_KEY
        ),
        permissions=authority(signing, layout.PERMISSIONS_CA, layout.PERMISSIONS_KEY),
        countersigner=authority(signing, layout.PERMISSIONS_ALT_CA, layout.PERMISSIONS_ALT_KEY)
        if profile.alternative_key
        else None,
        embed_certificate=profile.runs_in_stock,
        set_name=set_name,
    )
    _check_pairs(authorities)
    return authorities


def _each(
    work: Callable[[Item], Done], items: Sequence[Item], passphrase: bytes | None
) -> list[Done]:
    """Like map. With a passphrase in threads: a key takes 600,000 hashes, without Python's lock."""
    if passphrase is None:
        return [work(item) for item in items]
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 -- it loads logging

    with ThreadPoolExecutor() as pool:
        return list(pool.map(work, items))


def _certificates(authorities: Authorities) -> Iterator[tuple[str, Certificate]]:
    yield layout.IDENTITY_CA, authorities.identity.certificate
    yield layout.PERMISSIONS_CA, authorities.permissions.certificate
    if authorities.countersigner:
        yield layout.PERMISSIONS_ALT_CA, authorities.countersigner.certificate


def _keys(authorities: Authorities) -> Iterator[tuple[str, PrivateKey]]:
    yield layout.IDENTITY_KEY, authorities.identity.key
    yield layout.PERMISSIONS_KEY, authorities.permissions.key
    if authorities.identity.alternative_key:
        yield layout.IDENTITY_ALT_KEY, authorities.identity.alternative_key
    if authorities.countersigner:
        yield layout.PERMISSIONS_ALT_KEY, authorities.countersigner.key


def _refuse_unfit(wanted: Mapping[str, SignatureAlgorithm], keys: Mapping[str, PrivateKey]) -> None:
    for name, key in keys.items():
        if key.algorithm is not wanted.get(name):
            raise UsageError(f"{name}: the profile has no {key.algorithm.name} key there")
    if len({key.public_key.spki for key in keys.values()}) < len(keys):
        raise UsageError(
            "two CAs would have the same key (CVE-2023-24010)", hint="name another key for one"
        )


def _check_pairs(authorities: Authorities) -> None:
    """KeystoreError if the CAs share a key, or a key does not match its certificate."""
    if authorities.identity.certificate.spki == authorities.permissions.certificate.spki:
        raise KeystoreError(
            "the identity CA and the permissions CA have the same key (CVE-2023-24010)",
            hint="replace them by two distinct CAs and reissue everything: `pqsec ca rotate`",
        )
    for authority in authorities.all:
        check_pair(authority)


def check_pair(authority: Authority) -> None:
    """KeystoreError if a private key does not match its certificate."""
    certificate = authority.certificate
    held: list[tuple[PrivateKey, PublicKey | None]] = [(authority.key, certificate.public_key)]
    if authority.alternative_key:
        held.append((authority.alternative_key, certificate.alternative_key))
    for key, known in held:
        if known is None or key.public_key.spki != known.spki:
            raise KeystoreError(
                f"{certificate.subject_name}: a private key does not match the certificate"
            )
