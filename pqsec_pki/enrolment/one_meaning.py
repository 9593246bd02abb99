"""What all sets of credentials must have in common: whatever a reader takes, it means the same.

Each set was verified by itself before. The subjects of certificates are equal then, since each is
that of its participant's name.
"""

from collections.abc import Iterator, Mapping, Sequence

from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    PERMISSIONS,
    REVOCATION_LIST,
    VerifiedCredentials,
    alternative_spki,
)
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code, Problem


def differences(sets: Mapping[str, Sequence[VerifiedCredentials]]) -> Iterator[Problem]:
    """What differs between the first set and another, of the same participants in each.

    Documents with other content, a revocation list that only one of them has, and a key that is in
    two sets.
    """
    first = {each.name: each for each in sets[layout.FIRST]}
    for name, verified in sets.items():
        for each in verified if name != layout.FIRST else ():
            for problem in _between(first[each.name], each):
                yield problem.of(each.name).of(f"set {name}")
    yield from _shared_keys(sets)


def _between(first: VerifiedCredentials, other: VerifiedCredentials) -> Iterator[Problem]:
    documents = {
        GOVERNANCE: (first.governance.verified, other.governance.verified),
        PERMISSIONS: (first.permissions.verified, other.permissions.verified),
    }
    for file, (mine, theirs) in documents.items():
        if _text(mine.document) != _text(theirs.document):
            words = "it says something else than that of the first set"
            yield Problem(words, Code.CONTENT_CHANGED, file)
    has_list = [each.anchors.revocation_list is not None for each in (first, other)]
    if has_list[0] != has_list[1] and not (first.anchors.in_overlap or other.anchors.in_overlap):
        words = "the revocation list is missing in one of the sets"
        yield Problem(words, Code.LIST_MISSING, REVOCATION_LIST)


def _shared_keys(sets: Mapping[str, Sequence[VerifiedCredentials]]) -> Iterator[Problem]:
    """A key in two sets is a way from the weaker one into the other."""
    known: dict[bytes, str] = {}
    for name, verified in sets.items():
        own: dict[bytes, tuple[str, str]] = {}
        for each in verified:
            for file, key in _keys(each):
                own.setdefault(key, (each.name, file))
        for key, (participant, file) in own.items():
            if key in known:
                words = f"its key is also in the set {known[key] or 'that is the first'}"
                yield Problem(words, Code.ONE_KEY_TWO_ROLES, file).of(participant).of(f"set {name}")
            known.setdefault(key, name)


def _keys(credentials: VerifiedCredentials) -> Iterator[tuple[str, bytes]]:
    certificates = {CERTIFICATE: (credentials.certificate,), **credentials.anchors.roles}
    for file, found in certificates.items():
        for each in found:
            yield file, each.spki
            if second := alternative_spki(each):
                yield file, second


def _text(document: bytes) -> bytes:
    return document.replace(b"\r\n", b"\n")
