"""What comes to a robot, or to CAs without a network: archives, whole or sealed.

Blind changes end at gzip's checksum. `spoilt` takes the archive apart, does to one member
what a packer with bad intent would, and packs it again, with the manifest's hashes right or not.
"""

import gzip
import hashlib
import io
import json
import shutil
import tarfile
import tempfile
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

from pqsec_pki.algorithms import SealingPrivateKey, profile_named
from pqsec_pki.certificates import certificate_request
from pqsec_pki.credentials import Credentials, logged_hashes, verify_logged
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    Bundle,
    SignRequest,
    accept,
    install,
    open_sealed,
    read_receipts,
    seal,
    sign,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, add_set, revoke
from pqsec_pki.transparency import HeadExtension, LedgerProof
from tests.fuzz import mutation
from tests.unit.keystores import DAY, NOW, made

FILES = ("cert.pem", "permissions.p7s", "governance.p7s")
NAME = "/fleet/robot1"
ROBOTS = (NAME, "/fleet/arm")
MANIFEST = "manifest.json"
BOMB = 1 << 27
"""Bytes, of zeros: twice what is let in."""


@cache
def home():
    """It goes when Python ends."""
    return tempfile.TemporaryDirectory(prefix="pqsec-fuzz-")


@cache
def keystore():
    """With a revocation list, so that bundles have all the files there are."""
    found = made(Path(home().name) / "k", "transition", names=(*ROBOTS, "/gone"))
    revoke(found, found.unlock(None), ["/gone"], now=NOW)
    return found


@cache
def several():
    """The same, with a second set of credentials; requests are for one set."""
    root = shutil.copytree(keystore().root, Path(home().name) / "several", symlinks=True)
    first, profile = Keystore.open(root, to_change=True), profile_named("pq")
    validity = 900 * DAY
    add_set(first, first.unlock(None), profile, validity=validity, passphrase=None, now=NOW)
    return Keystore.open(root, to_change=True)


@cache
def bundle():
    return Bundle.of(several(), ROBOTS, now=NOW)


@cache
def sealing_key():
    return SealingPrivateKey.generate()


@cache
def asked():
    """A request for two robots, as it travels to the CAs."""
    profile, names = profile_named("transition"), ("/new/a", "/new/b")
    requests = [
        certificate_request(name, profile.participant_key.generate(), second.generate())
        for name, second in zip(names, [profile.alternative_key] * 2, strict=True)
    ]
    specs = [
        ParticipantSpec(name=name, domains=DomainSet.of(0), publish=("t",), validity=90 * DAY)
        for name in names
    ]
    return SignRequest(tuple(requests), tuple(specs)).to_bytes(now=NOW)


@cache
def answer():
    opened = Keystore.open(keystore().root)
    return sign(SignRequest.from_bytes(asked()), opened, opened.unlock(None), now=NOW)


# Targets


def take_bundle(data):
    """Installed as it was issued, or not at all, and nothing is left of the attempt."""
    with tempfile.TemporaryDirectory(prefix="pqsec-fuzz-") as folder:
        file, root = Path(folder) / "b.bundle", Path(folder) / "robot"
        file.write_bytes(data)
        try:
            install(file, root, bundle().roles, now=NOW)
        except PqsecError:
            assert not root.exists(), sorted(root.rglob("*"))
            raise
        assert {each.name for each in Path(folder).iterdir()} == {"b.bundle", "robot"}
        for path in root.rglob("*"):
            assert path.is_symlink() == (path.name == "current"), path
            assert path.is_dir() or path.stat().st_nlink == 1, path
        for place, where in (("", "current"), ("pq", "current/sets/pq")):
            for name, files in Bundle.from_bytes(data).sets[place].items():
                for signed in ("permissions.p7s", "governance.p7s", "key.pem"):
                    assert (root / where / "enclaves" / name[1:] / signed).is_file()
                issued = bundle().sets[place][name]["cert.pem"]
                assert certified(files["cert.pem"]) == certified(issued)


def certified(pem):
    return b"".join(pem.split(b"-----")[2].split())


