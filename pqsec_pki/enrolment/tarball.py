"""Archives: tar in gzip, the same bytes for the same files.

An archive is untrusted input. It may contain only plain files with relative names, within
limits of number and size, and nothing is unpacked to the disk.
"""

import io
import re
import tarfile
import zlib
from collections.abc import Iterator, Mapping

from pqsec_pki.errors import MalformedError, TooLargeError, library_call, shown, words_of

MAX_ARCHIVE = 32 << 20
"""Bytes, compressed. A participant with profile cnsa2 has 60 kB."""
MAX_CONTENT = 64 << 20
"""Bytes, uncompressed: deflate can expand a thousandfold."""
MAX_MEMBERS = 20_000
"""Files: enough for two thousand participants."""
_FEWER = "write several, each for fewer participants"
_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9_.+-]*(/[A-Za-z0-9_+-][A-Za-z0-9_.+-]*)*")
"""Relative paths; no part begins with a dot, so none is `.` or `..`."""
_GZIP = bytes.fromhex("1f8b0800000000")
"""Deflate, no name, no time; the next bytes are the compression level and the system."""
_MODE = 0o600
_SHORT_NAME = 100
"""Octets of a name that need no second field."""
_REST = b"0" + bytes(100) + b"ustar\x0000" + bytes(247)
"""What follows the checksum in the header of a plain file: the type, no link, no owner."""
_GZIPPED = 31
"""The `wbits` of zlib for gzip only."""


def pack(files: Mapping[str, bytes]) -> bytes:
    """The archive of `files`, by name. TooLargeError for one that `unpack` would refuse."""
    TooLargeError.check("the archive", len(files), MAX_MEMBERS, hint=_FEWER, unit="files")
    blocks = [block for name in sorted(files) for block in _member(name, files[name])]
    out = b"".join([*blocks, bytes(2 * tarfile.BLOCKSIZE)])  # which is the end of an archive
    # Keys and signatures hardly repeat: to search for more takes twice the time, and gains 8 %.
    TooLargeError.check("the archive", len(out), MAX_CONTENT, hint=_FEWER, unit="bytes of content")
    packer = zlib.compressobj(1, wbits=_GZIPPED, strategy=zlib.Z_RLE)
    packed = packer.compress(out) + packer.flush()
    TooLargeError.check("the archive", len(packed), MAX_ARCHIVE, hint=_FEWER)
    return packed


def _member(name: str, content: bytes) -> tuple[bytes, ...]:
    return _header(name, len(content)), content, bytes(-len(content) % tarfile.BLOCKSIZE)


def _header(name: str, size: int) -> bytes:
    """The header of a plain file, octet by octet as tarfile writes it, which takes much longer."""
    if not name.isascii() or len(name) > _SHORT_NAME:
        member = tarfile.TarInfo(name)
        member.size, member.mode = size, _MODE
        return member.tobuf(tarfile.USTAR_FORMAT)
    begin = f"{name:\0<100}{_MODE:07o}\0{0:07o}\0{0:07o}\0{size:011o}\0{0:011o}\0".encode()
    total = sum(begin) + sum(_REST) + 8 * ord(" ")  # where the checksum itself is
    return b"%s%06o\0 %s" % (begin, total, _REST)


def unpack(data: bytes) -> dict[str, bytes]:
    """The files in the archive `data`, by name.

    MalformedError if it is not an archive, is too large, or has anything but plain files
    with plain names.
    """
    content = _inflated(data)
    files: dict[str, bytes] = {}
    end = 0
    with (
        library_call(lambda error: MalformedError(f"not an archive: {words_of(error)}")),
        tarfile.open(fileobj=io.BytesIO(content), mode="r:") as tarball,
    ):
        for member in _members(tarball):
            if member.name in files:
                raise MalformedError(f"the archive has {member.name} twice")
            file = tarball.extractfile(member)
            files[member.name] = file.read() if file else b""
            if len(files[member.name]) != member.size:
                raise MalformedError(f"the archive ends within {member.name}")
            end = member.offset_data + -(-member.size // tarfile.BLOCKSIZE) * tarfile.BLOCKSIZE
    if content[end:].strip(b"\0"):  # tarfile reports an end where it cannot read on
        raise MalformedError("the archive has something after its last file")
    return files


def _inflated(data: bytes) -> bytes:
    if len(data) > MAX_ARCHIVE:
        raise MalformedError(f"the archive is larger than {MAX_ARCHIVE} bytes")
    if not data.startswith(_GZIP):
        raise MalformedError("not an archive of pqsec: no plain gzip header")
    machine = zlib.decompressobj(_GZIPPED)
    with library_call(lambda error: MalformedError(f"the archive is damaged: {words_of(error)}")):
        content = machine.decompress(data, MAX_CONTENT + 1)
    if len(content) > MAX_CONTENT:
        raise MalformedError(f"the archive has more than {MAX_CONTENT} bytes of content")
    if not machine.eof:
        raise MalformedError("the archive is incomplete")
    if machine.unused_data:
        raise MalformedError("there is data after the archive")
    return content


def _members(tarball: tarfile.TarFile) -> Iterator[tarfile.TarInfo]:
    for count, member in enumerate(tarball, start=1):
        if count > MAX_MEMBERS:
            raise MalformedError(f"the archive has more than {MAX_MEMBERS} files")
        # Not isreg(): that accepts sparse files too, whose size is only claimed.
        if member.type != tarfile.REGTYPE or member.pax_headers or member.sparse is not None:
            raise MalformedError(f"{shown(member.name)} in the archive is not a plain file")
        if not _NAME.fullmatch(member.name):
            raise MalformedError(f"the archive has a file called {shown(member.name)!r}")
        yield member
