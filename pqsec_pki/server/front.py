"""Answers HTTP requests: the part of the server that faces the network, and has no CA key.

Everything that needs no key is refused here: unknown paths, too much, too often, and what is not a
request. The rest is asked from the signer, which decides.
"""

import json
import time
from collections import Counter
from dataclasses import field
from http import HTTPStatus

from twisted.web.http import datetimeToString

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.est import EST, PROBLEM, RECEIPTS, TEXT, NotSignedError
from pqsec_pki.server.addresses import key_of
from pqsec_pki.server.asking import SignerCalls
from pqsec_pki.server.call import SignerAnswer
from pqsec_pki.server.channel import LimitedRequest
from pqsec_pki.server.configuration import ServerLimits
from pqsec_pki.server.events import Log
from pqsec_pki.server.limiting import Rate, RecentKeys
from pqsec_pki.server.reading import media_type_of, signer_call, values_of
from pqsec_pki.server.routes import Route
from pqsec_pki.server.sending import send

_GIVEN = {200, 204}
"""A note with one of these says who got what."""
_RECEIPT = 16
"""A receipt may be so many times larger than a request: it has several participants."""
_LONGEST_SHOWN = 80


@dataclass(slots=True)
class Front:
    """Answers requests with the signer's answers."""

    calls: SignerCalls
    limits: ServerLimits
    log: Log
    counts: Counter[str] = field(default_factory=Counter)
    by_address: Rate = field(init=False)
    by_label: Rate = field(init=False)
    trouble: str = ""
    """Why this process does not use what `serve.yaml` says now; empty if it does."""
    known: RecentKeys = field(default_factory=RecentKeys)
    """Addresses from which somebody showed a credential that the signer accepted."""

    def __post_init__(self) -> None:
        self.use(self.limits)

    def use(self, limits: ServerLimits) -> None:
        """Apply these limits from now on."""
        self.limits = limits
        self.by_address = Rate(limits.requests_of_address)
        self.by_label = Rate(limits.requests_of_label)

    @property
    def troubles(self) -> list[str]:
        """Why each process does not use its configuration as it is in the files."""
        return [each for each in (self.trouble, self.calls.trouble) if each]

    def count(self, what: str) -> None:
        """Count an event, for the metrics."""
        self.counts[what] += 1

    def most(self, path: bytes) -> int:
        """The greatest length of a body that is sent to that path."""
        return self.limits.body * (_RECEIPT if path == RECEIPTS.encode() else 1)

    def answer(self, request: LimitedRequest) -> None:
        """Answer the request, now or when the signer has."""
        exchange = Exchange(self, request, request.channel.address)
        route = Route.of(request.path)
        refused = self._refused(request, route, exchange.address)
        if refused or route is None:
            exchange.finish(refused or SignerAnswer(status=404, detail="there is nothing here"))
            return
        try:
            call = signer_call(route, request, exchange.address)
        except NotSignedError as error:
            exchange.finish(SignerAnswer(status=401, detail=str(error)))
            return
        except (MalformedError, VerificationError) as error:
            exchange.finish(SignerAnswer(status=400, detail=str(error)))
            return
        self.calls.ask(call, exchange.finish)

    def _refused(
        self, request: LimitedRequest, route: Route | None, address: str
    ) -> SignerAnswer | None:
        """The answer to a request that is not allowed, or comes too often; None for others."""
        if wait := self.by_address.wait(key_of(address)):
            return _too_many(wait)
        if route is None:
            return None
        if request.method.decode("ascii", "replace") not in route.methods:
            detail = f"only {' and '.join(route.methods)} may be used here"
            return SignerAnswer(status=405, detail=detail)
        if route.types and media_type_of(request) not in route.types:
            return SignerAnswer(status=415, detail=f"send {' or '.join(sorted(route.types))}")
        if key_of(address) not in self.known and (wait := self.by_label.wait(route.label)):
            return _too_many(wait)
        return None


