"""The CAs and documents of a keystore's sets of credentials: made, and held together.

Each set is complete: two CAs, a governance and enclaves, all of one profile. A robot that knows
one set needs nothing of another. What they have in common is the subjects of certificates and the
content of documents, octet for octet; no key is in two of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from typing import TYPE_CHECKING

from pqsec_pki.algorithms import PrivateKey, Profile, SignatureAlgorithm
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._entries import document_entry
from pqsec_pki.keystore._set_change import SetChange
from pqsec_pki.keystore.authorities import Authorities
from pqsec_pki.keystore.ca_keys import key_algorithms

if TYPE_CHECKING:
    from pqsec_pki.keystore.keystore import Keystore


def created(
    profiles: Sequence[Profile],
    name: str,
    *,
    now: datetime,
    validity: timedelta,
    keys: Mapping[str, PrivateKey] | None = None,
) -> Authorities:
    """New CAs of each profile; those of further sets have the profile's name after `name`.

    `keys` are keys that are there already, by the names of `ca_key_places`. UsageError as of
    `Authorities.create`, and for a key that no CA has.
    """
    keys = keys or {}
    if unknown := keys.keys() - ca_key_places(profiles).keys():
        raise UsageError(f"no CA has a key {', '.join(sorted(unknown))}")
    first, *others = profiles
    own = _keys_of(layout.FIRST, first, keys)
    made = [Authorities.create(first, name, now=now, validity=validity, keys=own)]
    for each in others:
        own = _keys_of(each.name, each, keys)
        made.append(further(each, name, now=now, validity=validity, keys=own))
    return together(made)


def ca_key_places(profiles: Sequence[Profile]) -> dict[str, SignatureAlgorithm]:
    """The names of the CAs' key files -> the algorithms of their keys, in the sets of `profiles`.

    Names in further sets have the folder of their set: sets/pq/identity_ca.key.pem.
    """
    names = (layout.FIRST, *(each.name for each in profiles[1:]))
    return {
        layout.in_set(name, file): row
        for name, profile in zip(names, profiles, strict=True)
        for file, row in key_algorithms(profile).items()
    }


def _keys_of(
    set_name: str, profile: Profile, keys: Mapping[str, PrivateKey]
) -> dict[str, PrivateKey]:
    """Those of one set, by the names of their files."""
    places = {file: layout.in_set(set_name, file) for file in key_algorithms(profile)}
    return {file: keys[place] for file, place in places.items() if place in keys}


def further(
    profile: Profile,
    name: str,
    *,
    now: datetime,
    validity: timedelta,
    keys: Mapping[str, PrivateKey] | None = None,
) -> Authorities:
    """New CAs of a further set: a name of its own for each CA, by which issuers are found.

    `keys` are as in `Authorities.create`.
    """
    start = f"{name} {profile.name}".strip()
    made = Authorities.create(profile, start, now=now, validity=validity, keys=keys)
    return replace(made, set_name=profile.name)


def together(sets: Sequence[Authorities]) -> Authorities:
    """The CAs of the first set, which know those of the others.

    KeystoreError if two CAs have the same key (CVE-2023-24010).
    """
    first, *others = sets
    cas = [ca for each in sets for ca in each.all]
    keys = [key.public_key.spki for ca in cas for key in (ca.key, ca.alternative_key) if key]
    if len(set(keys)) < len(keys):
        raise KeystoreError(
            "two CAs of this keystore have the same key (CVE-2023-24010)",
            hint="replace them by distinct CAs and reissue everything: `pqsec ca rotate`",
        )
    return replace(first, others=tuple(others))


def stage_cas(
    part: SetChange, authorities: Authorities, passphrase: bytes | None, now: datetime
) -> None:
    """Stage new CAs of a set, with their keys and their lines."""
    public = part.folder(layout.PUBLIC, private=False)
    authorities.write(public, part.folder(layout.PRIVATE, private=True), passphrase)
    part.record(*authorities.entries(now))


def stage_governance(
    part: SetChange,
    authorities: Authorities,
    document: bytes,
    *,
    now: datetime,
    config_digest: str = "",
) -> None:
    """Sign a set's governance and stage it, with its line, which has `config_digest`."""
    signed = authorities.sign(document, number=part.number, now=now)
    enclaves = part.folder(layout.ENCLAVES, private=False)
    enclaves.public(layout.GOVERNANCE_XML, document)
    enclaves.public(layout.GOVERNANCE, signed)
    entry = document_entry("governance", "", signed, now)
    part.record(replace(entry, details={"mark": config_digest}) if config_digest else entry)


def one_set(keystore: "Keystore", profile: str | None) -> "Keystore":
    """The set of that profile, or the only one; UsageError if there are several, and none is named.

    KeystoreError if there is no such set.
    """
    if profile is not None:
        return keystore.of_profile(profile)
    if len(keystore.sets) > 1:
        names = ", ".join(each.name for each in keystore.profiles)
        raise UsageError(f"the keystore has several sets: name one with --set: {names}")
    return keystore


def refuse_further_sets(keystore: "Keystore", what: str) -> None:
    """KeystoreError if the keystore has several sets of credentials.

    For what handles only the first one: it would leave the others behind. `what` is its subject
    and verb, such as "`pqsec bundle` packs".
    """
    if others := keystore.profiles[1:]:
        names = ", ".join(each.name for each in others)
        raise KeystoreError(
            f"this keystore has further sets of credentials ({names}), and {what} only the first",
            hint="use a keystore with one profile for that",
        )
