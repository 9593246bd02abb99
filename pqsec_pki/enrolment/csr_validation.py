"""Validate certificate requests, on the CA machine."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import PurePosixPath
from typing import TypeAlias

from pqsec_pki.algorithms import Profile, SignatureAlgorithm
from pqsec_pki.certificates import CertificateRequest, common_name
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.keystore import regular_name
from pqsec_pki.lifecycle import PublicKeys

_Kinds: TypeAlias = tuple[SignatureAlgorithm, SignatureAlgorithm | None]
"""The algorithms of the keys for one set."""
NAMELESS = "its subject is not the CN of a participant alone, as in CN=/fleet/robot1"


def validate_csrs(
    requests: Sequence[CertificateRequest],
    profiles: Sequence[Profile],
    *,
    names: Collection[str] = (),
    patterns: Collection[str] = (),
) -> dict[str, PublicKeys]:
    """The public keys to be certified, by the participant's name.

    Each request must prove possession of its keys, for each of the keystore's sets of credentials:
    their algorithms must be those of the `profiles`, in this order.
    Its subject must be a CN alone, a participant's name: either one of `names`, which must
    all be requested, or a name that matches `patterns`, such as /fleet/* (`*` matches any
    part without a slash). VerificationError lists everything that is wrong; UsageError
    without `names` and `patterns`.
    """
    if not names and not patterns:
        raise UsageError(
            "a request must not choose its own name",
            hint="give the names that are allowed: NAME, or --allow-name '/fleet/*'",
        )
    for pattern in patterns:
        if not pattern.startswith("/"):
            raise UsageError(f"{pattern!r} matches no name: names begin with a slash")
    wanted = set(map(regular_name, names))
    asked = [name_asked_for(request) for request in requests]
    problems = [
        f"the request of {request.subject_name or 'an empty subject'}: {problem}"
        for request, name in zip(requests, asked, strict=True)
        for problem in (*_name_problems(name, wanted, patterns), *_key_problems(request, profiles))
    ]
    problems += [f"{asked.count(name)} requests are for {name}" for name in _repeated(asked)]
    problems += [f"no request is for {name}" for name in sorted(wanted - set(asked))]
    if problems:
        raise VerificationError(*problems)
    return {name: keys_in(request) for request, name in zip(requests, asked, strict=True) if name}


def keys_in(request: CertificateRequest) -> PublicKeys:
    """The keys of a request for each set; each certificate is known by the whole request."""
    first, *further = (
        PublicKeys(each.public_key, each.alternative_key, request.fingerprint, each.pem)
        for each in request.sets
    )
    return first._replace(further=tuple(further))


def name_asked_for(request: CertificateRequest) -> str | None:
    """The participant's name that the request asks for; None if it is not a valid name."""
    try:
        name = request.common_name
        if not name or regular_name(name) != name:
            return None
        common_name(name)  # refuses names that do not fit into a certificate
        return name
    except PqsecError:
        return None


def _name_problems(
    name: str | None, wanted: Collection[str], patterns: Collection[str]
) -> Iterator[str]:
    if name is None:
        yield NAMELESS
    elif name not in wanted and not any(PurePosixPath(name).match(each) for each in patterns):
        allowed = ", ".join([*sorted(wanted), *patterns])
        yield f"its name is not one of the allowed names: {allowed}"


def _key_problems(request: CertificateRequest, profiles: Sequence[Profile]) -> Iterator[str]:
    try:
        kinds = [_kinds_in(each) for each in request.sets]
    except PqsecError as error:
        yield str(error)
        return
    yield from _set_problems(kinds, profiles)
    try:
        request.verify()
    except VerificationError as error:
        yield from error.lines


def _set_problems(kinds: Sequence[_Kinds], profiles: Sequence[Profile]) -> Iterator[str]:
    """Why these are not the keys for one set of each profile."""
    wanted = [(each.participant_key, each.alternative_key) for each in profiles]
    if kinds == wanted:
        return
    if len(kinds) == len(wanted) == 1:
        name = profiles[0].name
        yield f"it has {_words(kinds[0])}; profile {name} here has {_words(wanted[0])}"
        return
    due, there = Counter(wanted), Counter(kinds)
    names = ",".join(each.name for each in profiles)
    make = f"`pqsec request --profile {names}` makes one for all sets here"
    for profile, each in zip(profiles, wanted, strict=True):
        if there[each] < due[each]:
            yield f"it lacks keys of profile {profile.name}, {_words(each)}: {make}"
    for each, count in there.items():
        if count > due[each] > 0:
            yield f"it has {count} keys {_words(each)}, for one set of credentials"
        elif not due[each]:
            yield f"it has {_words(each)}, which no set of credentials here has"
    if due == there:
        yield f"its keys are in another order than the sets of credentials here, {names}"


def _kinds_in(request: CertificateRequest) -> _Kinds:
    second = request.alternative_key
    return request.public_key.algorithm, second.algorithm if second else None


def _words(kinds: _Kinds) -> str:
    return " and ".join(each.name for each in kinds if each)


def _repeated(names: Sequence[str | None]) -> list[str]:
    return sorted({name for name in names if name and names.count(name) > 1})
