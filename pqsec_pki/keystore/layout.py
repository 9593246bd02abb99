"""The paths of a keystore: SROS2's layout, and the files that post-quantum keys add.

pqsec.json                          profiles and default domains
[groups.json]                       the groups of the domain file
public/   identity_ca.cert.pem permissions_ca.cert.pem [permissions_ca.alt.cert.pem]
          [identity_ca.crl.pem] [ledger.checkpoint ledger.tree]
private/  identity_ca.key.pem permissions_ca.key.pem [*.alt.key.pem] ledger.sqlite3
          [next_identity_ca.key.pem next_identity_ca.alt.key.pem] [generations/<number>/]
enclaves/ governance.xml governance.p7s
enclaves/<path>/  cert.pem key.pem [alt.key.pem] permissions.xml permissions.p7s
                  and links to the governance, the CA certificates, and as crl.pem to the list
sets/<profile>/   public/ private/ enclaves/ of each further set, without ledger and its heads
"""

import os
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path, PurePosixPath

from pqsec_pki import credentials
from pqsec_pki._files import exists, walk
from pqsec_pki.errors import UsageError, shown

SETTINGS = "pqsec.json"
GROUPS = "groups.json"
PUBLIC, PRIVATE, ENCLAVES = "public", "private", credentials.ENCLAVES
SETS = "sets"
"""The folder of further sets. Which ones a keystore has is in its settings and its ledger."""
JOURNAL, PREPARED = ".journal", ".prepared"
"""A change after its commit, and just before it."""
MOVES = "moves.json"
"""In both: what remains to be done."""
GENERATIONS = f"{PRIVATE}/generations"
"""CAs that have been replaced, in folders numbered from 1."""
LEDGER = "ledger.sqlite3"
LEDGER_FILES = tuple(LEDGER + each for each in ("", "-wal", "-shm", "-journal"))
"""The ledger, and what SQLite of an earlier pqsec left beside it."""
SEEN = "seen.json"
"""In `private/`: the participants' files that were right. Without it, all files are read."""
TREE_HEAD, TREE = "ledger.checkpoint", "ledger.tree"
"""In `public/`: the newest signed head of the ledger, and what is needed to extend its tree."""

CERTIFICATE, KEY, ALT_KEY, KEYS = (
    credentials.CERTIFICATE,
    credentials.KEY,
    credentials.ALT_KEY,
    credentials.KEYS,
)
IDENTITY_CA, PERMISSIONS_CA = credentials.IDENTITY_CA, credentials.PERMISSIONS_CA
PERMISSIONS_ALT_CA = credentials.PERMISSIONS_ALT_CA
IDENTITY_KEY, IDENTITY_ALT_KEY = "identity_ca.key.pem", "identity_ca.alt.key.pem"
NEXT_KEY, NEXT_ALT_KEY = "next_identity_ca.key.pem", "next_identity_ca.alt.key.pem"
"""Keys of the identity CA that will issue next, between `begin` and `switch` of an overlap."""
PERMISSIONS_KEY, PERMISSIONS_ALT_KEY = "permissions_ca.key.pem", "permissions_ca.alt.key.pem"

REQUEST = credentials.REQUEST
"""The request for which the certificate was issued, if its keys were made elsewhere."""
CA_LIST, LIST = "identity_ca.crl.pem", credentials.REVOCATION_LIST
"""The identity CA's revocation list, if there is one, and the link to it in each enclave."""
PERMISSIONS_XML, PERMISSIONS = "permissions.xml", credentials.PERMISSIONS
GOVERNANCE_XML, GOVERNANCE = "governance.xml", credentials.GOVERNANCE

OWN = (CERTIFICATE, *KEYS, PERMISSIONS, REQUEST)
"""The files of one participant: a folder with one of them is a participant's."""
_OWN = frozenset(OWN)

FIRST = ""
"""The name of the first set of credentials; that of a further one is its profile's."""

_SEGMENT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_RESERVED = re.compile(r".*\.(pem|p7s|xml|p11)")
"""Names like those of files in enclave folders: a folder with such a name could replace one."""


def in_set(name: str, place: str) -> str:
    """The place in the set called `name`, relative to the keystore; `place` is so to the set."""
    return place if name == FIRST else f"{SETS}/{name}/{place}"


