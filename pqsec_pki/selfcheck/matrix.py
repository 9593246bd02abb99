"""Measure every profile with every key agreement: message sizes, and time of a handshake.

Each profile gets its own keystore, in a temporary folder that is always removed.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, KeyAgreement, Profile
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.selfcheck.handshake_check import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.selfcheck.report import HANDSHAKE, HandshakeReport
from pqsec_pki.stacks import DATAGRAM, FRAGMENT

DOMAIN = DomainSet.of(0)
NAMES = ("/talker", "/listener")
_YEAR = timedelta(days=365)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageSize:
    """The largest size of one message over all rounds."""

    token: int
    """Bytes of the DataHolder."""
    sample: int
    """Bytes that are sent: the token and what encloses it."""

    @property
    def fragments(self) -> int:
        """The number of datagrams that carry it, with Cyclone DDS's default."""
        return -(-self.sample // FRAGMENT)


@dataclass(frozen=True, slots=True, kw_only=True)
class Suite:
    """A profile with a key agreement, measured."""

    profile: Profile
    agreement: KeyAgreement
    signature: str
    """Its name in c.dsign_algo."""
    breaks: tuple[str, ...]
    """Properties of the profile that this key agreement does not have."""
    sizes: dict[str, MessageSize]
    """The sizes of request, reply and final."""
    milliseconds: float
    """The median of the rounds: all messages and the key exchange, both sides."""

    @property
    def share(self) -> float:
        """The size of the largest message, divided by the size of the largest datagram."""
        return max(size.sample for size in self.sizes.values()) / DATAGRAM

    def to_json(self) -> dict[str, Any]:
        """The suite for --json."""
        messages = {
            name: {"token_bytes": size.token, "bytes": size.sample, "fragments": size.fragments}
            for name, size in self.sizes.items()
        }
        return {
            "profile": self.profile.name,
            "is_default": self.agreement is self.profile.key_agreement,
            "signature": self.signature,
            "key_agreement": self.agreement.wire_name,
            "breaks": self.breaks,
            "messages": messages,
            "share_of_datagram": round(self.share, 4),
            "milliseconds": self.milliseconds,
        }


def suites(now: datetime, rounds: int) -> Iterator[Suite]:
    """Measure each profile with each key agreement, over `rounds` handshakes.

    FileError if no temporary folder can be created; VerificationError if a handshake fails.
    """
    for profile in PROFILES:
        with _temporary_folder() as folder:
            keystore = _keystore(folder / "keystore", profile, now)
            for agreement in KEY_AGREEMENTS:
                setup = HandshakeSetup(keystore=keystore, domain=0, now=now, agreement=agreement)
                yield _measured([_met(setup) for _ in range(rounds)], profile, agreement)


def _met(setup: HandshakeSetup) -> HandshakeReport:
    report = run_handshake(setup, *(HandshakeParty(name=name) for name in NAMES))
    if step := report.failed:
        suite = f"profile {setup.profile.name} with {report.key_agreement}"
        raise VerificationError(f"{suite}: {step.name}: {step.detail}", hint=step.hint)
    return report


def _measured(reports: list[HandshakeReport], profile: Profile, agreement: KeyAgreement) -> Suite:
    samples = [(each.name, len(each.data)) for report in reports for each in report.sent]
    tokens = [pair for report in reports for pair in report.token_bytes.items()]
    return Suite(
        profile=profile,
        agreement=agreement,
        signature=str(reports[0].signature),
        breaks=_broken(profile, agreement),
        sizes={
            name: MessageSize(token=_largest(name, tokens), sample=_largest(name, samples))
            for name in HANDSHAKE
        },
        milliseconds=round(median(report.milliseconds for report in reports), 3),
    )


def _largest(name: str, sizes: list[tuple[str, int]]) -> int:
    # An ECDSA signature in DER is some bytes longer or shorter each time.
    return max(size for each, size in sizes if each == name)


def _broken(profile: Profile, agreement: KeyAgreement) -> tuple[str, ...]:
    """The properties of the profile that this key agreement does not have."""
    changed = replace(profile, key_agreement=agreement, promises=())
    return tuple(each.text for each in profile.promises if not each.kept(changed))


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    try:
        folder = TemporaryDirectory(prefix="pqsec-")
    except OSError as error:
        raise FileError(f"no temporary folder can be created: {error}") from error
    with folder as name:
        yield Path(name)


def _keystore(root: Path, profile: Profile, now: datetime) -> Keystore:
    keystore = Keystore.create(
        root, profile, name="Matrix", domains=DOMAIN, validity=_YEAR, passphrase=None, now=now
    )
    specs = [
        ParticipantSpec(name=name, domains=DOMAIN, publish=("x",), validity=_YEAR) for name in NAMES
    ]
    issue(keystore, keystore.unlock(None), specs, now=now)
    return keystore
