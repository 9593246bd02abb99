"""The steps of a robot that gets its credentials from a server. Each can be repeated."""

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from http import HTTPStatus
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_there, read
from pqsec_pki._times import said
from pqsec_pki.algorithms import DEFAULT_PROFILE, PROFILES, Profile, profile_named
from pqsec_pki.certificates import Certificate, CertificateRequest
from pqsec_pki.credentials import CERTIFICATE, KEY, KEYS, PROOF
from pqsec_pki.enrolment import REQUEST, Bundle, Pins, begin_problems, changing, install, requests
from pqsec_pki.errors import PqsecError, UsageError, VerificationError
from pqsec_pki.est.client import EstClient, ServerAnswer
from pqsec_pki.est.known_server import KnownServer
from pqsec_pki.est.paths import PEM_FILE, REQUESTS
from pqsec_pki.est.signing import RequestSigner
from pqsec_pki.est.tls import TlsIdentity, is_for_tls
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code, Problem
from pqsec_pki.tokens import Pin, is_reference, stored_pin, uri_in

CLOCKS_DIFFER = timedelta(minutes=5)
"""A smaller difference is not reported."""

_OLDER_SERVER = (
    "the server has less than this robot saw: its keystore is an older copy, or another one:"
    " restore the newest"
)
Enclave = Mapping[str, bytes]
Participant = Mapping[str, Enclave]
"""The files of a participant in each set of credentials, the first one first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyTerms:
    """How the keys of a participant are made, and which CAs it trusts."""

    profile: Profile | None = None
    """None for keys of the kinds that it has."""
    further: tuple[Profile, ...] = ()
    """Those of further sets of credentials."""
    pins: Pins | None = None
    """The CAs; None for those that are trusted here."""
    trust_first: bool = False
    uris: Mapping[str, str] | None = None
    pin: Pin = stored_pin
    force: bool = False
    """Whether `enrol` makes a new request, whatever is installed or waits. The answer to one that
    waits is then lost."""


class WaitingError(PqsecError):
    """Somebody must approve the request first."""

    code = Code.APPROVAL_WAITING


def installed(root: Path) -> Mapping[str, Enclave]:
    """The files of each installed participant in the first set."""
    return {name: files[layout.FIRST] for name, files in installed_in_sets(root).items()}


def installed_in_sets(root: Path) -> Mapping[str, Participant]:
    """The files of each installed participant in each set."""
    if not is_there(root):
        return {}
    with changing(root) as store:
        sets = store.current.sets if store.current else {}
    found: dict[str, dict[str, Enclave]] = {}
    for place, enclaves in sets.items():
        for name, files in enclaves.items():
            found.setdefault(name, {})[place] = files
    return found


def is_requested(root: Path, name: str) -> bool:
    """Whether a request for the participant waits for its answer."""
    with changing(root) as store:
        return is_there(store.request_folder(name) / REQUEST)


def ask_for(root: Path, name: str, terms: KeyTerms, held: Participant) -> bytes:
    """The request of the participant, in PEM: the one that waits, or a new one."""
    if terms.force or not is_requested(root, name):
        first, *further = (terms.profile, *terms.further) if terms.profile else _kinds(held)
        requests(
            [name],
            first,
            root,
            further=further,
            uris=terms.uris,
            pin=terms.pin,
            force=terms.force,
        )
    with changing(root) as store:
        return read(store.request_folder(name) / REQUEST)


def answer_to(client: EstClient, request: bytes, patience: timedelta = timedelta()) -> ServerAnswer:
    """The bundle with which the server answers, now or after an approval.

    WaitingError if there is none within `patience`; other errors as of `EstClient.post`.
    """
    until = time.monotonic() + patience.total_seconds()
    while True:
        answer = client.post(REQUESTS, request, PEM_FILE)
        if answer.status != HTTPStatus.ACCEPTED:
            return answer
        wait = answer.retry_after.total_seconds()
        if time.monotonic() + wait > until:
            sha256 = CertificateRequest.from_pem(request).fingerprint
            raise WaitingError(
                f"{client.server} has the request, which waits for an approval: SHA-256 {sha256}",
                hint=f"when `pqsec requests approve {sha256[:16]} --config serve.yaml` was run at"
                " the server, run the command again, with the same options: the request stays",
            )
        time.sleep(wait)


def take(
    answer: ServerAnswer, name: str, root: Path, terms: KeyTerms, *, now: datetime
) -> tuple[Problem, ...]:
    """Install the bundle in an answer, if it is one for the participant alone, without keys.

    Returns what of it is of the future by the robot's clock.

    Errors as of `install`.
    """
    bundle = Bundle.from_bytes(answer.body)
    if bundle.names != (name,):
        raise VerificationError(f"the server's bundle is for {', '.join(bundle.names)}")
    if bundle.has_keys:
        raise VerificationError(
            "the server's bundle has private keys, which must be made on this robot"
        )
    try:
        _refuse_early(bundle, now)
        done = install(
            answer.body,
            root,
            terms.pins,
            now=now,
            trust_first=terms.trust_first,
            pin=terms.pin,
        )
    except VerificationError as error:
        if not error.codes.isdisjoint({Code.OLDER, Code.PROOF_BAD, Code.LIST_MISSING}):
            error.hint = _OLDER_SERVER
        elif answer.date and abs(answer.date - now) > CLOCKS_DIFFER:
            error.hint = (
                f"the time is {said(now)} here, and {said(answer.date)} at the server:"
                " set the clock, and run the command again"
            )
        raise
    return done.future


def _refuse_early(bundle: Bundle, now: datetime) -> None:
    """VerificationError for what is not valid yet; `install` alone may do without a right clock,
    but a server says what time it is."""
    if early := [each for one in bundle.credentials for each in begin_problems(one, now)]:
        raise VerificationError(*early)


def etag(name: str, files: Participant, *, now: datetime) -> str:
    """The entity tag of a bundle with these files, as servers make it."""
    public = {
        place: {name: {file: data for file, data in own.items() if file not in {*KEYS, PROOF}}}
        for place, own in files.items()
    }
    return f'"{Bundle(now, public.pop(layout.FIRST), further=public).sha256}"'


def held_by(files: Participant) -> Certificate:
    """The participant's certificate of the first set."""
    return _certificate(files[layout.FIRST])