def take_proof(data):
    """It holds for what it was made for, whatever else is in it, or it is refused."""
    credentials = Credentials.of(NAME, bundle().enclaves[NAME])
    files = {each: bundle().enclaves[NAME][each] for each in FILES}
    own = verify_logged(NAME, credentials.anchors, files, LedgerProof.from_bytes(data))
    assert own.checkpoint.head == bundle().proof.checkpoint.head
    assert {each.sha256 for each in own.lines} == {sha256 for _, sha256 in logged_hashes(files)}


def head():
    checkpoint = bundle().proof.checkpoint
    return HeadExtension(checkpoint, 3, (checkpoint.head.root,) * 3).to_bytes()


def take_head(data):
    """The CAs signed exactly this, or it is refused."""
    found = HeadExtension.from_bytes(data)
    signers = (several().permissions_ca, several().countersigner)
    found.checkpoint.verify([each.public_key for each in signers])
    assert found.head == bundle().proof.checkpoint.head


def take_sealed(data):
    return Bundle.from_bytes(open_sealed(data, sealing_key()))


def take_request(data):
    found = SignRequest.from_bytes(data)
    assert [spec.name for spec in found.admitted(keystore().profiles)]
    return found


def take_answer(data):
    with tempfile.TemporaryDirectory(prefix="pqsec-fuzz-") as folder:
        out = Path(folder) / "out"
        try:
            accept(data, SignRequest.from_bytes(asked()), out, now=NOW)
        except PqsecError:
            assert not out.exists()
            raise
        assert sorted(each.name for each in out.iterdir()) == ["new+a.bundle", "new+b.bundle"]


@cache
def receipt():
    """What a robot writes that has installed the bundle."""
    file, root = Path(home().name) / "b.bundle", Path(home().name) / "robot"
    file.write_bytes(bundle().to_bytes())
    return install(file, root, bundle().roles, now=NOW).receipt.read_bytes()


def take_receipt(data):
    """Only what the robot said, whatever else of it was lost."""
    found = {each.receipt.sha256 for each in read_receipts(data)}
    assert found <= {each.receipt.sha256 for each in read_receipts(receipt())}


# Spoiling


def spoilt(data, rng, spoil):
    """An archive with one trick in it; what is none is only spoilt."""
    try:
        members = _members(data)
    except (OSError, EOFError, zlib.error, tarfile.TarError, ValueError, LookupError):
        return spoil(data)
    trick = rng.choice(TRICKS)
    with suppress(ValueError, KeyError, TypeError, AttributeError):  # of an archive spoilt before
        members = trick(members, rng, spoil)
        if rng.randint(0, 1):
            members = _with_right_hashes(members)
    packed = gzip.compress(_tar(members), 1, mtime=0)
    return rng.choice(WRAPS)(packed, rng, spoil) if rng.randint(0, 5) == 0 else packed


def _members(data):
    """(name, content, what else its header says) of each."""
    with tarfile.open(fileobj=io.BytesIO(gzip.decompress(data))) as tarball:
        return [
            (each.name, tarball.extractfile(each).read() if each.isreg() else b"", {})
            for each in tarball
        ]


def _tar(members):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.GNU_FORMAT) as tarball:
        for name, content, header in members:
            member = tarfile.TarInfo(name)
            member.size, member.mode = len(content), 0o600
            for key, value in header.items():
                setattr(member, key, value)
            tarball.addfile(member, io.BytesIO(content))
    return out.getvalue()


def _with_right_hashes(members):
    """The manifest says of each file what it is now: only signatures can tell then."""
    found = {name: content for name, content, _ in members}
    manifest = json.loads(found.pop(MANIFEST))
    manifest["files"] = {
        name: hashlib.sha256(content).hexdigest() for name, content in found.items()
    }
    text = json.dumps(manifest).encode()
    return [(n, text if n == MANIFEST else content, header) for n, content, header in members]


def _one(members, rng):
    return rng.randrange(len(members))


def rename(members, rng, spoil):
    index = _one(members, rng)
    name, content, header = members[index]
    new = rng.choice(
        [
            *(f"../{name}", f"/{name}", f"enclaves/../../{name}", f"./{name}", f"{name}/"),
            *(name.upper(), f"{name}\n", f"{name}\0x", name.replace("/", "//"), "", "."),
            *("private/identity_ca.key.pem", "enclaves/fleet/robot1/key.pem/x", "current"),
            *(members[_one(members, rng)][0], "x" * 300, "enclaves/\u202efleet/cert.pem"),
            spoil(name.encode()).decode(errors="replace").replace("\0", "0"),
        ]
    )
    return [*members[:index], (new, content, header), *members[index + 1 :]]


