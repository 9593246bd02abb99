"""Questions to a server, over TLS with HTTP/1.1; one connection for each.

Nothing that a server sends is trusted before its key is: redirects are not followed, no proxy is
used, each step has a time limit, and an answer a size limit.
"""

import base64
import json
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from datetime import UTC, datetime, timedelta
from email.utils import parsedate_to_datetime
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPResponse
from typing import Any, NoReturn, TypeAlias
from urllib.parse import urlsplit

from OpenSSL import SSL

from pqsec_pki._dataclass import dataclass
from pqsec_pki.enrolment import MAX_ARCHIVE
from pqsec_pki.errors import PqsecError, VerificationError, shown
from pqsec_pki.est.paths import PROBLEM, REQUEST_ENDED, WAS_REVOKED
from pqsec_pki.est.signing import RequestSigner
from pqsec_pki.est.stream import TlsStream
from pqsec_pki.est.tls import ServerTrust, TlsIdentity, client_context

MAX_ANSWER = MAX_ARCHIVE
MAX_WORDS = 16 << 10
"""Bytes of an answer that says why not."""
CONNECTING, AGREEING, ANSWERING = 15.0, 30.0, 120.0
"""Seconds for a connection, for its keys, and for a question and all of its answer."""
SOONEST, LATEST = timedelta(seconds=1), timedelta(hours=1)
"""Limits of what a server may say about when to come again."""
_PORT = 443
_LONGEST_WORDS = 300
_LATER = (HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_MANY_REQUESTS)
_ANOTHER = (HTTPStatus.MISDIRECTED_REQUEST, HTTPStatus.SERVICE_UNAVAILABLE)
"""What another of the servers may answer better."""
ASKING_FAILS = (OSError, SSL.Error, HTTPException, UnicodeError)
"""Exceptions of sockets, TLS and http.client when there is no answer."""
MOST_PLACES = 4
"""Addresses of one name that are tried, one after the other."""
_Place: TypeAlias = tuple[socket.AddressFamily, tuple[Any, ...]]
"""An address, as the system's calls have it."""
_READMISSION = (
    "if it came back, `pqsec enrolment-token create NAME --replace --after-revocation` makes a"
    " token for it at the server, and `pqsec enrol --force` with that a new key here"
)


class RequestEndedError(VerificationError):
    """The server never answers this request, and may answer another one."""


class WasRevokedError(VerificationError):
    """The certificate, or the participant that asks for one, was revoked."""


class TryAnotherError(PqsecError):
    """This server did not answer; another one of the same name may."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerAnswer:
    """A server's answer: yes, not yet, or nothing new."""

    status: int
    body: bytes = field(repr=False)
    retry_after: timedelta
    date: datetime | None
    """The server's time, if the answer has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstClient:
    """How to ask a server."""

    server: str
    """Its URL, as of `checked_url`."""
    trust: ServerTrust
    identity: TlsIdentity | None = None
    signer: RequestSigner | None = None
    """Who signs each request, if TLS has no keys of that kind."""
    secret: tuple[str, str] | None = field(default=None, repr=False)
    """Id and secret of an enrolment token."""
    classical: bool = False
    """Whether other key agreements than GROUP are allowed."""

    def get(self, path: str, etag: str = "") -> ServerAnswer:
        """What is at `path`; its status is 304 if that still has the `etag`. Errors as of `post`"""
        return self._ask("GET", path, None, {"If-None-Match": etag} if etag else {})

    def post(self, path: str, body: bytes, media: str) -> ServerAnswer:
        """The answer to `body`.

        VerificationError if the server is not trusted, or says no. PqsecError if it cannot be
        reached, fails, or does not answer in time.
        """
        return self._ask("POST", path, body, {"Content-Type": media})

    def _ask(
        self, method: str, path: str, body: bytes | None, headers: Mapping[str, str]
    ) -> ServerAnswer:
        places = self._places()
        for place in places[:-1]:
            with suppress(TryAnotherError):
                return self._asked(place, method, path, body, headers)
        return self._asked(places[-1], method, path, body, headers)

    def _places(self) -> Sequence[_Place]:
        """The addresses of the server's name. The only one comes twice: a balancer may be there."""
        parts = urlsplit(self.server)
        try:
            found = socket.getaddrinfo(parts.hostname, parts.port or _PORT, type=socket.SOCK_STREAM)
        except OSError as error:
            raise self._unanswered(error) from None
        places = list(dict.fromkeys((family, address) for family, _, _, _, address in found))
        return places[:MOST_PLACES] if len(places) > 1 else places * 2

    def _unanswered(self, error: Exception) -> "TryAnotherError":
        return TryAnotherError(
            f"cannot reach {self.server}: {_words(error)}",
            hint="is the server running, at this URL and port? What is installed stays as it is;"
            " run the command again later",
        )

    def _asked(
        self,
        place: _Place,
        method: str,
        path: str,
        body: bytes | None,
        headers: Mapping[str, str],
    ) -> ServerAnswer:
        connection = _Https(self, place)
        try:
            stream = connection.connected()
            if self.signer:
                signed = self.signer.headers(stream.connection, method, path, body or b"")
                headers = {**headers, **signed}
            connection.request(method, path, body, {**self._headers, **headers})
            return self._answer(connection.getresponse())
        except ASKING_FAILS as error:
            raise self._unanswered(error) from None
        finally:
            connection.end()

    @property
    def _headers(self) -> dict[str, str]:
        headers = {"Connection": "close", "Accept": "*/*", "User-Agent": "pqsec"}
        if self.secret:
            basic = base64.b64encode(":".join(self.secret).encode()).decode()
            headers["Authorization"] = f"Basic {basic}"
        return headers

    def _answer(self, response: HTTPResponse) -> ServerAnswer:
        status = response.status
        good = status in {*range(200, 300), HTTPStatus.NOT_MODIFIED}
        limit = MAX_ANSWER if good else MAX_WORDS
        body = response.read(limit + 1)
        if not good:
            self._refuse(response, body[:MAX_WORDS])
        if len(body) > limit:
            raise PqsecError(f"{self.server} sent more than {limit} bytes")
        if response.length:
            raise HTTPException("the answer is incomplete")
        return ServerAnswer(
            status=status,
            body=body,
            retry_after=_retry_after(response.headers.get("Retry-After", "")),
            date=_date(response.headers.get("Date", "")),
        )

    def _refuse(self, response: HTTPResponse, body: bytes) -> NoReturn:
        status, media = response.status, response.headers.get("Content-Type", "")
        problem = _problem(body) if media.partition(";")[0].strip() == PROBLEM else {}
        why = _problem_words(problem)
        words = f"{self.server} says: {why}" if why else f"{self.server} answers {status}"
        if 300 <= status < 400:  # noqa: PLR2004 -- redirects (RFC 9110 15.4)
            raise PqsecError(
                f"{words}: redirects are not followed", hint="use the server's own URL"
            )
        if status in _ANOTHER:
            raise TryAnotherError(words, hint="run the command again later")
        if status in _LATER or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            raise PqsecError(words, hint="run the command again later")
        if problem.get("type") == REQUEST_ENDED:
            raise RequestEndedError(words)
        if problem.get("type") == WAS_REVOKED:
            raise WasRevokedError(words, hint=_READMISSION)
        raise VerificationError(words)


