"""On the robot: enrol at a server, and renew from it, by the same checks as `install`.

A request stays until its answer is installed, and the server answers the same request with the
same bundle; so a command that was killed is only run again.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timedelta
from http import HTTPStatus
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_there, read
from pqsec_pki.certificates import Certificate
from pqsec_pki.enrolment import Pins, changing, one_command, require_trust
from pqsec_pki.errors import KeystoreError, PqsecError
from pqsec_pki.est.client import EstClient, RequestEndedError, ServerAnswer
from pqsec_pki.est.known_server import KnownServer
from pqsec_pki.est.obtaining import (
    KeyTerms,
    Participant,
    answer_to,
    ask_for,
    certificates,
    client_with,
    etag,
    held_by,
    installed,
    installed_in_sets,
    is_requested,
    take,
    with_places,
)
from pqsec_pki.est.paths import BUNDLE, RECEIPT_TYPE, RECEIPTS
from pqsec_pki.keystore import State, expanded, regular_name
from pqsec_pki.problems import Problem

_NEW_REQUEST = "make a new request: `pqsec enrol --force`, with the same options"
Clock = Callable[[], datetime]


@dataclass(frozen=True, slots=True, kw_only=True)
class Obtained:
    """The result of enrolment or renewal for one participant."""

    name: str
    certificate: Certificate
    renewed: bool
    """Whether it has another certificate than before."""
    changed: bool
    """Whether it has anything else than before."""
    future: tuple[Problem, ...] = ()
    """What of it is of the future by the clock of this robot."""

    def to_json(self) -> dict[str, object]:
        """The participant, for JSON."""
        return {
            "name": self.name,
            "renewed": self.renewed,
            "changed": self.changed,
            "not_after": self.certificate.not_after,
            "future": list(map(str, self.future)),
        }


def enrol(  # noqa: PLR0913 -- by name
    client: EstClient,
    name: str,
    root: Path,
    terms: KeyTerms,
    *,
    clock: Clock,
    patience: timedelta = timedelta(),
) -> Obtained:
    """Get the participant `name` of this robot its certificate and documents from a server.

    A valid certificate that is installed under the same CAs stays, unless `terms.force`.
    KeystoreError if it is under others. Errors as of `requests`, `answer_to` and `take`; what is
    installed stays as it was. Nothing is sent where no answer could be installed, because no CAs
    are trusted: UsageError.
    """
    name = regular_name(name)
    if not terms.trust_first:
        require_trust(root, terms.pins)
    with one_command(root):
        before, future = installed_in_sets(root).get(name, {}), tuple[Problem, ...]()
        if terms.force or is_requested(root, name) or not _is_enrolled(before, root, terms, clock):
            request = ask_for(root, name, terms, before)
            try:
                answer = answer_to(client, request, patience)
            except RequestEndedError as error:
                error.hint = _NEW_REQUEST
                raise
            future = take(answer, name, root, terms, now=clock())
        KnownServer.of(client).save(root)
        return _outcome(root, name, before, future)


def renew(  # noqa: PLR0913 -- by name
    known: KnownServer,
    names: Iterable[str],
    root: Path,
    terms: KeyTerms,
    *,
    clock: Clock,
    due: timedelta | None = None,
    rekey: bool = False,
) -> Iterator[Obtained | PqsecError]:
    """Bring each installed participant, or each of `names`, up to date with the server.

    One whose certificate is due, or any with `rekey`, gets a new one for new keys, the others what
    the server has for their certificates. One that fails stays as it was, and does not hold up
    the others. `due` is that of `State.at`. KeystoreError for one that is not installed.
    """
    with one_command(root):
        for name in _chosen(installed(root), names, root):
            try:
                done = _renewed(known, name, root, terms, now=clock(), due=due, rekey=rekey)
                if KnownServer.at(root) != known:
                    known.save(root)
                yield done
            except PqsecError as error:
                error.where = error.where or name
                yield error


def deliver_receipt(root: Path, name: str | None = None) -> None:
    """Send the receipt of what is installed to the server, unless it has it.

    It is sent with the certificate of the participant `name`, which the server should accept:
    it refuses one that has expired or was revoked. PqsecError as of `EstClient.post`.
    """
    known = KnownServer.at(root)
    with changing(root) as store:
        data = read(store.receipt) if is_there(store.receipt) else b""
    sha256 = hashlib.sha256(data).hexdigest()
    if known and data and known.receipt != sha256:
        there = installed_in_sets(root)
        client_with(known, there[name or next(iter(there))]).post(RECEIPTS, data, RECEIPT_TYPE)
        known.with_receipt(sha256).save(root)


def _is_enrolled(before: Participant, root: Path, terms: KeyTerms, clock: Clock) -> bool:
    if not before or any(clock() > each.not_after for each in certificates(before)):
        return False
    with changing(root) as store:
        state = store.trust_state
    if terms.pins and state and state.pins != terms.pins:
        if _adds_sets(terms.pins, state.pins):
            return False
        raise KeystoreError(
            f"{root} has a valid certificate under other CAs",
            hint="enrol into another --dir; --force replaces what is installed here",
        )
    return True


def _adds_sets(pins: Pins, known: Pins) -> bool:
    """Whether the pins are those that are known, and those of further sets of credentials."""
    return known == {file: each for file, each in pins.items() if file in known}


def _chosen(there: Iterable[str], names: Iterable[str], root: Path) -> list[str]:
    known = sorted(there)
    chosen = [*map(regular_name, expanded(names, known, {}))] or known
    if missing := [each for each in chosen if each not in known] or ([] if known else [str(root)]):
        raise KeystoreError(
            f"nothing is installed in {root} for {', '.join(missing)}",
            hint="`pqsec enrol` gets the first certificate",
        )
    return chosen


def _renewed(  # noqa: PLR0913 -- by name
    known: KnownServer,
    name: str,
    root: Path,
    terms: KeyTerms,
    *,
    now: datetime,
    due: timedelta | None,
    rekey: bool,
) -> Obtained:
    before = installed_in_sets(root)[name]
    held, client = certificates(before), client_with(known, before, terms.pin)
    terms = with_places(terms, before)
    failed: PqsecError | None = None
    future: tuple[Problem, ...] = ()
    due_sets = (State.at(now, each.not_before, each.not_after, due) for each in held)
    if rekey or any(each.calls_for_renewal for each in due_sets):
        try:
            answer = _answered(client, name, root, terms, before)
            future = take(answer, name, root, terms, now=now)
            return _outcome(root, name, before, future)
        except PqsecError as error:
            failed = error  # the newest list and documents are for the old certificate too
    # If an earlier request was answered, but not installed here, this is that answer.
    with suppress(*([PqsecError] if failed else [])):
        answer = client.get(BUNDLE, etag(name, before, now=now))
        if answer.status == HTTPStatus.OK:
            future = take(answer, name, root, terms, now=now)
    if failed:
        raise failed
    return _outcome(root, name, before, future)


def _answered(
    client: EstClient, name: str, root: Path, terms: KeyTerms, held: Participant
) -> ServerAnswer:
    """The answer to the waiting request, or to a new one if the server never answers that one.

    A renewal runs without a person, so it repeats a refused request with a new one.
    """
    try:
        return answer_to(client, ask_for(root, name, terms, held))
    except RequestEndedError:
        return answer_to(client, ask_for(root, name, replace(terms, force=True), held))


def _outcome(root: Path, name: str, before: Participant, future: tuple[Problem, ...]) -> Obtained:
    after = installed_in_sets(root)[name]
    return Obtained(
        name=name,
        certificate=held_by(after),
        renewed=[each.der for each in certificates(before)]
        != [each.der for each in certificates(after)],
        changed=before != after,
        future=future,
    )