def retype(members, rng, _spoil):
    index = _one(members, rng)
    name, content, header = members[index]
    kinds = [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.DIRTYPE]
    kinds += [tarfile.FIFOTYPE, tarfile.CONTTYPE, tarfile.AREGTYPE, tarfile.GNUTYPE_SPARSE, b"Z"]
    where = rng.choice(["/etc/passwd", "../../../etc/passwd", members[0][0], "."])
    header = header | {"type": rng.choice(kinds), "linkname": where}
    return [*members[:index], (name, content, header), *members[index + 1 :]]


def double(members, rng, spoil):
    name, content, header = members[_one(members, rng)]
    again = (name, rng.choice([content, spoil(content), b""]), header)
    place = rng.randint(0, len(members))
    return [*members[:place], again, *members[place:]]


def drop(members, rng, _spoil):
    index = _one(members, rng)
    return [*members[:index], *members[index + 1 :]]


def swap(members, rng, _spoil):
    """One file's content stands in another's place: of the other robot, or another kind."""
    one, other = _one(members, rng), _one(members, rng)
    found = list(members)
    found[one] = (members[one][0], members[other][1], members[one][2])
    return found


def change(members, rng, spoil):
    index = _one(members, rng)
    name, content, header = members[index]
    content = mutation.in_pem(content, rng, spoil) if b"-----BEGIN" in content else spoil(content)
    return [*members[:index], (name, content, header), *members[index + 1 :]]


def bomb(members, rng, _spoil):
    index = _one(members, rng)
    name, _, header = members[index]
    return [*members[:index], (name, bytes(BOMB), header), *members[index + 1 :]]


def crowd(members, rng, _spoil):
    many = rng.choice([300, 20_001])
    return [*members, *((f"enclaves/n{number}", b"", {}) for number in range(many))]


def say(members, rng, spoil):
    """Another value in the manifest."""
    found = {name: content for name, content, _ in members}
    manifest = json.loads(found[MANIFEST])
    key = rng.choice([*manifest, "more"])
    values = [None, 1, -1, [], {}, "", ["/"], ["../x"], ["/fleet/arm"], {"x": 1}, 1e400, [[]]]
    values += [spoil(str(manifest.get(key)).encode()).decode(errors="replace"), "\ud800"]
    text = json.dumps(manifest | {key: rng.choice(values)}).encode()
    return [(n, text if n == MANIFEST else content, header) for n, content, header in members]


TRICKS = [rename, rename, retype, double, drop, swap, change, change, change, say, say, crowd, bomb]
WRAPS = [
    lambda data, _rng, _spoil: data * 2,
    lambda data, rng, _spoil: data[: rng.randrange(len(data))],
    lambda data, rng, _spoil: data + rng.randbytes(9),
    lambda data, _rng, _spoil: gzip.compress(data, mtime=0),
    lambda data, _rng, _spoil: gzip.decompress(data),
    lambda data, _rng, spoil: spoil(data),
    lambda data, _rng, _spoil: gzip.compress(gzip.decompress(data), mtime=7),
]


def spoilt_sealed(data, rng, spoil):
    """The seal broken, or something else sealed for the same robot: anybody can do that."""
    if rng.randint(0, 3) == 0:
        return spoil(data)
    return seal(spoilt(bundle().to_bytes(), rng, spoil), sealing_key().public_key)


TARGETS = {
    "bundle": (take_bundle, lambda: [bundle().to_bytes()], spoilt),
    "sealed-bundle": (
        take_sealed,
        lambda: [seal(bundle().to_bytes(), sealing_key().public_key)],
        spoilt_sealed,
    ),
    "sign-request": (take_request, lambda: [asked()], spoilt),
    "sign-answer": (take_answer, lambda: [answer()], spoilt),
    "receipt": (take_receipt, lambda: [receipt()], spoilt),
    "ledger-proof": (take_proof, lambda: [bundle().proof.to_bytes()]),
    "tree-head": (take_head, lambda: [head()]),
}
