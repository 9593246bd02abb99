"""On the robot: generate keys that never leave it, and the request for their certificate."""

import secrets
from collections.abc import Iterable
from pathlib import Path

from pqsec_pki._dataclass import dataclass
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
from pqsec_pki.enrolment.credential_store import REQUESTS, CredentialStore, changing
from pqsec_pki.enrolment.sealed import fingerprint
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import expanded, is_several, regular_name

REQUEST = "request.csr"
SEALING_KEY, SEALING_PUBLIC_KEY = "bundle.key.pem", "bundle.pub.pem"


@dataclass(frozen=True, slots=True)
class Requested:
    """A certificate request, and its path."""

    name: str
    path: Path
    request: CertificateRequest


def request(name: str, profile: Profile, root: Path, *, force: bool = False) -> Requested:
    """Generate the keys of one participant, and the request for their certificate: `requests`."""
    [made] = requests([name], profile, root, force=force)
    return made


def requests(
    names: Iterable[str], profile: Profile, root: Path, *, force: bool = False
) -> list[Requested]:
    """Generate the keys of each participant, and the request for their certificate.

    They are in a folder of the participant under `root`, the keys with mode 0600, until `install`
    gets the answer. A pattern stands for the participants that were requested or installed here.
    UsageError for an invalid name, KeystoreError for a pattern that matches none; ExistsError if
    there is a request for one of them already, unless `force`: then none is made.
    """
    with changing(root) as store:
        goals = {name: store.request_folder(name) for name in _named(store, names)}
        if not force:
            for goal in goals.values():
                refuse_existing(goal)
        make_private(root / REQUESTS)
        drafts = {name: _draft(name, profile, root) for name in goals}
        sync_filesystem(root)
        for name, (draft, _) in drafts.items():
            _replace(store, draft, goals[name])
    return [
        Requested(name, goals[name] / REQUEST, request) for name, (_, request) in drafts.items()
    ]


def _named(store: CredentialStore, names: Iterable[str]) -> list[str]:
    given = list(names)
    known = store.names if any(map(is_several, given)) else []
    try:
        return list(dict.fromkeys(map(regular_name, expanded(given, known, {}))))
    except KeystoreError as error:
        error.hint = f"a pattern stands for participants that {store.root} has already: give names"
        raise


def _draft(name: str, profile: Profile, root: Path) -> tuple[Path, CertificateRequest]:
    """The new keys and their request, in a folder that `sweep` removes if this is killed."""
    key, second = profile.participant_key.generate(), profile.alternative_key
    alternative = second.generate() if second else None
    made = certificate_request(name, key, alternative)
    draft = root / f"{DRAFT}{secrets.token_hex(8)}"
    make_private(draft)
    create(draft / KEY, private_key_pem(key), mode=PRIVATE_MODE)
    if alternative:
        create(draft / ALT_KEY, private_key_pem(alternative), mode=PRIVATE_MODE)
    create(draft / REQUEST, made.pem, mode=PUBLIC_MODE)
    return draft, made


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
