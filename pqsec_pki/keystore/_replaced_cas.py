"""Which CAs the ledger says are in use, and whether the files of this machine have them."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._files import read
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._settings import set_names

if TYPE_CHECKING:
    from pqsec_pki.keystore._store import LedgerStore


def refuse_replaced(root: Path, store: "LedgerStore") -> None:
    """KeystoreError if another machine replaced a CA, or changed which identity CAs are trusted,
    in any set of the keystore at `root`."""
    with Ledger(store) as ledger:
        for name in set_names(root):
            _refuse_replaced(root / layout.in_set(name, ""), ledger.of(name))


def _refuse_replaced(folder: Path, ledger: Ledger) -> None:
    """As above, of the set in `folder`, about which the ledger answers."""
    identity = identity_cas(ledger)
    signers = ledger.of_kind("permissions-ca")
    newest = {each.sha256 for each in signers if each.at == signers[-1].at}
    if not (
        _certificates(folder, layout.IDENTITY_CA)[: len(identity)] == identity
        and newest.issuperset(_certificates(folder, layout.PERMISSIONS_CA)[: len(newest)])
    ):
        raise KeystoreError(
            f"{folder}: the CAs are not those of the ledger: another machine changed them",
            hint="copy public/ and private/ from the machine where `pqsec ca rotate` ran:"
            " docs/how-to/postgresql.md",
        )


def expected_cas(ledger: Ledger, profile: Profile) -> dict[str, list[str]]:
    """The SHA-256 of the certificates that each file of CAs has, by the ledger.

    Of two identity CAs the issuing one is first. Empty for a ledger that has no CAs.
    """
    count = 2 if profile.alternative_key else 1  # the permissions CA, and its countersigner
    signers = [each.sha256 for each in ledger.of_kind("permissions-ca")[-count:]]
    found = {layout.IDENTITY_CA: identity_cas(ledger)}
    for file, each in zip(
        (layout.PERMISSIONS_CA, layout.PERMISSIONS_ALT_CA), signers, strict=False
    ):
        found[file] = [each]
    return found if signers else {}


def identity_cas(ledger: Ledger) -> list[str]:
    """The SHA-256 of the trusted identity CAs, the issuing one first."""
    return _identity_cas(ledger.of_kind("identity-ca", "trust", "trust-end"))


def _identity_cas(lines: Iterable[Entry]) -> list[str]:
    """The trusted identity CAs by their SHA-256, the issuing one first (overlap.py)."""
    before: list[str] = []
    trusted: list[str] = []
    for line in lines:
        match line.kind, line.details.get("overlap"):
            case "identity-ca", _:
                before, trusted = trusted, [line.sha256]
            case "trust", "begun":
                trusted = [*before[:1], *trusted]
            case "trust", _:
                trusted = trusted[::-1]
            case "trust-end", _:
                trusted = trusted[:1]
    return trusted


def _certificates(folder: Path, name: str) -> list[str]:
    return [
        each.fingerprint for each in Certificate.all_from_pem(read(folder / layout.PUBLIC / name))
    ]