@lru_cache(maxsize=64)
def enclave_name(text: str) -> str:
    """`text` as an enclave path: absolute, with single slashes.

    UsageError if it cannot be a folder, a CN and a ROS 2 enclave.
    """
    segments = [segment for segment in text.split("/") if segment]
    for segment in segments:
        if not _SEGMENT.fullmatch(segment) or _RESERVED.fullmatch(segment):
            raise UsageError(
                f"'{shown(text)}' cannot be a participant's name:"
                f" '{shown(segment)}' is not allowed in it",
                hint="write names like /talker or /fleet/robot1: letters, digits, _ - and .;"
                " in patterns also * and **",
            )
    if not segments:
        raise UsageError(f"'{shown(text)}' cannot be a participant's name", hint="write /talker")
    return "/" + "/".join(segments)


def enclave_folder(name: str) -> str:
    """The folder of the enclave `name`, relative to the keystore."""
    return f"{ENCLAVES}{name}"


def is_there(root: Path, name: str) -> bool:
    """Whether the keystore at `root` has any file of the enclave `name`.

    FileError if the system does not answer.
    """
    folder = f"{root}/{enclave_folder(name)}"
    return any(exists(f"{folder}/{each}", follow=False) for each in OWN)


def document_folder(root: Path, kind: str, path: Path) -> str | None:
    """The folder, relative to `root`, of the governance or permissions file `path`.

    None if `path` is not a place of the keystore's signed documents of that kind.
    """
    enclaves = os.path.realpath(root / ENCLAVES)
    folder = Path(os.path.realpath(path.parent))
    if path.name != f"{kind}.p7s" or not folder.is_relative_to(enclaves):
        return None
    inside = folder.relative_to(enclaves).as_posix()
    if (inside == ".") is not (path.name == GOVERNANCE):
        return None
    if path.name == PERMISSIONS and not exists(folder / CERTIFICATE):
        return None
    return ENCLAVES if inside == "." else f"{ENCLAVES}/{inside}"


CA_TARGETS = {name: f"{PUBLIC}/{name}" for name in (IDENTITY_CA, PERMISSIONS_CA)}
ALT_TARGET = {PERMISSIONS_ALT_CA: f"{PUBLIC}/{PERMISSIONS_ALT_CA}"}
LIST_TARGET = {LIST: f"{PUBLIC}/{CA_LIST}"}


def shared_links(name: str, shared: dict[str, str]) -> dict[str, str]:
    """Link in `name`'s folder -> its relative target."""
    up = "../" * len(PurePosixPath(enclave_folder(name)).parts)
    return {link: up + target for link, target in shared.items()}


def missing_links(root: Path, name: str, shared: dict[str, str]) -> dict[str, str]:
    """The links of `shared_links` that the keystore at `root` lacks, or that lead elsewhere."""
    folder = f"{root}/{enclave_folder(name)}"
    return {
        link: target
        for link, target in shared_links(name, shared).items()
        if _goal(f"{folder}/{link}") != target
    }


def missing_list_links(root: Path) -> Iterator[tuple[str, str]]:
    """The place and the target of each link to the revocation list that an enclave lacks."""
    for name in names_in(root):
        for link, target in missing_links(root, name, LIST_TARGET).items():
            yield f"{enclave_folder(name)}/{link}", target


def _goal(path: str) -> str | None:
    """The target of the link at `path`; None if there is no link."""
    try:
        return os.readlink(path)  # noqa: PTH115 -- for thousands of links
    except OSError:
        return None


def names_in(root: Path) -> list[str]:
    """The enclaves under `root` that have a certificate, sorted.

    FileError if a folder cannot be read.
    """
    names, _ = enclaves_in(root)
    return names


def enclaves_in(root: Path) -> tuple[list[str], list[str]]:
    """The enclaves of `names_in`, and folders with a participant's files but no certificate."""
    names, incomplete = list[str](), list[str]()
    for name, files in _enclaves_in(root):
        if CERTIFICATE in files and exists(f"{root}/{ENCLAVES}{name}/{CERTIFICATE}"):
            names.append(name or "/.")
        elif name and not _OWN.isdisjoint(files):
            incomplete.append(name)
    return sorted(names), sorted(incomplete)


def _enclaves_in(root: Path) -> Iterator[tuple[str, list[str]]]:
    """Each folder below `enclaves/` as a name, such as /fleet/robot1, with what is in it.

    The name of `enclaves/` itself is empty.
    """
    enclaves = root / ENCLAVES
    for folder, files in walk(enclaves):
        yield str(folder)[len(str(enclaves)) :], files