def certificates(participant: Participant) -> list[Certificate]:
    """Its certificate of each set, the first one first."""
    return list(map(_certificate, participant.values()))


def _certificate(files: Enclave) -> Certificate:
    return Certificate.from_pem(files[CERTIFICATE])


def _strongest(participant: Participant) -> Enclave:
    """The files of the set whose keys resist most: the server accepts no weaker certificate."""

    def level(files: Enclave) -> int:
        found = _certificate(files)
        keys = found.public_key, found.alternative_key
        return max(each.algorithm.level for each in keys if each)

    return max(participant.values(), key=level)


def client_with(known: KnownServer, participant: Participant, pin: Pin = stored_pin) -> EstClient:
    """A client that shows the participant's certificate, or signs what it asks with its keys.

    That of the set which resists most.
    """
    files = _strongest(participant)
    by_tls = is_for_tls(files[KEY])
    return EstClient(
        server=known.server,
        trust=known.trust,
        classical=known.classical,
        identity=TlsIdentity.of(files[CERTIFICATE], files[KEY]) if by_tls else None,
        signer=None if by_tls else RequestSigner.of(files, pin),
    )


def with_places(terms: KeyTerms, participant: Participant) -> KeyTerms:
    """The terms of a renewal: a key in a token stays there, unless they name another place."""
    there = {
        layout.in_set(place, each): uri_in(files[each])
        for place, files in participant.items()
        for each in KEYS
        if is_reference(files.get(each, b""))
    }
    return replace(terms, uris={**there, **(terms.uris or {})}) if there else terms


def _kinds(held: Participant) -> list[Profile]:
    """For each set a profile whose participants have keys of the kinds that it has here."""
    if not held:
        return [DEFAULT_PROFILE]
    return [_kind(place, _certificate(files)) for place, files in held.items()]


def _kind(place: str, held: Certificate) -> Profile:
    second = held.alternative_key.algorithm if held.alternative_key else None
    choices = {
        "participant_key": held.public_key.algorithm.name,
        "alternative_key": second.name if second else None,
    }
    for profile in [profile_named(place)] if place else PROFILES:
        with suppress(UsageError):
            changed = profile.changed(choices)
            if changed.alternative_key is second:
                return changed
    raise UsageError("no profile has keys such as the installed ones", hint="name one: --profile")
