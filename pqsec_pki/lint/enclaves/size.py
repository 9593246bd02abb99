"""Rules about the size of a participant's handshake.

The largest message is the Reply: it contains the certificate and the signed permissions.
It is built here as it is sent, with zeros in place of secrets and signatures.
"""

from collections.abc import Iterable, Iterator
from functools import lru_cache

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import (
    MODP_RAW,
    Family,
    KeyAgreement,
    Profile,
    PublicKey,
    SignatureAlgorithm,
)
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import PERMISSIONS
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import (
    GUID_SIZE,
    MAX_TOKEN,
    Introduction,
    MessageSizes,
    participant_data,
)
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder, Inventory
from pqsec_pki.stacks import (
    DATAGRAM,
    FAST_DDS_LIMIT,
    FRAGMENT,
    FRAME_MEMORY,
    IPFRAG_HIGH_THRESH,
    Stack,
    frames_of,
)

MANY = 40
"""Fragments. The largest handshake of pqsec's profiles has 29."""
_SMALLER = "Write permissions with fewer rules (patterns instead of lists of topics)"


@dataclass(frozen=True, slots=True)
class LargestMessage:
    """The largest handshake message of one participant, in bytes."""

    enclave: EnclaveFolder
    message: int
    certificate: int
    permissions: int
    profile: str
    """The profile of the peers; empty for stock stacks."""

    @property
    def found(self) -> str:
        """The size and its main parts, for messages."""
        return (
            f"handshake messages of {self.message} bytes"
            f" (certificate {self.certificate}, permissions {self.permissions})"
        )


@lint_rule(
    "PQS501", Severity.WARNING, "some versions of Fast DDS cannot send the handshake",
    why="Fast DDS 2.14.4, 3.0.2, 3.1.1 to 3.1.3 and 3.2.0 to 3.2.2 fail above 8192 bytes with"
    " 'Cannot serialize ParticipantGenericMessage', and sometimes crash the peer.",
    fix=f"{_SMALLER}, use the classical profile, or use another version. 2.14.5 and 3.2.3 have the"
    " fix.",
    stacks=(Stack.FASTDDS,), only_when_asked=True,
    rows=(
        "EC P-256 + X.509 alt ML-DSA-44/65/87 (5.8/7.8/10.5 KB PEM)", "RSA-2048 + alt ML-DSA-65",
        "leaf padded +4…32 KB", "all RSA-4096",
        "ML-DSA-65 signature in an *unsigned attribute* of the EC SignerInfo",
        "PQ blob after final boundary / in header / in preamble / XML comment",
    ),
    measured="Fast DDS 3.1.2; the other versions by source",
    bad="""
        $ pqsec -k large ca init --no-passphrase --profile transition
        $ pqsec -k large issue --publish chatter /talker
    """,
    good="""
        $ mv k large elsewhere/
        $ pqsec -k small ca init --no-passphrase --profile classical
        $ pqsec -k small issue --publish chatter /talker
    """,
)  # fmt: skip
def over_fast_dds_limit(inventory: Inventory) -> Iterator[Violation]:
    for size in filter(None, (_largest_message(each, None) for each in inventory.enclaves)):
        if size.message > FAST_DDS_LIMIT.size:
            words = (
                f"{size.found}: over {FAST_DDS_LIMIT.size}, too large for some versions of Fast DDS"
            )
            yield _found(size, words)


@lint_rule(
    "PQS502", Severity.ERROR, "the handshake does not fit into a datagram",
    why="Fast DDS (2.9.1, 3.1.2) cannot send more than 64 KB. Fast DDS 3.6.2 and Cyclone DDS can.",
    fix=f"{_SMALLER}, or a smaller certificate.",
    stacks={Stack.FASTDDS: "2.9.1, 3.1.2"},
    rows=("leaf padded +48…128 KB", "permissions document 512 KB"),
    measured="Fast DDS 2.9.1, 3.1.2",
    bad="$ pqsec -k k issue --force /talker $(printf -- '--publish rt/robot/sensor%s ' {1..1500})",
    good="$ pqsec -k k issue --force /talker --publish 'rt/robot/sensor*'",
)  # fmt: skip
def over_datagram(inventory: Inventory) -> Iterator[Violation]:
    for size in largest_messages(inventory):
        if size.message > DATAGRAM:
            yield _found(size, f"{size.found}: over the {DATAGRAM} bytes of a datagram")


