"""The CAs that a robot trusts, each with its role in its set of credentials.

The sets that have pins are those that the robot needs: one without pins is not trusted, and one
that is missing is refused.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

from pqsec_pki.algorithms import profile_named
from pqsec_pki.credentials import (
    CA_FILES,
    IDENTITY_CA,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    TrustAnchors,
)
from pqsec_pki.errors import MalformedError, PqsecError, UsageError, shown
from pqsec_pki.keystore import CurrentFiles, Keystore, layout
from pqsec_pki.problems import Code, Problem

ROLES = {
    "identity": IDENTITY_CA,
    "permissions": PERMISSIONS_CA,
    "countersigner": PERMISSIONS_ALT_CA,
}
"""The role of a CA, as written on the command line, and the file that contains it."""

Pins: TypeAlias = Mapping[str, frozenset[str]]
"""SHA-256 fingerprints of CA certificates, hex, by the file that contains them: of the first set,
`identity_ca.cert.pem`; of a further one, `sets/hybrid/identity_ca.cert.pem`."""

_ROLE_OF = {file: role for role, file in ROLES.items()}
_PIN = re.compile(rf"(?:([a-z0-9-]+)/)?({'|'.join(ROLES)}):([0-9a-f]{{64}})")


def pins_of(texts: Iterable[str]) -> Pins:
    """Pins as written on the command line: identity:0ab1..., colons are optional.

    Those of a further set begin with it: hybrid/identity:0ab1... UsageError for anything else:
    without roles, one CA could act as another.
    """
    found: dict[str, set[str]] = {}
    for text in texts:
        role, _, digits = text.lower().partition(":")
        match = _PIN.fullmatch(f"{role}:{digits.replace(':', '')}")
        if not match:
            raise UsageError(
                f"'{shown(text)}' is not a role and a SHA-256 fingerprint",
                hint=f"write {', '.join(f'{each}:SHA256' for each in ROLES)}, of a further set of"
                " credentials hybrid/identity:SHA256; `pqsec ca show --pins` on the CA machine"
                " prints them",
            )
        try:
            name = set_named(match[1]) if match[1] else layout.FIRST
        except MalformedError as error:
            raise UsageError(str(error)) from None
        found.setdefault(layout.in_set(name, ROLES[match[2]]), set()).add(match[3])
    return {file: frozenset(pins) for file, pins in found.items()}


def set_named(text: str) -> str:
    """`text`, if it is the name of a profile, and so may be that of a further set.

    MalformedError otherwise: the name becomes a folder.
    """
    try:
        if profile_named(text).name == text:
            return text
    except PqsecError:
        pass
    raise MalformedError(f"{shown(text)!r} is not a profile that this pqsec knows")


def pins_in_use(keystore: Keystore) -> Pins:
    """The CAs that the robots of `keystore` trust, in all sets; in an overlap, both identity CAs.

    Errors as of `CurrentFiles.shared`: who pins others would trust them.
    """
    with keystore.open_ledger() as ledger:
        found = [(each, CurrentFiles.within(each, ledger).anchors) for each in keystore.sets]
    return {
        file: pins
        for each, anchors in found
        for file, pins in pins_in(anchors, set_name=each.set_name).items()
    }


def pin_texts(pins: Pins) -> list[str]:
    """The pins as `pins_of` reads them, and `pqsec install` after --ca-fingerprint."""
    return [
        f"{role_of(file)}:{each}" for file in _in_order(pins) for each in sorted(pins.get(file, ()))
    ]


def pins_in(*anchors: TrustAnchors, set_name: str = layout.FIRST) -> Pins:
    """The fingerprints of all CAs in `anchors`, which are of that set, by their roles."""
    found: dict[str, set[str]] = {}
    for each in anchors:
        for file, authorities in each.roles.items():
            found.setdefault(file, set()).update(ca.fingerprint for ca in authorities)
    return {
        layout.in_set(set_name, file): frozenset(found[file])
        for file in CA_FILES
        if found.get(file)
    }


def sets_in(pins: Pins) -> tuple[str, ...]:
    """The names of the further sets that have pins, sorted."""
    return tuple(sorted({_set_of(file) for file in pins} - {layout.FIRST}))


def of_sets(pins: Pins, names: Iterable[str]) -> Pins:
    """Those of these sets."""
    wanted = set(names)
    return {file: each for file, each in pins.items() if _set_of(file) in wanted}


def role_of(file: str) -> str:
    """The role of the CA in that file, as `pins_of` reads it: identity, or hybrid/identity."""
    name, (_, _, last) = _set_of(file), file.rpartition("/")
    return f"{name}/{_ROLE_OF[last]}" if name else _ROLE_OF[last]


def file_of(role: str) -> str:
    """The inverse of `role_of`; KeyError for another text, MalformedError for an unknown set."""
    name, _, last = role.rpartition("/")
    return layout.in_set(set_named(name) if name else layout.FIRST, ROLES[last])


def pin_problems(found: Pins, trusted: Pins) -> Iterator[Problem]:
    """CAs `found` in a role for which they are not trusted, and trusted CAs that are missing.

    Likewise whole sets of credentials.
    """
    there, due = {layout.FIRST, *sets_in(found)}, {layout.FIRST, *sets_in(trusted)}
    yield from set_problems(there, due)
    for file in _in_order(of_sets({**found, **trusted}, there & due)):
        role = role_of(file)
        own, wanted = found.get(file, frozenset()), trusted.get(file, frozenset())
        for each in sorted(own - wanted):
            words = f"the {role} CA is not trusted in this role: SHA-256 {each}"
            yield Problem(words, Code.CA_UNKNOWN, file)
        for each in sorted(wanted - own):
            words = f"the {role} CA that is trusted is missing: SHA-256 {each}"
            yield Problem(words, Code.CA_MISSING, file)


def set_problems(there: Iterable[str], due: Iterable[str]) -> Iterator[Problem]:
    """Sets that are `there` and not trusted, and sets that are missing."""
    there, due = set(there), set(due)
    for each in sorted(there - due):
        words = f"the CAs of the set of credentials {each} are not trusted here"
        yield Problem(words, Code.CA_UNKNOWN)
    for each in sorted(due - there):
        words = f"the set of credentials {each} is missing, and this robot has it"
        yield Problem(words, Code.CA_MISSING)


def _set_of(file: str) -> str:
    """The name of the set in which that file is."""
    return file.split("/")[1] if file.startswith(f"{layout.SETS}/") else layout.FIRST


def _in_order(files: Iterable[str]) -> list[str]:
    """By set, the first one first, and by role."""
    order = list(ROLES.values())
    return sorted(files, key=lambda file: (_set_of(file), order.index(file.rpartition("/")[2])))
