"""On the robot: generate keys that never leave it, and the request for their certificate."""

import secrets
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
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
from pqsec_pki.algorithms import PrivateKey, Profile, SealingPrivateKey, SignatureAlgorithm
from pqsec_pki.certificates import CertificateRequest, certificate_request
from pqsec_pki.credentials import ALT_KEY, KEY, KEYS
from pqsec_pki.enrolment._own_folder import DRAFT, make_private
from pqsec_pki.enrolment.credential_store import REQUESTS, CredentialStore, changing
from pqsec_pki.enrolment.sealed import fingerprint
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import expanded, is_several, layout, regular_name
from pqsec_pki.tokens import Pin, is_reference, key_file, key_in, participant_keys, stored_pin

REQUEST = "request.csr"
SEALING_KEY, SEALING_PUBLIC_KEY = "bundle.key.pem", "bundle.pub.pem"
IN_FILE = "file"
"""In place of a URI, for a key in a file."""


@dataclass(frozen=True, slots=True)
class Requested:
    """A certificate request, and its path."""

    name: str
    path: Path
    request: CertificateRequest
    generated: frozenset[str] = frozenset()
    """The names of key files that refer to a key that was not there before."""


def request(
    name: str,
    profile: Profile,
    root: Path,
    *,
    further: Sequence[Profile] = (),
    force: bool = False,
) -> Requested:
    """Generate the keys of one participant, and the request for their certificate: `requests`."""
    [made] = requests([name], profile, root, further=further, force=force)
    return made


def requests(  # noqa: PLR0913 -- the choices are the user's, and by name
    names: Iterable[str],
    profile: Profile,
    root: Path,
    *,
    further: Sequence[Profile] = (),
    uris: Mapping[str, str] | None = None,
    pin: Pin = stored_pin,
    together: bool = False,
    force: bool = False,
) -> list[Requested]:
    """Generate the keys of each participant, and the request for their certificate.

    With `further` profiles, for a keystore with several sets of credentials, there are keys for
    each, and one request for all. If some of these sets are installed here, and others are not,
    those keep their keys.

    They are in a folder of the participant under `root`, the keys with mode 0600, until `install`
    gets the answer. A pattern matches the participants that were requested or installed here.
    UsageError for an invalid name, KeystoreError for a pattern that matches none; ExistsError if
    there is a request for one of them already, unless `force`: then none is made.

    `uris` are places of keys that are not in files, or IN_FILE, by the names of the files; `pin`
    is asked for a token's PIN. UsageError for several participants with one key, and if a key in
    a token would be followed by one in a file; errors as of `participant_keys`. If the requests are
    for one file, `together`, TooLargeError if they do not fit into it.
    """
    uris = uris or {}
    profiles = (profile, *further)
    wanted = key_places(profiles, uris)
    with changing(root) as store:
        goals = {name: store.request_folder(name) for name in _named(store, names)}
        if not force:
            for goal in goals.values():
                refuse_existing(goal)
        _refuse_unplaced(store, goals, uris, profiles)
        make_private(root / REQUESTS)
        with participant_keys(wanted, pin) as outside:
            drafts = {
                name: _draft(name, profiles, root, _kept(store, name, profiles, pin) | outside.keys)
                for name in goals
            }
            if together:
                CertificateRequest.all_to_pem([each for _, each in drafts.values()])
            sync_filesystem(root)
            for name, (draft, _) in drafts.items():
                _replace(store, draft, goals[name])
    return [
        Requested(name, goals[name] / REQUEST, request, outside.generated)
        for name, (_, request) in drafts.items()
    ]


def key_places(
    profiles: Sequence[Profile], uris: Mapping[str, str]
) -> dict[str, tuple[str, SignatureAlgorithm]]:
    """The URIs for `participant_keys`, without those that are IN_FILE.

    Each is of the key in a file of the set of one of the `profiles`, such as `sets/pq/key.pem`.
    UsageError for a key that participants of the profile do not have.
    """
    algorithms = _algorithms(profiles)
    found = {}
    for file, uri in uris.items():
        algorithm = algorithms.get(file)
        if algorithm is None:
            names = ",".join(each.name for each in profiles)
            if file == ALT_KEY:
                raise UsageError(f"participants of profile {names} have no alternative key")
            raise UsageError(f"participants of profile {names} have no {file}")
        if uri != IN_FILE:
            found[file] = uri, algorithm
    return found