@lint_rule(
    "PQS503", Severity.WARNING, "the handshake has many fragments",
    why="The handshake uses a best-effort topic: if one fragment is lost, the whole message is lost"
    " and sent again a second later. With 40 fragments and 1 % loss, every third message is lost.",
    fix=f"{_SMALLER}, or raise General/FragmentSize and MaxMessageSize in Cyclone DDS.",
    measured="fragments counted at Cyclone DDS's default of 1344 bytes",
    bad="$ pqsec -k k issue --force /talker $(printf -- '--publish rt/robot/sensor%s ' {1..1100})",
    good="$ pqsec -k k issue --force /talker --publish 'rt/robot/sensor*'",
)  # fmt: skip
def many_fragments(inventory: Inventory) -> Iterator[Violation]:
    for size in largest_messages(inventory):
        if (number := -(-size.message // FRAGMENT)) > MANY:
            yield _found(size, f"{size.found}: {number} fragments, which must all arrive")


@lint_rule(
    "PQS504", Severity.WARNING, "the handshake is too large for pqsec peers",
    why="A pqsec peer limits what it reads from a participant that is not authenticated yet. Stacks"
    " differ: Cyclone DDS and Fast DDS (3.6.2) accepted 512 KB.",
    measured="the limit is pqsec's own",
    fix=f"{_SMALLER}.",
    bad="$ pqsec -k k issue --force /talker $(printf -- '--publish rt/robot/sensor%s ' {1..8000})",
    good="$ pqsec -k k issue --force /talker --publish 'rt/robot/sensor*'",
)  # fmt: skip
def over_own_limit(inventory: Inventory) -> Iterator[Violation]:
    for size in largest_messages(inventory):
        if size.message > MAX_TOKEN:
            yield _found(size, f"{size.found}: pqsec peers read at most {MAX_TOKEN}")


@lint_rule(
    "PQS505", Severity.WARNING, "a start of all participants may exceed the memory for fragments",
    why="Linux holds at most 4 MB of incomplete datagrams (net.ipv4.ipfrag_high_thresh). If all"
    " participants start at once and send messages in large datagrams, as Fast DDS does and Cyclone"
    " DDS by default, a host loses what is over it, and each loss costs a second or more.",
    fix="Send small datagrams (`pqsec export cyclonedds` sets 1300 bytes), raise"
    " net.ipv4.ipfrag_high_thresh on each host, or start in stages; `pqsec estimate` predicts it.",
    measured="Linux; memory counted at 2304 bytes for each frame of the largest message",
    bad="""
        $ pqsec -k large ca init --no-passphrase --profile cnsa2
        $ pqsec -k large issue --publish chatter $(printf '/robot%s ' {1..110})
    """,
    good="""
        $ mv large elsewhere/
        $ pqsec -k small ca init --no-passphrase --profile classical
        $ pqsec -k small issue --publish chatter $(printf '/robot%s ' {1..20})
    """,
)  # fmt: skip
def over_reassembly_memory(inventory: Inventory) -> Iterator[Violation]:
    held = [frames_of(each) * FRAME_MEMORY for each in _of_participants(inventory)]
    needed = sum(held) - min(held, default=0)
    if needed > IPFRAG_HIGH_THRESH:
        yield Violation(
            f"the messages of {len(held)} participants may take {needed} bytes of a host's memory"
            f" for fragments, which has {IPFRAG_HIGH_THRESH}"
        )


def _of_participants(inventory: Inventory) -> Iterable[int]:
    """The size for each participant: of its sets of credentials, it uses one with a peer."""
    largest: dict[object, int] = {}
    for each in largest_messages(inventory):
        one = each.enclave.name if inventory.keystore else each.enclave.folder
        largest[one] = max(each.message, largest.get(one, 0))
    return largest.values()


def reply_size(
    certificate: Certificate, permissions: bytes, row: SignatureAlgorithm, agreement: KeyAgreement
) -> int:
    """Bytes of the Reply, at most (`MessageSizes.of`)."""
    return _reply_size(len(certificate.pem), len(permissions), row, agreement)


@lru_cache(maxsize=256)
def _reply_size(
    certificate: int, permissions: int, row: SignatureAlgorithm, agreement: KeyAgreement
) -> int:
    """For a certificate and permissions of so many bytes, which in a fleet are nearly all alike."""
    introduction = Introduction(
        certificate=bytes(certificate),
        permissions=bytes(permissions),
        participant_data=participant_data(bytes(GUID_SIZE)),
        signature_algorithm=row.wire_name.encode() + b"\0",
        key_agreement=agreement.wire_name.encode() + b"\0",
    )
    return MessageSizes.of(introduction, agreement, row.signature_size).reply


def largest_messages(
    inventory: Inventory, profile: Profile | None = None
) -> Iterator[LargestMessage]:
    """For each participant, between pqsec peers of `profile`, else of that of its set of
    credentials; without both, for stock stacks."""
    for enclave in inventory.enclaves:
        own = profile or inventory.profile_of(enclave.folder)
        if found := _largest_message(enclave, own):
            yield found


def _largest_message(enclave: EnclaveFolder, profile: Profile | None) -> LargestMessage | None:
    """Between pqsec peers of `profile`, or for stock stacks; None if it cannot have one."""
    certificate, file = enclave.certificate(), enclave.files.get(PERMISSIONS)
    key = _key(certificate, profile) if certificate else None
    if certificate is None or file is None or key is None:
        return None
    agreement = profile.key_agreement if profile else MODP_RAW
    return LargestMessage(
        enclave,
        message=reply_size(certificate, file.data, key.algorithm, agreement),
        certificate=len(certificate.pem),
        permissions=len(file.data),
        profile=profile.name if profile else "",
    )


def _key(certificate: Certificate, profile: Profile | None) -> PublicKey | None:
    """The key that signs the handshake: the strongest for pqsec peers, else a classical one."""
    try:
        key = certificate.handshake_keys[0] if profile else certificate.public_key
    except PqsecError:
        return None
    return key if profile or key.algorithm.family is Family.CLASSICAL else None


def _found(size: LargestMessage, words: str) -> Violation:
    return Violation(words, path=size.enclave.folder)
