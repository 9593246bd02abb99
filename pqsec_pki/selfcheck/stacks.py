"""How DDS stacks behave in a handshake: one row each, to answer "would it work with ...?".

A row says what its stack sends, and what it refuses beyond the specification, as measured
with the real stack. What a stack accepts although it should not is left out: two valid
participants never send that.
"""

from collections.abc import Iterator
from dataclasses import field, replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    MODP_DER,
    MODP_RAW,
    STOCK_AGREEMENT,
    Family,
    KeyAgreement,
    Profile,
)
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import UnknownAlgorithmError, VerificationError
from pqsec_pki.handshake import MessageConventions, PeerRequirements
from pqsec_pki.stacks import FAST_DDS_LIMIT, MessageLimit, Stack


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedStack:
    """An implementation of DDS-Security, as its peers see it in a handshake."""

    name: str
    """Its name on the command line."""
    title: str
    evidence: str
    """The source of the row: versions that were run, or source code."""
    conventions: MessageConventions = field(default_factory=MessageConventions)
    agreements: tuple[KeyAgreement, ...] = ()
    """Agreements that it supports; it asks for the first. Empty: those of the pqsec profile."""
    asks_for_any: bool = False
    """Whether it can be configured to ask for any other of them."""
    announces: bool = True
    """Whether it sends an AuthRequest."""
    identity_keys: tuple[str, ...] = ()
    """Participant keys that it accepts; empty: all."""
    identity_ca_keys: tuple[str, ...] = ()
    hint_as_initiator: str | None = None
    """The hint if another stack refuses its Request."""
    limit: MessageLimit | None = None
    fails_at_limit: bool = False
    """Whether this row describes the versions with the limit."""

    @property
    def stack_name(self) -> str:
        """The stack's name without versions, such as fastdds for fastdds-3.1."""
        return self.name.partition("-")[0]

    @property
    def is_stock(self) -> bool:
        """Whether it is not pqsec, and supports no post-quantum algorithms."""
        return bool(self.agreements)

    def check_identity(self, certificate: Certificate, ca: Certificate) -> None:
        """VerificationError if it does not accept keys of these algorithms."""
        kinds = (
            ("a participant", certificate, self.identity_keys),
            ("an identity CA", ca, self.identity_ca_keys),
        )
        problems = [
            f"{self.title} accepts no {each.public_key.algorithm.name} key of {what}"
            for what, each, known in kinds
            if known and each.public_key.algorithm.name not in known
        ]
        self._refuse(problems)

    def check_documents_ca(self, ca: Certificate) -> None:
        """VerificationError if it cannot verify documents that `ca` signs."""
        row = ca.public_key.algorithm
        if self.is_stock and row.family is not Family.CLASSICAL:
            self._refuse([f"{self.title} cannot verify documents signed by {row.name}"])

    def _refuse(self, problems: list[str]) -> None:
        if problems:
            raise VerificationError(
                *problems, hint="create the keystore with profile transition or classical"
            )

    def check_size(self, size: int) -> Iterator[str]:
        """A note on a message of `size` bytes, if any; VerificationError if it cannot be sent."""
        if self.limit and size > self.limit.size:
            words = f"over {self.limit.size} bytes, which {self.limit} cannot send"
            if self.fails_at_limit:
                raise VerificationError(
                    f"a message of {size} bytes: {words}",
                    hint="use another version, or a keystore with profile classical",
                )
            yield words


PQSEC = SimulatedStack(name="pqsec", title="pqsec", evidence="this program")

_ECDH = STOCK_AGREEMENT
_RSA = ("rsa-2048", "rsa-3072", "rsa-4096")
_P256_OR_RSA_2048 = ("ecdsa-p256", "rsa-2048")

