"""Archives and parcels: the same bytes for the same files, and nothing hostile gets in."""

import gzip
import io
import json
import tarfile

import pytest

from pqsec_pki.enrolment import tarball
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.errors import MalformedError, VerificationError

FILES = {"a/b.pem": b"one", "manifest.json": b"{}", "c+d": b""}


def packed(*members, **options):
    """An archive of (name, content) or (name, content, what else its header says)."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", **{"format": tarfile.USTAR_FORMAT, **options}) as tar:
        for name, content, *header in members:
            info = tarfile.TarInfo(name)
            info.size = len(content)
            for key, value in header[0].items() if header else ():
                setattr(info, key, value)
            tar.addfile(info, io.BytesIO(content))
    return gzip.compress(out.getvalue(), mtime=0)


def test_files_come_back_and_the_same_files_are_the_same_bytes():
    data = tarball.pack(FILES)
    assert tarball.unpack(data) == FILES
    assert tarball.pack(dict(reversed(FILES.items()))) == data


@pytest.mark.parametrize("name", ["a", "enclaves/r/cert.pem", "n" * 100, "d" * 60 + "/" + "n" * 60])
@pytest.mark.parametrize("size", [0, 513, tarball.MAX_CONTENT])
def test_a_header_is_that_of_tarfile(name, size):
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o600
    assert tarball._header(name, size) == member.tobuf(tarfile.USTAR_FORMAT)


def test_other_tools_read_it():
    with tarfile.open(fileobj=io.BytesIO(tarball.pack(FILES))) as tar:
        assert tar.getnames() == sorted(FILES)
        assert {member.mtime for member in tar} == {0}


@pytest.mark.parametrize(
    "name",
    [
        *("../key.pem", "/etc/passwd", "a/../b", "..", ".", "./a", "a//b", "a/", "", ".hidden"),
        *("a/.draft", "a\nb", "C:\\b", "a b", "ä", "a\\..\\b"),
    ],
)
def test_a_name_that_leads_elsewhere_is_refused(name):
    with pytest.raises(MalformedError, match=r"has a file called|not a plain file"):
        tarball.unpack(packed((name, b"x")))


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        (tarfile.SYMTYPE, "symbolic link"),
        (tarfile.LNKTYPE, "hard link"),
        (tarfile.DIRTYPE, "folder"),
        (tarfile.CHRTYPE, "device"),
        (tarfile.FIFOTYPE, "pipe"),
        (tarfile.CONTTYPE, "contiguous file"),
        (tarfile.GNUTYPE_SPARSE, "sparse file"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_not_a_plain_file_is_refused(kind, what):
    with pytest.raises(MalformedError, match="not a plain file"):
        tarball.unpack(packed(("a", b"", {"type": kind, "linkname": "/etc/passwd"})))


def test_a_header_that_overrules_the_name_is_refused():
    member = ("a", b"x", {"pax_headers": {"path": "../b"}})
    with pytest.raises(MalformedError, match="not a plain file"):
        tarball.unpack(packed(member, format=tarfile.PAX_FORMAT))


def test_two_files_of_one_name_are_refused():
    with pytest.raises(MalformedError, match="has a twice"):
        tarball.unpack(packed(("a", b"1"), ("a", b"2")))


def test_more_files_than_the_limit_are_refused(monkeypatch):
    monkeypatch.setattr(tarball, "MAX_MEMBERS", 2)
    tarball.unpack(packed(("a", b""), ("b", b"")))
    with pytest.raises(MalformedError, match="more than 2 files"):
        tarball.unpack(packed(("a", b""), ("b", b""), ("c", b"")))


def test_a_little_that_unpacks_to_too_much_is_refused():
    assert tarball.unpack(gzip.compress(bytes(tarball.MAX_CONTENT), mtime=0)) == {}
    bomb = gzip.compress(bytes(tarball.MAX_CONTENT + 1), mtime=0)
    assert len(bomb) < 100_000
    with pytest.raises(MalformedError, match="more than"):
        tarball.unpack(bomb)


def test_an_archive_over_the_limit_is_not_looked_at():
    with pytest.raises(MalformedError, match="no plain gzip header"):
        tarball.unpack(bytes(tarball.MAX_ARCHIVE))
    with pytest.raises(MalformedError, match="larger than"):
        tarball.unpack(bytes(tarball.MAX_ARCHIVE + 1))


GOOD = tarball.pack(FILES)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no plain gzip header"),
        (b"PK\3\4", "no plain gzip header"),
        (GOOD[:-4], "incomplete"),
        (GOOD[:40], "incomplete"),
        (GOOD + b"x", "there is data after the archive"),
        (GOOD + GOOD, "there is data after the archive"),
        (GOOD[:-8] + bytes(8), "damaged"),
        (gzip.compress(b"no tar at all" * 99, mtime=0), "not an archive"),
        (gzip.compress(GOOD, mtime=1), "no plain gzip header"),
    ],
)
def test_what_is_no_archive_is_refused(data, words):
    with pytest.raises(MalformedError, match=words):
        tarball.unpack(data)


def test_a_header_that_promises_more_than_there_is_is_refused():
    raw = gzip.decompress(packed(("a", b"x" * 600)))
    with pytest.raises(MalformedError, match=r"not an archive|ends within a"):
        tarball.unpack(gzip.compress(raw[:700], mtime=0))


# Parcels

PARCEL = Archive("letter", {"names": ["/a"], "at": "2026-01-01T00:00:00+01:00"}, {"a": b"1"})


def repacked(**changes):
    """PARCEL with files replaced, left out (None) or added after its manifest was written."""
    files = tarball.unpack(PARCEL.pack()) | changes
    return tarball.pack({name: data for name, data in files.items() if data is not None})


def test_a_parcel_comes_back_with_what_its_manifest_says():
    found = Archive.unpack(PARCEL.pack(), "letter")
    assert found.files == PARCEL.files
    assert found.texts("names") == ("/a",)
    assert found.time("at").isoformat() == "2025-12-31T23:00:00+00:00"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"a": b"2"}, "a differs from the manifest"),
        ({"a": None}, "a is missing"),
        ({"b": b"3"}, "b is not in the manifest"),
    ],
)
def test_a_parcel_whose_files_are_not_the_manifests_is_refused(changes, words):
    with pytest.raises(VerificationError, match=words):
        Archive.unpack(repacked(**changes), "letter")


@pytest.mark.parametrize(
    ("manifest", "words"),
    [
        (None, "no readable manifest"),
        (b"", "no readable manifest"),
        (b"[]", "no readable manifest"),
        (b"[" * 100_000, "no readable manifest"),
        (b'{"format": 1, "kind": "letter", "files": 3}', "no readable manifest"),
        (b'{"format": 9, "kind": "letter", "files": {}}', "another version"),
        (b'{"format": 1, "kind": "bill", "files": {}}', "a bill, not a letter"),
    ],
)
def test_a_manifest_that_cannot_be_read_is_refused(manifest, words):
    with pytest.raises(MalformedError, match=words):
        Archive.unpack(repacked(**{"manifest.json": manifest}), "letter")


@pytest.mark.parametrize("value", [None, 3, ["/a", 3], {"a": 1}])
def test_a_manifest_that_says_something_else_than_texts_is_refused(value):
    parcel = Archive("letter", json.loads(json.dumps({"names": value})), {})
    found = Archive.unpack(parcel.pack(), "letter")
    for ask in (found.text, found.texts, found.time):
        with pytest.raises(MalformedError, match="the manifest lacks names"):
            ask("names")


@pytest.mark.parametrize("text", ["yesterday", "2026-13-01", "0001-01-01T00:00:00+23:00"])
def test_a_time_of_a_manifest_that_is_none_is_refused(text):
    found = Archive.unpack(Archive("letter", {"created": text}, {}).pack(), "letter")
    with pytest.raises(MalformedError, match="the manifest lacks created"):
        found.time("created")
