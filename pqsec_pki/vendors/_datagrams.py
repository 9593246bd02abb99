"""Notes about handshake messages that need several datagrams or IP fragments.

By default, stacks send a message in datagrams larger than an Ethernet frame. Sources of the
settings' names: Cyclone DDS was run with them; Fast DDS's property is in its documents and in the
library of 3.1.2, not of 2.9.1; those of OpenDDS and Connext are in their documents, not run.
"""

from collections.abc import Iterator, Mapping

from pqsec_pki.stacks import FRAME_MEMORY, IPFRAG_HIGH_THRESH, SMALL_FRAGMENT, Stack, frames_of
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import Options
from pqsec_pki.vendors.own_plugin import FASTRTPS

MAX_MESSAGE = 1400
"""Bytes of a datagram with SMALL_FRAGMENT of a message."""
_FAST_DDS = f"the participant's property fastdds.max_message_size={MAX_MESSAGE} (not in 2.9.1)"
_CYCLONE = (
    f"General/MaxMessageSize {MAX_MESSAGE}B and FragmentSize {SMALL_FRAGMENT}B in CYCLONEDDS_URI"
)
_AVOIDED_BY: Mapping[str, str] = {
    Stack.FASTDDS: _FAST_DDS,
    Stack.OPENDDS: f"SedpMaxMessageSize={MAX_MESSAGE} in its [rtps_discovery/NAME]",
    Stack.CONNEXT: f"dds.transport.UDPv4.builtin.parent.message_size_max={MAX_MESSAGE}",
    Stack.ROS2: f"{_CYCLONE}; or, under rmw_fastrtps, {_FAST_DDS}",
}
"""Settings that make the datagrams small, for stacks whose export does not."""


def notes(stack: str, enclave: StackEnclave, options: Options, size: int) -> Iterator[str]:
    """Sentences about datagrams and memory, if the largest message has `size` bytes."""
    frames = frames_of(size)
    if not enclave.has_large_handshake or frames <= 1:
        return
    if _limits(stack, options):
        yield (
            f"handshake messages have up to {size} bytes; the export limits datagrams to"
            f" {MAX_MESSAGE} bytes, which IP does not fragment at an MTU of 1500"
        )
        return
    held = frames * FRAME_MEMORY
    remedy = f". Smaller datagrams: {_AVOIDED_BY[stack]}" if stack in _AVOIDED_BY else ""
    yield (
        f"handshake messages have up to {size} bytes: in one datagram {frames} IP fragments at an"
        f" MTU of 1500, and the loss of one loses the message{remedy}"
    )
    yield (
        f"Linux holds {IPFRAG_HIGH_THRESH} bytes of incomplete datagrams"
        f" (net.ipv4.ipfrag_high_thresh): of {IPFRAG_HIGH_THRESH // held} peers that start at once."
        f" For more peers, set it to {held} for each"
    )


def _limits(stack: str, options: Options) -> bool:
    """Whether the export itself limits datagrams."""
    in_ros = stack is Stack.ROS2 and options.plugin is not None and options.runs_in != FASTRTPS
    return stack is Stack.CYCLONEDDS or in_ros
