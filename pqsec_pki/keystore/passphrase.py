"""Another passphrase for the CA keys: all of them at once, and the old files overwritten."""

from pathlib import Path

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap, Phase


def change_passphrase(
    keystore: Keystore, authorities: Authorities, passphrase: bytes | None
) -> list[Path]:
    """Encrypt the CA keys under `passphrase`, or not at all for None; which files it was.

    Keys of older generations keep the passphrase they had. KeystoreError for a key that
    is a link: what it shows would stay as it is; and while the CA that will issue next
    has a key of its own.
    """
    with _journal.change(keystore.root) as transaction:
        authorities.refuse_outdated(keystore.root)
        overlap = Overlap.of(keystore)
        if overlap and overlap.phase is Phase.BEGUN:
            raise KeystoreError(
                "the identity CA that will issue next would keep the old passphrase",
                hint=overlap.way_on,
            )
        folder = transaction.folder(_layout.PRIVATE, private=True)
        authorities.write_keys(folder, passphrase)
        paths = [keystore.root / _layout.PRIVATE / name for name in folder.names]
        for path in paths:
            if path.is_symlink():
                raise KeystoreError(
                    f"{path} is a link: the key it shows would stay as it is",
                    hint="put the key itself there first",
                )
            transaction.shred(f"{_layout.PRIVATE}/{path.name}")
    return paths
