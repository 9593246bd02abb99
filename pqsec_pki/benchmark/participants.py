"""A CA and two participants in memory, whose handshakes are measured."""

import os
from datetime import datetime, timedelta
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Family, SignatureAlgorithm, pair_private
from pqsec_pki.benchmark.suites import HandshakeSuite
from pqsec_pki.certificates import Authority
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.handshake import Identity, adjusted_guid
from pqsec_pki.smime import Signer, sign

NAMES = ("/bench/initiator", "/bench/responder")
_VALIDITY = timedelta(days=1)
_ENTITY = b"\0\0\1\xc1"
"""The entity ID of a participant (RTPS 2.5, 9.3.1.3)."""
_PREFIX = 12
"""Octets of a GUID before the entity ID."""


@dataclass(frozen=True, slots=True)
class MeasuredParticipants:
    """A CA, and two participants with its certificates and with permissions of the usual size."""

    ca: Authority
    initiator: Identity
    responder: Identity

    @classmethod
    def of(cls, suite: HandshakeSuite, now: datetime) -> Self:
        """With new keys of that suite; the certificates begin at `now`, and last a day."""
        ca = _authority("Identity CA", suite.signature, now, suite.alternative)
        signer = _authority("Permissions CA", suite.signature, now)
        counter = None
        if suite.alternative:
            counter = _authority("Countersigner", suite.alternative, now)
        return cls(ca, *(_participant(name, ca, signer, counter, now) for name in NAMES))


def _authority(
    name: str,
    algorithm: SignatureAlgorithm,
    now: datetime,
    alternative: SignatureAlgorithm | None = None,
) -> Authority:
    return Authority.create(name, algorithm, alternative=alternative, now=now, validity=_VALIDITY)


def _participant(
    name: str, ca: Authority, signer: Authority, counter: Authority | None, now: datetime
) -> Identity:
    key = ca.key.algorithm.generate()
    second = ca.alternative_key.algorithm.generate() if ca.alternative_key else None
    public = second.public_key if second else None
    certificate = ca.issue(name, key.public_key, alternative=public, now=now, validity=_VALIDITY)
    return Identity(
        certificate=certificate,
        key=pair_private(key, second) if second else key,
        ca=ca.certificate,
        guid=adjusted_guid(certificate.subject_der, os.urandom(_PREFIX) + _ENTITY),
        permissions=_permissions(certificate.subject_name, signer, counter, now),
    )


def _permissions(
    subject: str, signer: Authority, counter: Authority | None, now: datetime
) -> bytes:
    """A signed document, which the handshake carries and does not read."""
    grant = Grant.least(
        subject_name=subject,
        not_before=now,
        not_after=now + _VALIDITY,
        domains=DomainSet.of(0),
        publish=["rt/chatter"],
        subscribe=["rt/cmd"],
    )
    return sign(
        Permissions(grants=(grant,)).to_xml(),
        Signer(signer.certificate, signer.key),
        countersigner=Signer(counter.certificate, counter.key) if counter else None,
        embed_certificate=signer.key.algorithm.family is Family.CLASSICAL,  # stock stacks need it
        now=now,
    )
