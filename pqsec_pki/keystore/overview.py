"""What a keystore is: its CAs, profile, domains and participants."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError, KeystoreError
from pqsec_pki.keystore._address import LedgerAddress
from pqsec_pki.keystore.ca_keys import SigningCa, ca_key_files
from pqsec_pki.keystore.current_files import CurrentFiles
from pqsec_pki.keystore.keystore import Keystore


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """A keystore, or a further set of it, without a private key."""

    keystore: Path
    folder: Path
    """The folder of the set."""
    profile: Profile
    domains: DomainSet
    keys: str
    """Whether the CA keys are encrypted, in tokens, missing, or not readable for this user."""
    key_uris: dict[str, str]
    """The CA keys that are not in files; without those of a CA that cannot be read."""
    cas: tuple[tuple[str, Certificate], ...]
    """The role of each CA, and its certificate."""
    participants: tuple[str, ...]
    approvals: str
    """Whose approvals changes need; empty if they need none, or if the ledger cannot be read."""
    ledger: LedgerAddress | None
    """The database with the ledger; None if it is in a file of the keystore."""
    further: tuple["Overview", ...] = ()
    """The further sets of credentials."""

    def to_json(self) -> dict[str, object]:
        """The overview for --json."""
        return {
            "keystore": self.keystore,
            **self.profile.to_names(),
            "domains": str(self.domains),
            "keys": self.keys,
            "key_uris": self.key_uris,
            "cas": self.cas_json,
            "participants": self.participants,
            "approvals": self.approvals or None,
            "ledger": self.ledger.url if self.ledger else None,
            "further": [
                {
                    "folder": each.folder,
                    **each.profile.to_names(),
                    "keys": each.keys,
                    "key_uris": each.key_uris,
                    "cas": each.cas_json,
                    "participants": each.participants,
                }
                for each in self.further
            ],
        }

    @property
    def cas_json(self) -> list[dict[str, object]]:
        """The CAs for --json."""
        return [{"role": role, **each.to_json()} for role, each in self.cas]


def overview_of(keystore: Keystore) -> Overview:
    """The overview of the keystore; errors as of its CAs' files and folders."""
    first, *others = map(_of_set, keystore.sets)
    return replace(first, further=tuple(others))


def _of_set(keystore: Keystore) -> Overview:
    return Overview(
        keystore=keystore.root,
        folder=keystore.folder,
        profile=keystore.profile,
        domains=keystore.domains,
        cas=tuple(_cas(keystore)),
        keys=_keys(keystore),
        key_uris=_uris(keystore),
        participants=tuple(keystore.names()),
        approvals=_approvals(keystore),
        ledger=keystore.ledger_address,
    )


def _approvals(keystore: Keystore) -> str:
    with suppress(KeystoreError, FileError):
        return str(keystore.approvals or "")
    return ""


def _cas(keystore: Keystore) -> Iterator[tuple[str, Certificate]]:
    """Their fingerprints are copied to robots: so they are those of the ledger, if the user may
    read it."""
    with CurrentFiles.if_readable(keystore) as current:
        anchors = current.anchors if current else keystore.anchors
    issuing, *others = anchors.identity_cas
    yield "identity CA", issuing
    yield "permissions CA", anchors.permissions_ca
    if anchors.countersigner:
        yield "countersigner", anchors.countersigner
    for each in others:
        yield "trusted too", each


def _keys(keystore: Keystore) -> str:
    found = {ca: _keys_of(keystore, ca) for ca in SigningCa}
    if len({*found.values()}) == 1:
        return found[SigningCa.IDENTITY]
    return ", ".join(f"those of the {ca} {words}" for ca, words in found.items())


def _keys_of(keystore: Keystore, ca: SigningCa) -> str:
    try:
        if len(keystore.key_uris([ca])) == len(ca_key_files(keystore.profile, [ca])):
            return "not in files"
        return "encrypted" if keystore.is_locked([ca]) else "not encrypted"
    except KeystoreError:
        return "not here"
    except FileError:
        return "not readable from here"


def _uris(keystore: Keystore) -> dict[str, str]:
    found: dict[str, str] = {}
    for ca in SigningCa:
        with suppress(KeystoreError, FileError):
            found |= keystore.key_uris([ca])
    return found
