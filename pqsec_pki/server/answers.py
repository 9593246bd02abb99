"""Answers to the front's calls: files, refusals, and errors without anything of this machine."""

import hashlib
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from typing import TypeVar

from pqsec_pki._files import exists, read
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError, shown
from pqsec_pki.server.call import SignerAnswer, SignerCall
from pqsec_pki.server.requester import NotAdmittedError

NOT_DONE = "the server could not do it: its log says why"
_LONGEST = 1000
"""Characters of an error for a client, which is also in the log."""
Decision = TypeVar("Decision")


def decided(decide: Callable[[SignerCall], Decision], call: SignerCall) -> Decision | SignerAnswer:
    """The decision about the call, or the answer that refuses it."""
    found: list[Decision] = []

    def ask() -> SignerAnswer:
        found.append(decide(call))
        return SignerAnswer(status=200)

    refused = guarded(ask)
    return found[0] if found else refused


def guarded(answer: Callable[[], SignerAnswer]) -> SignerAnswer:
    """The answer; for an error the answer that says so, without anything of this machine."""
    try:
        return answer()
    except NotAdmittedError as error:
        return refused(error)
    except (MalformedError, VerificationError) as error:
        detail = shown(str(error), _LONGEST)
        return SignerAnswer(status=HTTPStatus.BAD_REQUEST, detail=detail)
    except PqsecError as error:
        return failed(error)


def refused(error: NotAdmittedError) -> SignerAnswer:
    """The answer that refuses a call."""
    return SignerAnswer(
        status=error.status,
        detail=str(error),
        problem=error.problem,
        retry_after=error.retry_after,
    )


def misdirected(name: str) -> NotAdmittedError:
    """The refusal of what only another server with the same ledger can answer."""
    return NotAdmittedError(
        HTTPStatus.MISDIRECTED_REQUEST,
        f"this server does not have the newest files of {name}: ask another",
    )


def failed(error: PqsecError) -> SignerAnswer:
    """The answer for what a CA refuses, or could not do; only the first is the client's."""
    if isinstance(error, VerificationError):
        return SignerAnswer(status=HTTPStatus.FORBIDDEN, detail=str(error))
    return SignerAnswer(status=HTTPStatus.INTERNAL_SERVER_ERROR, detail=NOT_DONE, note=str(error))


def unavailable(error: PqsecError) -> SignerAnswer:
    """The answer until somebody has repaired the keystore."""
    return SignerAnswer(
        status=HTTPStatus.SERVICE_UNAVAILABLE, detail=NOT_DONE, retry_after=60, note=str(error)
    )


def file_in(path: Path, media_type: str, otherwise: str) -> SignerAnswer:
    """The answer with the content of a file; NotAdmittedError, in the words `otherwise`, without
    one."""
    if not exists(path):
        raise NotAdmittedError(404, otherwise)
    return content(read(path), media_type)


def content(data: bytes, media_type: str) -> SignerAnswer:
    """The answer with these octets, and the tag by which a client knows them."""
    etag = f'"{hashlib.sha256(data).hexdigest()}"'
    return SignerAnswer(status=200, body=data, media_type=media_type, etag=etag)
