"""On the robot: generate keys that never leave it, and the request for their certificate."""

import secrets
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki._files import (
    PRIVATE_MODE,
    PUBLIC_MODE,
    create,
    refuse_existing,
    sync_filesystem,
    write,
)
from pqsec_pki.algorithms import Profile, SealingPrivateKey, private_key_pem
from pqsec_pki.certificates import CertificateRequest, certificate_request
from pqsec_pki.credentials import ALT_KEY, KEY
from pqsec_pki.enrolment._own_folder import DRAFT, make_private
from pqsec_pki.enrolment.credential_store import CredentialStore, changing
from pqsec_pki.enrolment.sealed import fingerprint
from pqsec_pki.keystore import regular_name

REQUEST = "request.csr"
SEALING_KEY, SEALING_PUBLIC_KEY = "bundle.key.pem", "bundle.pub.pem"


@dataclass(frozen=True, slots=True)
class Requested:
    """A certificate request, and its path."""

    name: str
    path: Path
    request: CertificateRequest


def request(name: str, profile: Profile, root: Path, *, force: bool = False) -> Requested:
    """Generate the keys of participant `name` and the request for their certificate.

    They are in their own folder under `root`, the keys with mode 0600, until `install`
    gets the answer. UsageError for an invalid name; ExistsError if there is a request for it
    already, unless `force`.
    """
    regular = regular_name(name)
    key, second = profile.participant_key.generate(), profile.alternative_key
    alternative = second.generate() if second else None
    made = certificate_request(regular, key, alternative)
    with changing(root) as store:
        goal = store.request_folder(regular)
        if not force:
            refuse_existing(goal)
        make_private(goal.parent)
        draft = root / f"{DRAFT}{secrets.token_hex(8)}"
        make_private(draft)
        create(draft / KEY, private_key_pem(key), mode=PRIVATE_MODE)
        if alternative:
            create(draft / ALT_KEY, private_key_pem(alternative), mode=PRIVATE_MODE)
        create(draft / REQUEST, made.pem, mode=PUBLIC_MODE)
        sync_filesystem(draft)
        _replace(store, draft, goal)
    return Requested(regular, goal / REQUEST, made)


def make_sealing_key(root: Path, *, force: bool = False) -> tuple[Path, str]:
    """Generate the key that opens sealed bundles; returns its public key's path and SHA-256.

    ExistsError if there is one, unless `force`: bundles sealed for the old key can then no
    longer be opened.
    """
    key = SealingPrivateKey.generate()
    with changing(root):
        if not force:
            refuse_existing(root / SEALING_KEY)
        # The public half first: as long as there is no private key, a second run repairs it.
        write(root / SEALING_PUBLIC_KEY, key.public_key.pem, force=True)
        write(root / SEALING_KEY, key.pem, private=True, force=force)
    return root / SEALING_PUBLIC_KEY, fingerprint(key.public_key)


def _replace(store: CredentialStore, draft: Path, goal: Path) -> None:
    if goal.exists():
        store.remove(goal)
    draft.rename(goal)
