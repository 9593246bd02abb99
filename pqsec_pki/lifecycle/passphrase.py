"""Changes the passphrase of all CA keys at once, and overwrites the old files."""

from pathlib import Path

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Authorities, Keystore, Overlap, Phase, change, key_algorithms, layout


def change_passphrase(
    keystore: Keystore, authorities: Authorities, passphrase: bytes | None
) -> list[Path]:
    """Encrypt the CA keys under `passphrase`, or store them unencrypted for None.

    Returns the key files. Keys of older generations keep their passphrase. KeystoreError for a
    key that is a link, because its target would not change, and during an overlap before the
    switch.
    """
    if all(len(each.key_uris()) == len(key_algorithms(each.profile)) for each in keystore.sets):
        raise KeystoreError(
            "no CA key is in a file: there is nothing to encrypt",
            hint="the tokens have PINs; their own tools change them",
        )
    with change(keystore.root, authorities) as transaction:
        for each in keystore.sets:
            overlap = Overlap.of(each)
            if overlap and overlap.phase is Phase.BEGUN:
                raise KeystoreError(
                    "the identity CA that will issue next would keep the old passphrase",
                    hint=overlap.next_step,
                )
        paths = []
        for each, cas in zip(keystore.sets, authorities.sets, strict=True):
            part = transaction.of(each.set_name)
            folder = part.folder(layout.PRIVATE, private=True)
            cas.write_keys(folder, passphrase)
            for path in (each.folder / layout.PRIVATE / name for name in folder.names):
                if path.is_symlink():
                    raise KeystoreError(
                        f"{path} is a link: the key that it leads to would not change",
                        hint="replace the link with the key itself",
                    )
                part.shred(f"{layout.PRIVATE}/{path.name}")
                paths.append(path)
    return paths