CYCLONE = SimulatedStack(
    name=Stack.CYCLONEDDS.value,
    title=Stack.CYCLONEDDS.product,
    evidence="0.10.2, 0.10.5 and 11.0.1 run",
    conventions=MessageConventions(answers_in_kind=False, sends_optional=False),
    agreements=(_ECDH, MODP_DER),
    identity_keys=_P256_OR_RSA_2048,
    identity_ca_keys=_P256_OR_RSA_2048,
)
FASTDDS = SimulatedStack(
    name=Stack.FASTDDS.value,
    title=Stack.FASTDDS.product,
    evidence="2.9.1 run; for 3.2.3 and later its source",
    conventions=MessageConventions(
        ends_names_in_nul=False,
        answers_in_kind=False,
        reads_reply_names=False,
        needs_in_reply=("hash_c1", "hash_c2", "dh1"),
    ),
    # Even with EC keys. In a Reply, 2.9.1 ends c.kagree_algo in NUL if the Request did, but
    # never c.dsign_algo, so a peer that requires NUL still refuses the Reply.
    agreements=(MODP_RAW, _ECDH),
    announces=False,
    # It checks the algorithm of the certificate's signature, not of the key in it.
    identity_keys=("ecdsa-p256", "ecdsa-p384", *_RSA),
    identity_ca_keys=("ecdsa-p256", *_RSA),
    hint_as_initiator="Fast DDS and Cyclone DDS understand each other only where Cyclone DDS"
    " initiates: choose names so that its GUID is the smaller one, or use one stack",
    limit=FAST_DDS_LIMIT,
)
FASTDDS_LIMITED = replace(
    FASTDDS,
    name=f"{Stack.FASTDDS}-3.1",
    title=f"{Stack.FASTDDS.product} 3.1",
    evidence="3.1.2 run",
    asks_for_any=True,  # preferred_key_agreement; 2.10.7, 2.14.5 and 3.0.2 have it too
    fails_at_limit=True,
)
OPENDDS = SimulatedStack(
    name=Stack.OPENDDS.value,
    title=Stack.OPENDDS.product,
    evidence="its source, not run",
    conventions=MessageConventions(
        answers_in_kind=False,
        sends_optional=False,
        reads_request_names=True,
        reads_reply_names=True,
    ),
    agreements=(_ECDH, MODP_RAW),
    identity_keys=("ecdsa-p256", "ecdsa-p384", *_RSA),
    identity_ca_keys=("ecdsa-p256", "ecdsa-p384", *_RSA),
)
STACKS = (PQSEC, CYCLONE, FASTDDS, FASTDDS_LIMITED, OPENDDS)


def stack_named(name: str) -> SimulatedStack:
    """The stack of that name; UnknownAlgorithmError, with the known ones, if there is none."""
    for row in STACKS:
        if row.name == name.lower():
            return row
    known = ", ".join(row.name for row in STACKS)
    raise UnknownAlgorithmError(f"no stack named {name!r}", hint=f"known: {known}")


def asked(
    initiator: SimulatedStack,
    replier: SimulatedStack,
    profile: Profile,
    wanted: KeyAgreement | None,
) -> KeyAgreement:
    """The key agreement that the initiator's Request asks for; `wanted` is the user's."""
    if initiator.is_stock:
        known = {row.wire_name: row for row in initiator.agreements}
        if wanted and initiator.asks_for_any and wanted.wire_name in known:
            return known[wanted.wire_name]
        return initiator.agreements[0]
    if wanted:
        return wanted
    if replier.is_stock and profile.runs_in_stock:
        return STOCK_AGREEMENT
    return profile.key_agreement


def policy(
    own: SimulatedStack, peer: SimulatedStack, profile: Profile, wanted: KeyAgreement | None
) -> PeerRequirements:
    """What `own` requires in a handshake with `peer`, in a keystore of that profile."""
    if own.is_stock:
        return PeerRequirements(agreements=own.agreements)
    if peer.is_stock and profile.runs_in_stock:
        # A stock peer supports nothing stronger, and the profile allows this.
        names = {row.wire_name for row in peer.agreements}
        return PeerRequirements(
            agreements=tuple(row for row in KEY_AGREEMENTS if row.wire_name in names)
        )
    return PeerRequirements(
        agreements=(wanted or profile.key_agreement,),
        require_alternative=profile.alternative_key is not None,
    )
