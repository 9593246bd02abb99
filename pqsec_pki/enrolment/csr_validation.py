"""Validate certificate requests, on the CA machine."""

from collections.abc import Collection, Iterator, Sequence
from pathlib import PurePosixPath

from pqsec_pki.algorithms import Profile, SignatureAlgorithm
from pqsec_pki.certificates import CertificateRequest, common_name
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.keystore import regular_name
from pqsec_pki.lifecycle import PublicKeys

NAMELESS = "its subject is not the CN of a participant alone, as in CN=/fleet/robot1"


def validate_csrs(
    requests: Sequence[CertificateRequest],
    profile: Profile,
    *,
    names: Collection[str] = (),
    patterns: Collection[str] = (),
) -> dict[str, PublicKeys]:
    """The public keys to be certified, by the participant's name.

    Each request must prove possession of its keys, whose algorithms must be the profile's.
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
        for problem in (*_name_problems(name, wanted, patterns), *_key_problems(request, profile))
    ]
    problems += [f"{asked.count(name)} requests are for {name}" for name in _repeated(asked)]
    problems += [f"no request is for {name}" for name in sorted(wanted - set(asked))]
    if problems:
        raise VerificationError(*problems)
    return {
        name: PublicKeys(
            request.public_key, request.alternative_key, request.fingerprint, request.pem
        )
        for request, name in zip(requests, asked, strict=True)
        if name
    }


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


def _key_problems(request: CertificateRequest, profile: Profile) -> Iterator[str]:
    try:
        second = request.alternative_key
        kinds = (request.public_key.algorithm, second.algorithm if second else None)
    except PqsecError as error:
        yield str(error)
        return
    wanted = (profile.participant_key, profile.alternative_key)
    if kinds != wanted:
        yield f"it has {_words(kinds)}; profile {profile.name} here has {_words(wanted)}"
    try:
        request.verify()
    except VerificationError as error:
        yield from error.lines


def _words(kinds: tuple[SignatureAlgorithm, SignatureAlgorithm | None]) -> str:
    return " and ".join(each.name for each in kinds if each)


def _repeated(names: Sequence[str | None]) -> list[str]:
    return sorted({name for name in names if name and names.count(name) > 1})