def _places(profiles: Sequence[Profile]) -> Iterator[tuple[str, Profile]]:
    """The name of each set, and its profile."""
    for number, each in enumerate(profiles):
        yield each.name if number else layout.FIRST, each


def _algorithms(profiles: Sequence[Profile]) -> dict[str, SignatureAlgorithm | None]:
    """The algorithm of the key in each file; None for a key that there is not."""
    return {
        layout.in_set(place, file): algorithm
        for place, each in _places(profiles)
        for file, algorithm in ((KEY, each.participant_key), (ALT_KEY, each.alternative_key))
    }


def _kept(
    store: CredentialStore, name: str, profiles: Sequence[Profile], pin: Pin
) -> dict[str, PrivateKey]:
    """The keys that stay, by the places of their files, if the participant lacks a set.

    They are those of the sets that are installed, as far as they are of the profiles.
    """
    current = store.current.sets if store.current else {}
    found = {place: current.get(place, {}).get(name, {}) for place, _ in _places(profiles)}
    if all(found.values()) or not any(found.values()):
        return {}
    algorithms = _algorithms(profiles)
    kept = {
        layout.in_set(place, file): key_in(files[file], pin=pin)
        for place, files in found.items()
        for file in KEYS
        if file in files
    }
    return {place: key for place, key in kept.items() if key.algorithm is algorithms[place]}


def _refuse_unplaced(
    store: CredentialStore,
    names: Collection[str],
    uris: Mapping[str, str],
    profiles: Sequence[Profile],
) -> None:
    """UsageError if one key is for several, or one in a token would be followed by a file."""
    if len(names) > 1 and set(uris.values()) - {IN_FILE}:
        raise UsageError(
            f"one key is named for {len(names)} participants",
            hint="request them one by one, each with a URI of its own",
        )
    for name in names:
        outside = [
            layout.in_set(place, file)
            for place, _ in _places(profiles)
            for file, data in next(filter(None, store.keys(name, place)), {}).items()
            if file in KEYS and is_reference(data)
        ]
        if any(file not in uris for file in outside):
            raise UsageError(
                f"a key of {name} is in a token, and the new key would be in a file",
                hint="name the new key's place: --participant-key-uri (--alt-key-uri) URI; the"
                f" same URI keeps the key, `{IN_FILE}` puts it into a file",
            )


def _named(store: CredentialStore, names: Iterable[str]) -> list[str]:
    given = list(names)
    known = store.names if any(map(is_several, given)) else []
    try:
        return list(dict.fromkeys(map(regular_name, expanded(given, known, {}))))
    except KeystoreError as error:
        error.hint = f"a pattern matches only participants that {store.root} has: give names"
        raise


def _draft(
    name: str, profiles: Sequence[Profile], root: Path, given: Mapping[str, PrivateKey]
) -> tuple[Path, CertificateRequest]:
    """The keys and their request, in a folder that `sweep` removes if this is killed.

    `given` are keys that are there already, by the places of their files.
    """
    keys = {
        place: given.get(place) or algorithm.generate()
        for place, algorithm in _algorithms(profiles).items()
        if algorithm
    }
    pairs = [
        (keys[layout.in_set(place, KEY)], keys.get(layout.in_set(place, ALT_KEY)))
        for place, _ in _places(profiles)
    ]
    (first, alternative), *further = pairs
    made = certificate_request(name, first, alternative, further=further)
    draft = root / f"{DRAFT}{secrets.token_hex(8)}"
    make_private(draft)
    for place, key in keys.items():
        make_private((draft / place).parent)
        create(draft / place, key_file(key), mode=PRIVATE_MODE)
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
        # The public half first: while there is no private key, a second run repairs it.
        write(root / SEALING_PUBLIC_KEY, key.public_key.pem, force=True)
        write(root / SEALING_KEY, key.pem, private=True, force=force)
    return root / SEALING_PUBLIC_KEY, fingerprint(key.public_key)


def _replace(store: CredentialStore, draft: Path, goal: Path) -> None:
    if goal.exists():
        store.remove(goal)
    draft.rename(goal)
