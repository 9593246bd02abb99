"""Archives that nobody packed: each trick of tar and gzip is refused, in our words."""

import gzip
import json
import tarfile

import pytest

from pqsec_pki.enrolment import tarball
from pqsec_pki.enrolment.archive import MAX_MANIFEST, Archive
from pqsec_pki.errors import MalformedError

END = bytes(1024)
HUGE, NEGATIVE = b"\x80" + b"\x7f" * 11, b"\xff" * 10 + b"\xfe\x00"
"""Sizes in base 256: past every limit, and -512."""


def member(kind=tarfile.REGTYPE, data=b"", *, name="b", size=None, sparse=0):
    """A header and its data; `size` is written instead of the true one."""
    info = tarfile.TarInfo(name)
    info.type, info.size = kind, len(data)
    header = bytearray(info.tobuf(tarfile.GNU_FORMAT)[-512:])
    header[124:136] = size or header[124:136]
    header[482] = sparse  # in GNU's words: more of the map follows
    header[148:156] = b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header) + data + bytes(-len(data) % 512)


def pax(text, kind=tarfile.XHDTYPE):
    return member(kind, b"%d %s\n" % (len(text) + 4, text))


GOOD = member(data=b"x", name="good")
TRICKS = {
    "a symbolic link": (member(tarfile.SYMTYPE), "not a plain file"),
    "a hard link": (member(tarfile.LNKTYPE), "not a plain file"),
    "a device": (member(tarfile.BLKTYPE), "not a plain file"),
    "a pipe": (member(tarfile.FIFOTYPE), "not a plain file"),
    "a folder": (member(tarfile.DIRTYPE), "not a plain file"),
    "a file of the oldest kind": (member(tarfile.AREGTYPE), "not a plain file"),
    "a sparse file": (member(tarfile.GNUTYPE_SPARSE), "not a plain file"),
    "a sparse map that is cut": (member(tarfile.GNUTYPE_SPARSE, sparse=1), "not an archive"),
    "a name twice": (GOOD, "has good twice"),
    "an absolute name": (member(name="/b"), "a file called"),
    "a way up": (member(name="a/../b"), "a file called"),
    "a hidden file": (member(name=".b"), "a file called"),
    "no name": (member(name=""), "a file called"),
    "a name with a line break": (member(name="b\n"), r"a file called 'b\\+u000a'"),
    "a long name of GNU's": (member(tarfile.GNUTYPE_LONGNAME, b"../c\0") + GOOD, "a file called"),
    "a long name past every limit": (
        member(tarfile.GNUTYPE_LONGNAME, size=HUGE) + GOOD,
        "not an archive",
    ),
    "long names in long names": (
        member(tarfile.GNUTYPE_LONGNAME, b"c\0") * 5000 + GOOD,
        "not an archive",
    ),
    "a name in a pax header": (pax(b"path=../c") + GOOD, "not a plain file"),
    "a pax header for all": (pax(b"path=../c", tarfile.XGLTYPE) + GOOD, "not a plain file"),
    "a sparse map in a pax header": (pax(b"GNU.sparse.map=1,2") + GOOD, "not a plain file"),
    "a size past every limit": (member(size=HUGE), "not an archive"),
    # What Python 3.11.2 cannot read is the end to it.
    "a size below nothing": (member(size=NEGATIVE), "ends within b|after its last file"),
    "what is no header": (b"x" * 512 + member(), "after its last file"),
    "a header with a wrong sum": (b"c" + member()[1:], "after its last file"),
    "a file past the end": (END + member(), "after its last file"),
    "a size past the end": (member(size=b"00000100000\0"), "not an archive"),
}


@pytest.mark.parametrize(("trick", "words"), TRICKS.values(), ids=TRICKS)
def test_a_trick_is_refused(trick, words):
    with pytest.raises(MalformedError, match=words):
        tarball.unpack(gzip.compress(GOOD + trick, mtime=0))


def test_without_a_trick_it_is_read():
    assert tarball.unpack(gzip.compress(GOOD + member() + END, mtime=0)) == {"good": b"x", "b": b""}


# Quickly made, since each worker makes it.
BOMB = gzip.compress(bytes(tarball.MAX_CONTENT + 1), 1, mtime=0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (BOMB, "more than 67108864 bytes"),
        (gzip.compress(GOOD + END, mtime=0)[:-1], "incomplete"),
        (gzip.compress(GOOD + END, mtime=0) + b"x", "there is data after the archive"),
        (gzip.compress(GOOD + END, mtime=0) * 2, "there is data after the archive"),
        (gzip.compress(GOOD + END, mtime=1), "no plain gzip header"),
        (bytes(tarball.MAX_ARCHIVE + 1), "larger than"),
    ],
    ids=["bomb", "cut", "tail", "two", "time", "large"],
)
def test_what_gzip_can_do_to_hide_more_is_refused(data, words):
    with pytest.raises(MalformedError, match=words):
        tarball.unpack(data)


def test_more_files_than_any_bundle_has_are_refused():
    names = (member(name=f"n{number}") for number in range(tarball.MAX_MEMBERS + 1))
    with pytest.raises(MalformedError, match="more than 20000 files"):
        tarball.unpack(gzip.compress(b"".join(names) + END, 1, mtime=0))


def test_a_manifest_that_would_fill_the_memory_is_not_parsed():
    text = json.dumps({"format": 1, "kind": "bundle", "files": {}, "x": " " * MAX_MANIFEST})
    data = tarball.pack({"manifest.json": text.encode()})
    with pytest.raises(MalformedError, match="the manifest is larger than"):
        Archive.unpack(data, "bundle")