@dataclass(slots=True)
class Exchange:
    """One request, and its answer."""

    front: Front
    request: LimitedRequest
    address: str
    begun: float = field(default_factory=time.monotonic)

    def finish(self, answer: SignerAnswer) -> None:
        """Write the answer, unless the client has gone."""
        if answer.etag and answer.status == HTTPStatus.OK and self._has(answer.etag):
            answer = SignerAnswer(status=304, etag=answer.etag)
        if answer.note and answer.status in _GIVEN:
            self.front.known.add(key_of(self.address))
        self.front.count(f"status-{answer.status}")
        self._log(answer)
        if self.request._disconnected:  # noqa: SLF001 -- Twisted has no other way to ask
            return
        body = b"" if self._only_asks_for_password(answer) else _body(answer)
        if answer.status == HTTPStatus.TOO_MANY_REQUESTS:
            self.request.channel.persistent = False  # what else it sent is not looked at
        self.request.setResponseCode(answer.status)
        for name, value in self._headers(answer, body):
            self.request.responseHeaders.setRawHeaders(name, [value])
        if answer.status in {204, 304} or self.request.method == b"HEAD":
            body = b""
        send(self.request, body)

    def _only_asks_for_password(self, answer: SignerAnswer) -> bool:
        """Then EST's answer has no body, which Bouncy Castle would not read, and then complain."""
        asks = answer.status == HTTPStatus.UNAUTHORIZED
        told = self.request.requestHeaders.hasHeader("Authorization")
        return asks and not told and self.request.path.startswith(f"{EST}/".encode())

    def _has(self, etag: str) -> bool:
        given = values_of(self.request, "If-None-Match")
        return any(etag == each.strip() for line in given for each in line.split(","))

    def _headers(self, answer: SignerAnswer, body: bytes) -> list[tuple[str, str]]:
        found = [
            ("Date", datetimeToString().decode()),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
        ]
        if answer.status not in {204, 304}:
            found.append(("Content-Length", str(len(body))))
            if body:
                found.append(("Content-Type", _media_type_of(answer)))
        if answer.status == HTTPStatus.OK and self.request.path.startswith(f"{EST}/".encode()):
            found.append(("Content-Transfer-Encoding", "base64"))  # for clients older than RFC 8951
        if answer.status == HTTPStatus.UNAUTHORIZED:
            found.append(("WWW-Authenticate", 'Basic realm="pqsec"'))
        if answer.status == HTTPStatus.METHOD_NOT_ALLOWED and (
            route := Route.of(self.request.path)
        ):
            found.append(("Allow", ", ".join(route.methods)))
        if answer.etag:
            found.append(("ETag", answer.etag))
        if answer.status == HTTPStatus.TOO_MANY_REQUESTS:
            found.append(("Connection", "close"))
        if answer.retry_after:
            found.append(("Retry-After", str(answer.retry_after)))
        return found

    def _log(self, answer: SignerAnswer) -> None:
        """One line: never a secret, a token's text or the content of a request."""
        self.front.log(
            {
                "address": self.address,
                "method": self.request.method[:16].decode("ascii", "replace"),
                "path": self.request.path[:_LONGEST_SHOWN].decode("ascii", "replace"),
                "status": answer.status,
                "detail": answer.detail,
                "ms": round(1000 * (time.monotonic() - self.begun), 1),
            }
        )


def _too_many(wait: int) -> SignerAnswer:
    return SignerAnswer(status=429, retry_after=wait, detail="too many requests: ask later")


def _media_type_of(answer: SignerAnswer) -> str:
    if not answer.detail:
        return answer.media_type
    return PROBLEM if answer.status >= HTTPStatus.BAD_REQUEST else TEXT


def _body(answer: SignerAnswer) -> bytes:
    """What is sent; for an error a problem of RFC 9457."""
    if not answer.detail:
        return answer.body
    if answer.status < HTTPStatus.BAD_REQUEST:
        return f"{answer.detail}\n".encode()
    try:
        title = HTTPStatus(answer.status).phrase
    except ValueError:
        title = "Error"
    kind = {"type": answer.problem} if answer.problem else {}
    value = {**kind, "title": title, "status": answer.status, "detail": answer.detail}
    return json.dumps(value).encode() + b"\n"
