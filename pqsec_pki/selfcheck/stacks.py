"""How DDS stacks behave in a handshake: one row each, to answer "would it work with ...?".

A row says what its stack writes and what it refuses beyond the specification, as measured
against the real one. What a stack takes that it should not is no matter here: nothing
that two sound participants send is affected by it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

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
from pqsec_pki.handshake import Dialect, Policy


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """The largest message of some versions."""

    size: int
    """Bytes of the sample."""
    versions: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Stack:
    """An implementation of DDS-Security, as its peers know it."""

    name: str
    """What a user types."""
    title: str
    evidence: str
    """Where the row comes from."""
    dialect: Dialect = field(default_factory=Dialect)
    agreements: tuple[KeyAgreement, ...] = ()
    """Those it knows; the first is what it asks for. Empty: all of ours, as the profile says."""
    asks_for_any: bool = False
    """Whether it can be told to ask for another one."""
    announces: bool = True
    """Whether it sends an AuthRequest."""
    identity_keys: tuple[str, ...] = ()
    """Kinds of participant keys it takes; empty: all."""
    identity_ca_keys: tuple[str, ...] = ()
    hint_as_initiator: str | None = None
    """What helps where another stack refuses what it sends first."""
    limit: Limit | None = None
    fails_at_limit: bool = False
    """Whether this row stands for the versions with the limit."""

    @property
    def is_stock(self) -> bool:
        """Whether it is somebody else's, and knows nothing of post-quantum suites."""
        return bool(self.agreements)

    def check_identity(self, certificate: Certificate, ca: Certificate) -> None:
        """VerificationError if it does not take keys of these kinds."""
        kinds = (
            ("participant", certificate, self.identity_keys),
            ("identity CA", ca, self.identity_ca_keys),
        )
        problems = [
            f"{self.title} takes no {each.public_key.algorithm.name} key of a {what}"
            for what, each, known in kinds
            if known and each.public_key.algorithm.name not in known
        ]
        self._refuse(problems)

    def check_documents_ca(self, ca: Certificate) -> None:
        """VerificationError if it cannot verify what `ca` signs."""
        row = ca.public_key.algorithm
        if self.is_stock and row.family is not Family.CLASSICAL:
            self._refuse([f"{self.title} cannot verify documents signed by {row.name}"])

    def _refuse(self, problems: list[str]) -> None:
        if problems:
            raise VerificationError(
                *problems, hint="make the keystore with profile transition or classical"
            )

    def check_size(self, size: int) -> Iterator[str]:
        """What to say of a message of `size` bytes; VerificationError if it cannot be sent."""
        if self.limit and size > self.limit.size:
            words = f"over {self.limit.size} bytes, which {self.limit.versions} cannot send"
            if self.fails_at_limit:
                raise VerificationError(
                    f"a message of {size} bytes: {words}",
                    hint="use another version, or a keystore with profile classical",
                )
            yield words


PQSEC = Stack(name="pqsec", title="pqsec", evidence="this program")

_ECDH = STOCK_AGREEMENT
_RSA = ("rsa-2048", "rsa-3072", "rsa-4096")
_P256_OR_RSA_2048 = ("ecdsa-p256", "rsa-2048")

CYCLONE = Stack(
    name="cyclonedds",
    title="Cyclone DDS",
    evidence="0.10.2, 0.10.5 and 11.0.1 run",
    dialect=Dialect(answers_in_kind=False, sends_optional=False),
    agreements=(_ECDH, MODP_DER),
    identity_keys=_P256_OR_RSA_2048,
    identity_ca_keys=_P256_OR_RSA_2048,
)
FASTDDS = Stack(
    name="fastdds",
    title="Fast DDS",
    evidence="2.9.1 run; for 3.2.3 and later its source",
    dialect=Dialect(
        ends_names_in_nul=False,
        answers_in_kind=False,
        reads_reply_names=False,
        needs_in_reply=("hash_c1", "hash_c2", "dh1"),
    ),
    # Even with EC keys. In a Reply 2.9.1 ends c.kagree_algo as the Request did, but never
    # c.dsign_algo, so who insists on NUL refuses it all the same.
    agreements=(MODP_RAW, _ECDH),
    announces=False,
    # It looks at how the certificate is signed, not at the key in it.
    identity_keys=("ecdsa-p256", "ecdsa-p384", *_RSA),
    identity_ca_keys=("ecdsa-p256", *_RSA),
    hint_as_initiator="Fast DDS and Cyclone DDS understand each other only where Cyclone DDS"
    " initiates: choose names so that its GUID is the smaller one, or use one stack",
    limit=Limit(size=8192, versions="Fast DDS 2.14.4, 3.0.2, 3.1.1 to 3.1.3 and 3.2.0 to 3.2.2"),
)
FASTDDS_LIMITED = replace(
    FASTDDS,
    name="fastdds-3.1",
    title="Fast DDS 3.1",
    evidence="3.1.2 run",
    asks_for_any=True,  # preferred_key_agreement; 2.10.7, 2.14.5 and 3.0.2 have it too
    fails_at_limit=True,
)
OPENDDS = Stack(
    name="opendds",
    title="OpenDDS",
    evidence="its source, not run",
    dialect=Dialect(
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


def stack_named(name: str) -> Stack:
    """The stack a user means; UnknownAlgorithmError, with those there are, if it is none."""
    for row in STACKS:
        if row.name == name.lower():
            return row
    known = ", ".join(row.name for row in STACKS)
    raise UnknownAlgorithmError(f"no stack named {name!r}", hint=f"known: {known}")


def asked(
    initiator: Stack, replier: Stack, profile: Profile, wanted: KeyAgreement | None
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


def policy(own: Stack, peer: Stack, profile: Profile, wanted: KeyAgreement | None) -> Policy:
    """What `own` insists on when it meets `peer` in a domain of that profile."""
    if own.is_stock:
        return Policy(agreements=own.agreements)
    if peer.is_stock and profile.runs_in_stock:
        # With a stock peer nothing better can be had, and the profile allows it.
        names = {row.wire_name for row in peer.agreements}
        return Policy(agreements=tuple(row for row in KEY_AGREEMENTS if row.wire_name in names))
    return Policy(
        agreements=(wanted or profile.key_agreement,),
        require_alternative=profile.alternative_key is not None,
    )
