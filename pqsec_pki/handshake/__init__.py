"""The DDS:Auth:PKI-DH handshake: three messages, one secret, one protected message.

Only the protocol: no files, no sockets, no clock; the caller transports the messages. It
implements DDS-Security 1.1 for stock stacks, and post-quantum suites between pqsec peers.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.handshake._cdr import ByteOrder
    from pqsec_pki.handshake._checks import check
    from pqsec_pki.handshake.choice import (
        PolicyRow,
        StockPeers,
        refuse_weak_set,
        set_of,
        set_to_ask_with,
        stock_name,
    )
    from pqsec_pki.handshake.compact import (
        CREDENTIALS_DICTIONARY,
        FIRST_ONLY,
        WireVersion,
        check_carried,
        compacted,
        expanded,
    )
    from pqsec_pki.handshake.confirming import confirmation, confirmed, token_message
    from pqsec_pki.handshake.conventions import MessageConventions
    from pqsec_pki.handshake.guid import (
        adjusted_guid,
        belongs_to,
        initiates,
        participant_data,
        participant_guid,
    )
    from pqsec_pki.handshake.key_exchange import (
        KeyMaterial,
        TransformationKind,
        key_exchange_material,
    )
    from pqsec_pki.handshake.messages import (
        CHALLENGE_SIZE,
        HASH_SIZE,
        AuthRequest,
        Final,
        Introduction,
        Reply,
        Request,
        Transcript,
    )
    from pqsec_pki.handshake.participants import (
        Discovered,
        Identity,
        PeerRequirements,
        RemotePeer,
        Terms,
        peer_certificate,
    )
    from pqsec_pki.handshake.protection import (
        Sender,
        unprotect_payload,
        unprotect_submessage,
    )
    from pqsec_pki.handshake.sizes import MessageSizes
    from pqsec_pki.handshake.states import Done, ReplySent, RequestSent, begin, reply_to
    from pqsec_pki.handshake.tokens import IdentityToken, PermissionsToken
    from pqsec_pki.handshake.wire import (
        GUID_SIZE,
        MAX_SAMPLE,
        MAX_TOKEN,
        DataHolder,
        GenericMessage,
        MessageClass,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "CHALLENGE_SIZE",
    "CREDENTIALS_DICTIONARY",
    "FIRST_ONLY",
    "GUID_SIZE",
    "HASH_SIZE",
    "MAX_SAMPLE",
    "MAX_TOKEN",
    "AuthRequest",
    "ByteOrder",
    "DataHolder",
    "Discovered",
    "Done",
    "Final",
    "GenericMessage",
    "Identity",
    "IdentityToken",
    "Introduction",
    "KeyMaterial",
    "MessageClass",
    "MessageConventions",
    "MessageSizes",
    "PeerRequirements",
    "PermissionsToken",
    "PolicyRow",
    "RemotePeer",
    "Reply",
    "ReplySent",
    "Request",
    "RequestSent",
    "Sender",
    "StockPeers",
    "Terms",
    "Transcript",
    "TransformationKind",
    "WireVersion",
    "adjusted_guid",
    "begin",
    "belongs_to",
    "check",
    "check_carried",
    "compacted",
    "confirmation",
    "confirmed",
    "expanded",
    "initiates",
    "key_exchange_material",
    "participant_data",
    "participant_guid",
    "peer_certificate",
    "refuse_weak_set",
    "reply_to",
    "set_of",
    "set_to_ask_with",
    "stock_name",
    "token_message",
    "unprotect_payload",
    "unprotect_submessage",
]
