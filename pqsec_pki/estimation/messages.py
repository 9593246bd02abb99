"""Bytes of the three handshake messages, as samples, without running a handshake."""

from collections.abc import Iterator, Sequence
from statistics import fmean

from pqsec_pki.algorithms import Profile
from pqsec_pki.credentials import CERTIFICATE, PERMISSIONS
from pqsec_pki.errors import KeystoreError, shown
from pqsec_pki.handshake import (
    MAX_SAMPLE,
    Introduction,
    MessageSizes,
    WireVersion,
    check_carried,
)
from pqsec_pki.keystore import Keystore, enclave_files

PARTICIPANT_DATA = 676
"""Bytes of `c.pdata` of a stack: Cyclone DDS's, with a GUID and addresses (run)."""
_TYPICAL = {
    "classical": (607, 2358),
    "transition": (7838, 7201),
    "hybrid": (7729, 6364),
    "pq": (7546, 6270),
    "cnsa2": (10199, 8054),
}
"""Profile -> bytes of a certificate in PEM, and of signed permissions with two topics (run)."""
_TYPICAL_SECOND = {"transition": 9530, "hybrid": 9340, "pq": 9120, "cnsa2": 12400}
"""Profile -> bytes of the two in the second version of the messages (run)."""


def sizes_of(profile: Profile, version: WireVersion = WireVersion.FIRST) -> MessageSizes:
    """Sizes for participants with one topic to publish and one to subscribe to."""
    if version is WireVersion.SECOND:
        return _second(profile, _TYPICAL_SECOND[profile.name])
    return _sizes(profile, *_TYPICAL[profile.name])


def sizes_in(
    keystore: Keystore, version: WireVersion = WireVersion.FIRST
) -> Iterator[MessageSizes]:
    """Sizes for each participant of this set of credentials, by its certificate and permissions.

    KeystoreError if a participant lacks a file or has messages that no peer reads, FileError if a
    file cannot be read, MalformedError if the second version cannot carry a document.
    """
    for name in keystore.names():
        files = enclave_files(keystore.folder, name)
        certificate, permissions = files[CERTIFICATE], files[PERMISSIONS]
        if version is WireVersion.SECOND:
            yield _second(keystore.profile, check_carried(certificate, permissions))
            continue
        sizes = _sizes(keystore.profile, len(certificate), len(permissions))
        if (largest := max(sizes)) > MAX_SAMPLE:
            raise KeystoreError(
                f"a handshake message of {shown(name)} has {largest} bytes; peers read at most"
                f" {MAX_SAMPLE}",
                hint="issue it again with fewer topics, or with patterns for them",
            )
        yield sizes


def mean_of(sizes: Sequence[MessageSizes]) -> MessageSizes:
    """The mean of each message, in whole bytes."""
    return MessageSizes(*(round(fmean(each)) for each in zip(*sizes, strict=True)))


def _sizes(profile: Profile, certificate: int, permissions: int) -> MessageSizes:
    name, signature = _signing(profile)
    introduction = Introduction(
        certificate=bytes(certificate),
        permissions=bytes(permissions),
        participant_data=bytes(PARTICIPANT_DATA),
        signature_algorithm=name + b"\0",
        key_agreement=profile.key_agreement.wire_name.encode() + b"\0",
    )
    return MessageSizes.of(introduction, profile.key_agreement, signature)


def _second(profile: Profile, credentials: int) -> MessageSizes:
    name, signature = _signing(profile)
    names = len(name) + 1 + len(profile.key_agreement.wire_name)
    agreement = profile.key_agreement
    return MessageSizes.of_second(credentials, PARTICIPANT_DATA, names, agreement, signature)


def _signing(profile: Profile) -> tuple[bytes, int]:
    """The name of a participant's key or keys, and the bytes of its signature."""
    keys = [each for each in (profile.participant_key, profile.alternative_key) if each]
    name = "+".join(each.wire_name for each in keys).encode()
    return name, sum(each.signature_size for each in keys)
