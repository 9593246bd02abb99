"""Messages between the agent and its workers, which may carry an open file or socket."""

import os
import socket

from pqsec_pki.plugin.octets import MessageReader, MessageWriter

MAX_MESSAGE = 1 << 16
"""Octets. The longest has the number of objects of each connection."""

SERVE, STATUS, GONE = "serve", "status", "gone"


def pair() -> tuple[socket.socket, socket.socket]:
    """Both ends of a channel, which keeps messages apart. OSError if no file is left."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def put(channel: socket.socket, message: MessageWriter, *handles: int) -> None:
    """Send it with copies of these files. OSError if that is not possible."""
    socket.send_fds(channel, [message.octets], handles)


def take(channel: socket.socket) -> tuple[MessageReader, int | None] | None:
    """The next message and the file in it; None if the other end has gone."""
    try:
        octets, handles, *_ = socket.recv_fds(channel, MAX_MESSAGE, 1)
    except ConnectionError:
        octets, handles = b"", []
    if octets:
        return MessageReader(octets), handles[0] if handles else None
    for each in handles:
        os.close(each)
    return None


def message(kind: str) -> MessageWriter:
    """A new message, which begins with its kind."""
    writer = MessageWriter()
    writer.text(kind)
    return writer