class _Https(HTTPConnection):
    """HTTP over TlsStream."""

    def __init__(self, client: EstClient, place: _Place) -> None:
        parts = urlsplit(client.server)
        super().__init__(parts.hostname or "", parts.port or _PORT)
        self._client, self._place = client, place
        self._stream: TlsStream | None = None

    def connect(self) -> None:
        client = self._client
        context = client_context(
            client.trust, self.host, client.identity, classical=client.classical
        )
        connected = _connected(self._place)
        self._stream = stream = TlsStream(connected, context, self.host)
        stream.allow(AGREEING)
        stream.handshake(classical=client.classical)
        stream.allow(ANSWERING)
        self.sock: Any = stream

    def connected(self) -> TlsStream:
        """The connection of TLS, now."""
        self.connect()
        stream: TlsStream = self.sock
        return stream

    def end(self) -> None:
        """Close the connection; http.client's own `close` comes before the answer is read."""
        self.close()
        if self._stream:
            self._stream.end()


def _connected(place: _Place) -> socket.socket:
    family, address = place
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.settimeout(CONNECTING)
        made.connect(address)
    except BaseException:
        made.close()
        raise
    return made


def _words(error: Exception) -> str:
    """Why there is no answer; OpenSSL's errors are lists of (library, function, reason)."""
    if isinstance(error, SSL.Error):
        reasons = error.args[0] if error.args and isinstance(error.args[0], list) else []
        return ", ".join(str(each[-1]) for each in reasons) or "the connection was closed"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return shown(str(error)) or "the connection was closed"


def _problem(body: bytes) -> dict[str, Any]:
    """Problem details (RFC 9457); nothing if they are not."""
    with suppress(ValueError, RecursionError):
        value = json.loads(body)
        return value if isinstance(value, dict) else {}
    return {}


def _problem_words(problem: Mapping[str, Any]) -> str:
    """Its title and detail, fit for a message."""
    texts = [problem.get("title"), problem.get("detail")]
    return shown(": ".join(each for each in texts if isinstance(each, str)), _LONGEST_WORDS)


def _retry_after(text: str) -> timedelta:
    """Seconds (RFC 9110 10.2.3), within limits; a minute if it says nothing."""
    seconds = int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else 60  # noqa: PLR2004
    return min(max(timedelta(seconds=seconds), SOONEST), LATEST)


def _date(text: str) -> datetime | None:
    try:
        found = parsedate_to_datetime(text)
    except (ValueError, TypeError, IndexError, OverflowError):
        return None
    return found if found.tzinfo else found.replace(tzinfo=UTC)
