"""Answers the calls of clients from the keystore: the part of the server that uses CA keys.

Requests that came at the same time are issued in one change of the keystore. An answer is made
from what the keystore has then, so the answer to a repeated request is the same.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import field, replace
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki.domain import Desired
from pqsec_pki.enrolment import Bundle
from pqsec_pki.errors import PqsecError, VerificationError
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
    CurrentFiles,
    Keystore,
    Ledger,
    SeenLedger,
    change,
    files_elsewhere,
    layout,
    load_certificate,
    read_head,
    was_ahead,
)
from pqsec_pki.lifecycle import fetch_files, issue
from pqsec_pki.server.admission import Admission
from pqsec_pki.server.answers import (
    content,
    decided,
    failed,
    file_in,
    guarded,
    misdirected,
    refused,
    unavailable,
)
from pqsec_pki.server.call import CallKind, SignerAnswer, SignerCall
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.factories import Factory
from pqsec_pki.server.identifying import without_certificate
from pqsec_pki.server.list_keeping import keep_list
from pqsec_pki.server.receipt_taking import take_receipts
from pqsec_pki.server.requester import Admitted, NotAdmittedError, Requester
from pqsec_pki.server.token_lines import request_of
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.transparency import MerkleTree


@dataclass(frozen=True)  # no slots, for cached properties
class CallHandler:
    """Answers calls with the keystore, its CAs, and the domain file."""

    keystore: Keystore
    authorities: Authorities
    desired: Desired
    clock: Callable[[], datetime]
    waiting: WaitingRequests
    policy: EnrolmentPolicy = EnrolmentPolicy()
    factories: Mapping[str, Factory] = field(default_factory=dict)
    tree: MerkleTree = field(default_factory=MerkleTree, repr=False)
    """Over the ledger's lines, kept for the next proofs."""
    revocation_list: timedelta | None = None
    """The validity of revocation lists that are issued by themselves; None for none."""
    seen: SeenLedger = field(default_factory=SeenLedger)
    """Nothing is issued with a ledger that lacks lines: they may be revocations, or used tokens."""

    def keep_list(self) -> bool:
        """Issue the revocation list that is needed; whether one was.

        VerificationError for a ledger that lacks lines; other errors as of `renew_list`.
        """
        if self.revocation_list is None:
            return False
        with self.keystore.hold(keep_connection=True):
            with self._whole_ledger():
                pass
            self._fetch_shared()
            return keep_list(
                self.keystore, self.authorities, self.revocation_list, now=self.clock()
            )

    def answers(self, calls: Sequence[SignerCall]) -> list[SignerAnswer]:
        """The answer to each call; those that issue are one change of the keystore."""
        issued = iter(self._issued([each for each in calls if each.kind.issues]))
        holders = iter(self._holders([each for each in calls if each.kind in self._of_holders]))
        return [
            next(issued)
            if each.kind.issues
            else self._for_holder(each, next(holders))
            if each.kind in self._of_holders
            else guarded(self._by_kind[each.kind])
            for each in calls
        ]

    def _for_holder(self, call: SignerCall, holder: Requester | SignerAnswer) -> SignerAnswer:
        if isinstance(holder, SignerAnswer):
            return holder
        return guarded(lambda: self._of_holders[call.kind](holder.name, call.body))

    @cached_property
    def _by_kind(self) -> dict[CallKind, Callable[[], SignerAnswer]]:
        return {
            CallKind.READY: self._ready,
            CallKind.CA_CERTIFICATES: self._ca_certificates,
            CallKind.REQUEST_ATTRIBUTES: self._request_attributes,
            CallKind.REVOCATION_LIST: self._revocation_list,
            CallKind.HEAD: self._head,
        }

    @cached_property
    def _of_holders(self) -> dict[CallKind, Callable[[str, bytes], SignerAnswer]]:
        """The calls that need a certificate, with its participant and the body."""
        return {CallKind.BUNDLE: self._own_bundle, CallKind.RECEIPT: self._receipt}

    def _holders(self, calls: Sequence[SignerCall]) -> list[Requester | SignerAnswer]:
        """The holder of a valid certificate for each call, or the refusal; the ledger is read once
        for all."""
        if not any(each.certificate for each in calls):
            return [refused(without_certificate())] * len(calls)
        try:
            with self.keystore.open_ledger() as ledger:
                deciding = self._admission(ledger)
                return [decided(deciding.requesters.holder_of, each) for each in calls]
        except PqsecError as error:
            return [failed(error)] * len(calls)

    # What issues

    def _issued(self, calls: Sequence[SignerCall]) -> list[SignerAnswer]:
        if not calls:
            return []
        with self.keystore.hold(keep_connection=True):
            with ExitStack() as opened:
                try:
                    ledger = opened.enter_context(self._whole_ledger())
                    self._recover_clock(ledger)
                except PqsecError as error:
                    return [unavailable(error)] * len(calls)
                deciding = self._admission(ledger)
                found = [decided(deciding.of, each) for each in calls]
                admitted = [each for each in found if isinstance(each, Admitted)]
                again = [each.name for each in admitted if not each.spec]
                elsewhere = self._fetched(ledger, again)
            if not admitted:
                return [each for each in found if isinstance(each, SignerAnswer)]
            try:
                self._refuse_unusable()
            except PqsecError as error:
                unable = unavailable(error)
                return [each if isinstance(each, SignerAnswer) else unable for each in found]
            self._record(admitted)
            failures = self._issue([each for each in admitted if each.spec])
            self._sign_head()
            done = [each for each in admitted if each.line and each.name not in failures]
            self.waiting.remove(*(request_of(each.line) for each in done if each.line))
            with BundleNumbers.of(self.keystore, self.tree) as numbers:
                return [
                    each
                    if isinstance(each, SignerAnswer)
                    else self._answered(call, each, failures, numbers)
                    if each.spec or each.name not in elsewhere
                    else refused(misdirected(each.name))
                    for call, each in zip(calls, found, strict=True)
                ]

    @contextmanager
    def _whole_ledger(self) -> Iterator[Ledger]:
        """The ledger; VerificationError if it lacks lines that were there (`SeenLedger`)."""
        with self.keystore.as_found.open_ledger() as ledger:
            self.seen.refuse_less(self.keystore.root, ledger)
            yield ledger

    def _recover_clock(self, ledger: Ledger) -> None:
        """Issue a list now if the clock was ahead: its line comes before what is issued."""
        if was_ahead(ledger, self.authorities, self.clock()):
            self.keep_list()

    def _refuse_unusable(self) -> None:
        """VerificationError if no robot could use what the server has for all of them now.

        The CAs, the list, and the governance. Asked before a certificate is issued and a token is
        used, so that an answer that admits a robot is one that it can install.
        """
        now = self.clock()
        for each in self.keystore.sets:
            anchors = each.anchors
            problems = [*anchors.problems(now), *anchors.list_problems(now)]
            if problems:
                raise VerificationError(*problems)
            anchors.signed_governance(each.governance)

    def _sign_head(self) -> None:
        """Sign a head over the lines that other servers with this ledger added.

        A robot refuses a head that is smaller than one that another server gave it.
        """
        if not self.keystore.ledger_address:
            return
        with self.keystore.open_ledger() as ledger:
            head, size = read_head(self.keystore.root), ledger.size
        if head and head.head.size < size:
            with change(self.keystore.root, self.authorities):
                pass  # each change with the CA keys signs one

    def _admission(self, ledger: Ledger) -> Admission:
        return Admission(
            self.keystore,
            ledger,
            self.desired,
            self.clock(),
            self.waiting,
            self.policy,
            factories=self.factories,
        )

    def _record(self, admitted: Sequence[Admitted]) -> None:
        """Enter what was admitted to certificates that a plan issued."""
        if lines := [each.line for each in admitted if each.line and not each.spec]:
            with change(self.keystore.root) as transaction:
                transaction.record(*lines)

    def _issue(self, new: Sequence[Admitted]) -> dict[str, PqsecError]:
        """Issue in one change, or in one for each kind of replacement; returns errors by name."""
        failures: dict[str, PqsecError] = {}
        for kind in ((True, True), (True, False), (False, False)):
            alike = [each for each in new if (each.replaces, each.after_revocation) == kind]
            failures |= self._issue_alike(alike)
        return failures

    def _issue_alike(self, new: Sequence[Admitted]) -> dict[str, PqsecError]:
        """Issue in one change; if that fails, one by one."""
        specs = [each.spec for each in new if each.spec]
        if not specs:
            return {}
        how = {"force": new[0].replaces, "after_revocation": new[0].after_revocation}
        lines = [each.line for each in new if each.line]
        try:
            issue(self.keystore, self.authorities, specs, records=lines, now=self.clock(), **how)
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
            return failed(error)
        note = f"{admitted.name} by {admitted.by}{'' if admitted.spec else ', again'}"
        if call.kind is CallKind.REQUEST:
            return guarded(lambda: self._bundle(admitted.name, numbers, note))
        return guarded(lambda: self._certificate(admitted.name, note))

    def _certificate(self, name: str, note: str) -> SignerAnswer:
        """The certificate of each set that the request asked for."""
        found = [load_certificate(_certificate_path(each, name)) for each in self.keystore.sets]
        body = to_base64(certs_only(found))
        return SignerAnswer(status=200, body=body, media_type=PKCS7, note=note)

    def _bundle(self, name: str, numbers: BundleNumbers, note: str = "") -> SignerAnswer:
        now = self.clock()
        bundle = Bundle.of(self.keystore, [name], now=now, keys=False, numbers=numbers)
        etag = f'"{bundle.sha256}"'
        body = bundle.to_bytes()
        return SignerAnswer(status=200, body=body, media_type=BUNDLE_TYPE, etag=etag, note=note)

    # What only reads, or records

    def _ready(self) -> SignerAnswer:
        self.authorities.refuse_outdated(self.keystore.root)
        try:
            self._refuse_unusable()
        except VerificationError as error:
            return replace(unavailable(error), detail=f"not ready: {error}")
        return SignerAnswer(status=200, body=b"ready\n", media_type=TEXT)

    def _ca_certificates(self) -> SignerAnswer:
        with self.keystore.open_ledger() as ledger:
            sets = [CurrentFiles.within(each, ledger) for each in self.keystore.sets]
            body = to_base64(certs_only(ca for each in sets for ca in each.anchors.identity_cas))
        return SignerAnswer(status=200, body=body, media_type=PKCS7)

    def _request_attributes(self) -> SignerAnswer:
        first, *further = self.keystore.profiles
        body = to_base64(
            request_attributes(
                first.participant_key, first.alternative_key, has_further=bool(further)
            )
        )
        return SignerAnswer(status=200, body=body, media_type=CSRATTRS)

    def _own_bundle(self, name: str, _body: bytes) -> SignerAnswer:
        with self.keystore.open_ledger() as ledger:
            elsewhere = self._fetched(ledger, [name])
            newest = ledger.of_name("participant", name)[-1].sha256
        if elsewhere or self._here(name) != newest:
            raise misdirected(name)
        self._issue_again(name)
        self._sign_head()
        with BundleNumbers.of(self.keystore, self.tree) as numbers:
            return self._bundle(name, numbers)

    def _issue_again(self, name: str) -> None:
        """Answer the participant's request again, if the certificate that it got is not valid yet.

        It was issued when the clock was ahead. Errors as of `issue`.
        """
        path = self.keystore.folder / layout.enclave_folder(name) / layout.REQUEST
        with self.keystore.hold(keep_connection=True):
            with self._whole_ledger() as ledger:
                spec = self._admission(ledger).again(name, path)
                if spec:
                    self._recover_clock(ledger)
            if spec:
                issue(self.keystore, self.authorities, [spec], now=self.clock(), force=True)

    def _here(self, name: str) -> str:
        """The SHA-256 of the participant's certificate in the keystore; empty if it has none."""
        path = _certificate_path(self.keystore, name)
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

    def _revocation_list(self) -> SignerAnswer:
        self._fetch_shared()
        with CurrentFiles.of(self.keystore) as current:
            found = current.shared.get(layout.LIST)
        if found is None:
            raise NotAdmittedError(404, "there is no revocation list")
        return content(found, PKIX_CRL)

    def _head(self) -> SignerAnswer:
        path = self.keystore.root / layout.PUBLIC / layout.TREE_HEAD
        return file_in(path, TEXT, "there is no signed head of the ledger")

    def _receipt(self, name: str, body: bytes) -> SignerAnswer:
        done = take_receipts(self.keystore, name, body, now=self.clock())
        clocks = dict.fromkeys(each.clock for each in done if each.clock)
        return SignerAnswer(status=204, note="; ".join([f"receipt, sent by {name}", *clocks]))


def _certificate_path(keystore: Keystore, name: str) -> Path:
    return keystore.folder / layout.enclave_folder(name) / layout.CERTIFICATE
