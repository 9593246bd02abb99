"""Answers the calls of clients from the keystore: the part of the server that uses CA keys.

Requests that came at the same time are issued in one change of the keystore. An answer is made
from what the keystore has then, so the answer to a repeated request is the same.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from datetime import datetime, timedelta
from functools import cached_property
from http import HTTPStatus
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read
from pqsec_pki.domain import Desired
from pqsec_pki.enrolment import Bundle, read_receipts, record_receipts
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError
from pqsec_pki.est import (
    BUNDLE_TYPE,
    CSRATTRS,
    PKCS7,
    PKIX_CRL,
    TEXT,
    certs_only,
    request_attributes,
    to_base64,
)
from pqsec_pki.keystore import (
    Authorities,
    BundleNumbers,
    Keystore,
    Ledger,
    SeenLedger,
    change,
    files_elsewhere,
    layout,
    load_certificate,
)
from pqsec_pki.lifecycle import fetch_files, issue
from pqsec_pki.server.admission import Admission
from pqsec_pki.server.call import CallKind, SignerAnswer, SignerCall
from pqsec_pki.server.factories import Factory
from pqsec_pki.server.list_keeping import keep_list
from pqsec_pki.server.requester import Admitted, NotAdmittedError, Requester
from pqsec_pki.server.waiting import PendingRequests
from pqsec_pki.transparency import MerkleTree

_NOT_DONE = "the server could not do it: its log says why"


@dataclass(frozen=True)  # no slots, for cached properties
class CallHandler:
    """Answers calls with the keystore, its CAs, and the domain file."""

    keystore: Keystore
    authorities: Authorities
    desired: Desired
    clock: Callable[[], datetime]
    waiting: PendingRequests
    anybody: bool = False
    """Whether requests without a credential wait there."""
    any_time: bool = False
    renew_expired: timedelta = timedelta()
    """For how long after its end a certificate is still renewed."""
    retry: int = 60
    factories: Mapping[str, Factory] = field(default_factory=dict)
    tree: MerkleTree = field(default_factory=MerkleTree, repr=False)
    """Over the ledger's lines, kept for the next proofs."""
    list_validity: timedelta | None = None
    """Of revocation lists that are issued by themselves; None for none."""
    seen: SeenLedger = field(default_factory=SeenLedger)
    """Nothing is issued with a ledger that lacks lines: they may be revocations, or used tokens."""

    def keep_list(self) -> bool:
        """Issue the revocation list that is needed; whether one was.

        VerificationError for a ledger that lacks lines; other errors as of `renew_list`.
        """
        if self.list_validity is None:
            return False
        with self.keystore.hold():
            with self.keystore.open_ledger() as ledger:
                self.seen.refuse_less(self.keystore.root, ledger)
            self._fetch_shared()
            return keep_list(self.keystore, self.authorities, self.list_validity, now=self.clock())

    def answers(self, calls: Sequence[SignerCall]) -> list[SignerAnswer]:
        """The answer to each call; those that issue are one change of the keystore."""
        issued = iter(self._issued([each for each in calls if each.kind.issues]))
        return [next(issued) if each.kind.issues else self._answer(each) for each in calls]

    def _answer(self, call: SignerCall) -> SignerAnswer:
        return _guarded(lambda: self._by_kind[call.kind](call))

    @cached_property
    def _by_kind(self) -> dict[CallKind, Callable[[SignerCall], SignerAnswer]]:
        return {
            CallKind.READY: self._ready,
            CallKind.CA_CERTIFICATES: self._ca_certificates,
            CallKind.REQUEST_ATTRIBUTES: self._request_attributes,
            CallKind.BUNDLE: self._own_bundle,
            CallKind.REVOCATION_LIST: self._revocation_list,
            CallKind.HEAD: self._head,
            CallKind.RECEIPT: self._receipt,
        }

    # What issues

    def _issued(self, calls: Sequence[SignerCall]) -> list[SignerAnswer]:
        if not calls:
            return []
        with self.keystore.hold():
            with self.keystore.open_ledger() as ledger:
                try:
                    self.seen.refuse_less(self.keystore.root, ledger)
                except PqsecError as error:
                    return [_unavailable(error)] * len(calls)
                deciding = self._admission(ledger)
                decided = [_decided(deciding, each) for each in calls]
                admitted = [each for each in decided if isinstance(each, Admitted)]
                again = [each.name for each in admitted if not each.spec]
                elsewhere = self._fetched(ledger, again)
            self._record(admitted)
            failures = self._issue([each for each in admitted if each.spec])
            with BundleNumbers.of(self.keystore, self.tree) as numbers:
                return [
                    each
                    if isinstance(each, SignerAnswer)
                    else self._answered(call, each, failures, numbers)
                    if each.spec or each.name not in elsewhere
                    else _refused(_misdirected(each.name))
                    for call, each in zip(calls, decided, strict=True)
                ]

    def _admission(self, ledger: Ledger) -> Admission:
        return Admission(
            self.keystore,
            ledger,
            self.desired,
            self.clock(),
            self.any_time,
            self.waiting,
            self.anybody,
            self.retry,
            factories=self.factories,
            renew_expired=self.renew_expired,
        )

    def _record(self, admitted: Sequence[Admitted]) -> None:
        """Enter what was admitted to certificates that a plan issued."""
        if lines := [each.line for each in admitted if each.line and not each.spec]:
            with change(self.keystore.root) as transaction:
                transaction.record(*lines)

    def _issue(self, new: Sequence[Admitted]) -> dict[str, PqsecError]:
        """Issue in one change, or in two if some replace certificates; returns errors by name."""
        replacing = [each for each in new if each.replaces]
        adding = [each for each in new if not each.replaces]
        return {**self._issue_alike(replacing), **self._issue_alike(adding)}

    def _issue_alike(self, new: Sequence[Admitted]) -> dict[str, PqsecError]:
        """Issue in one change; if that fails, one by one."""
        specs = [each.spec for each in new if each.spec]
        if not specs:
            return {}
        force = new[0].replaces
        lines = [each.line for each in new if each.line]
        try:
            issue(
                self.keystore, self.authorities, specs, records=lines, now=self.clock(), force=force
            )
        except PqsecError as error:
            if len(new) == 1:
                return {new[0].name: error}
            return {name: each for one in new for name, each in self._issue_alike([one]).items()}
        return {}

    def _answered(
        self,
        call: SignerCall,
        admitted: Admitted,
        failures: Mapping[str, PqsecError],
        numbers: BundleNumbers,
    ) -> SignerAnswer:
        if admitted.spec and (error := failures.get(admitted.name)):
            return _failed(error)
        if admitted.line:
            self.waiting.remove(admitted.line.sha256)
        note = f"{admitted.name} by {admitted.by}{'' if admitted.spec else ', again'}"
        if call.kind is CallKind.REQUEST:
            return _guarded(lambda: self._bundle(admitted.name, numbers, note))
        return _guarded(lambda: self._certificate(admitted.name, note))

    def _certificate(self, name: str, note: str) -> SignerAnswer:
        body = to_base64(certs_only([load_certificate(self._certificate_path(name))]))
        return SignerAnswer(status=200, body=body, media_type=PKCS7, note=note)

    def _certificate_path(self, name: str) -> Path:
        return self.keystore.root / layout.enclave_folder(name) / layout.CERTIFICATE

    def _bundle(self, name: str, numbers: BundleNumbers, note: str = "") -> SignerAnswer:
        now = self.clock()
        bundle = Bundle.of(self.keystore, [name], now=now, keys=False, numbers=numbers)
        etag = f'"{bundle.sha256}"'
        body = bundle.to_bytes()
        return SignerAnswer(status=200, body=body, media_type=BUNDLE_TYPE, etag=etag, note=note)

    # What only reads, or records

    def _ready(self, _call: SignerCall) -> SignerAnswer:
        self.authorities.refuse_outdated(self.keystore.root)
        return SignerAnswer(status=200, body=b"ready\n", media_type=TEXT)

    def _ca_certificates(self, _call: SignerCall) -> SignerAnswer:
        body = to_base64(certs_only(self.keystore.anchors.identity_cas))
        return SignerAnswer(status=200, body=body, media_type=PKCS7)

    def _request_attributes(self, _call: SignerCall) -> SignerAnswer:
        profile = self.keystore.profile
        body = to_base64(request_attributes(profile.participant_key, profile.alternative_key))
        return SignerAnswer(status=200, body=body, media_type=CSRATTRS)

    def _own_bundle(self, call: SignerCall) -> SignerAnswer:
        with self.keystore.open_ledger() as ledger:
            holder = self._admission(ledger).holder_of(call)
            elsewhere = self._fetched(ledger, [holder.name])
            newest = ledger.of_name("participant", holder.name)[-1].sha256
        if elsewhere or self._here(holder.name) != newest:
            raise _misdirected(holder.name)
        with BundleNumbers.of(self.keystore, self.tree) as numbers:
            return self._bundle(holder.name, numbers)

    def _here(self, name: str) -> str:
        """The SHA-256 of the participant's certificate in the keystore; empty if it has none."""
        path = self._certificate_path(name)
        return load_certificate(path).fingerprint if exists(path) else ""

    def _fetched(self, ledger: Ledger, names: Sequence[str]) -> set[str]:
        """Get what other servers with this ledger wrote: what all share, and these participants.

        Returns the names of those whose files only another server has.
        """
        if not files_elsewhere(self.keystore, ledger, names):
            return set()
        fetch_files(self.keystore, self.authorities, names)
        return {each.name for each in files_elsewhere(self.keystore, ledger, names) if each.name}

    def _fetch_shared(self) -> None:
        """Get the revocation list and the governance that another server with this ledger wrote."""
        if self.keystore.ledger_address:
            with self.keystore.open_ledger() as ledger:
                self._fetched(ledger, [])

    def _revocation_list(self, _call: SignerCall) -> SignerAnswer:
        self._fetch_shared()
        return _file(self.keystore.revocation_list_path, PKIX_CRL, "there is no revocation list")

    def _head(self, _call: SignerCall) -> SignerAnswer:
        path = self.keystore.root / layout.PUBLIC / layout.TREE_HEAD
        return _file(path, TEXT, "there is no signed head of the ledger")

    def _receipt(self, call: SignerCall) -> SignerAnswer:
        holder = self._holder(call)
        if holder.name not in {each.receipt.participant for each in read_receipts(call.body)}:
            raise NotAdmittedError(403, f"the receipt is not of {holder.name}")
        record_receipts(self.keystore, [(Path("receipt"), call.body)], now=self.clock())
        return SignerAnswer(status=204, note=f"receipt of {holder.name}")

    def _holder(self, call: SignerCall) -> Requester:
        with self.keystore.open_ledger() as ledger:
            return self._admission(ledger).holder_of(call)


def _decided(deciding: Admission, call: SignerCall) -> Admitted | SignerAnswer:
    """The request that may be answered, or the answer to one that may not."""
    found: list[Admitted] = []

    def decide() -> SignerAnswer:
        found.append(deciding.of(call))
        return SignerAnswer(status=200)

    refused = _guarded(decide)
    return found[0] if found else refused


def _guarded(answer: Callable[[], SignerAnswer]) -> SignerAnswer:
    """The answer; for an error the answer that says so, without anything of this machine."""
    try:
        return answer()
    except NotAdmittedError as error:
        return _refused(error)
    except (MalformedError, VerificationError) as error:
        return SignerAnswer(status=HTTPStatus.BAD_REQUEST, detail=str(error))
    except PqsecError as error:
        return _failed(error)


def _refused(error: NotAdmittedError) -> SignerAnswer:
    return SignerAnswer(status=error.status, detail=str(error), retry_after=error.retry_after)


def _misdirected(name: str) -> NotAdmittedError:
    """The refusal of what only another server with the same ledger can answer."""
    return NotAdmittedError(
        HTTPStatus.MISDIRECTED_REQUEST,
        f"this server has not the newest files of {name}: ask another",
    )


def _failed(error: PqsecError) -> SignerAnswer:
    """The answer for what a CA refuses, or could not do; only the first is the client's."""
    if isinstance(error, VerificationError):
        return SignerAnswer(status=HTTPStatus.FORBIDDEN, detail=str(error))
    return SignerAnswer(status=HTTPStatus.INTERNAL_SERVER_ERROR, detail=_NOT_DONE, note=str(error))


def _unavailable(error: PqsecError) -> SignerAnswer:
    """The answer until somebody has repaired the keystore."""
    return SignerAnswer(
        status=HTTPStatus.SERVICE_UNAVAILABLE, detail=_NOT_DONE, retry_after=60, note=str(error)
    )


def _file(path: Path, media_type: str, otherwise: str) -> SignerAnswer:
    if not exists(path):
        raise NotAdmittedError(404, otherwise)
    data = read(path)
    etag = f'"{hashlib.sha256(data).hexdigest()}"'
    return SignerAnswer(status=200, body=data, media_type=media_type, etag=etag)
