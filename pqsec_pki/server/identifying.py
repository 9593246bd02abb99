"""Who asks, by what the client showed: a token, a participant's certificate, or a device's.

What the requester may have is decided in `admission.py`.
"""

from collections.abc import Callable, Mapping
from datetime import datetime, timedelta

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.certificates import Certificate, CertificateRequest
from pqsec_pki.domain import Member
from pqsec_pki.errors import VerificationError
from pqsec_pki.est import WAS_REVOKED
from pqsec_pki.keystore import Entry, Keystore, Ledger
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.factories import Factory, factory_of
from pqsec_pki.server.requester import NotAdmittedError, Requester
from pqsec_pki.server.token_lines import by_token, presented

APPROVED = "approval"
"""The name of an admission by somebody who approved the request."""
_DEVICE = "device"
"""The begin of the name of an admission by a factory's certificate."""
NEW_TOKEN = "it needs a new enrolment token"  # noqa: S105 -- words
_NEW_KEY = "make a new one for it"


@dataclass(frozen=True, slots=True)
class Requesters:
    """Finds the requester of a call, with the ledger as it is now."""

    keystore: Keystore
    ledger: Ledger
    lines: Callable[[str, str], list[Entry]]
    """Returns the lines of a kind and name, oldest first."""
    policy: EnrolmentPolicy
    factories: Mapping[str, Factory]
    """Whose devices may enrol, by the names that the domain file has."""
    now: datetime

    def of(self, call: SignerCall) -> Requester:
        """The requester; NotAdmittedError for a token or certificate that is not known or valid.

        Whether a token is used up, and a device is the participant's, is checked later.
        """
        if call.token and call.kind is not CallKind.REENROL:
            return self._of_token(call)
        if call.certificate:
            shown = Certificate.from_der(call.certificate)
            known = call.kind is CallKind.REENROL or self._set_of(shown) is not None
            if self.factories and not known:
                return Requester("", _DEVICE, device=shown)
            return self._of_certificate(shown, self.policy.renew_expired)
        if call.kind is CallKind.REENROL:
            raise NotAdmittedError(401, "show the current certificate as client certificate")
        return Requester("", APPROVED if self.policy.approval else "")

    def device(
        self, shown: Certificate, member: Member, request: CertificateRequest, call: SignerCall
    ) -> Requester:
        """The device that the domain file has for the participant; NotAdmittedError."""
        factory = factory_of(member, shown, self.factories)
        if request.spki == shown.spki:
            raise NotAdmittedError(403, f"the request is for the factory's key: {_NEW_KEY}")
        try:
            factory.verify(shown, call.chain, self.now)
        except VerificationError as error:
            raise NotAdmittedError(403, f"the factory certificate is refused: {error}") from None
        by = f"{_DEVICE} {member.device}"
        return Requester("", by, device=shown, again=factory.again)

    def holder_of(self, call: SignerCall) -> Requester:
        """The participant whose certificate the client showed.

        NotAdmittedError if it showed none, or one that is not valid.
        """
        if not call.certificate:
            raise without_certificate()
        return self._of_certificate(Certificate.from_der(call.certificate))

    def _of_token(self, call: SignerCall) -> Requester:
        found = presented(self.ledger, call.token, call.secret)
        if found is None:
            raise NotAdmittedError(401, "this enrolment token is not known here")
        if found.revoked:
            raise NotAdmittedError(401, "the enrolment token was revoked")
        return Requester("", by_token(found.id), token=found)

    def _set_of(self, certificate: Certificate) -> Keystore | None:
        """The set in which it is of a participant, by the ledger: it knows each that was issued."""
        name = certificate.common_name or ""
        for each in self.keystore.sets:
            lines = self.ledger.of(each.set_name).of_name("participant", name)
            if any(line.sha256 == certificate.fingerprint for line in lines):
                return each
        return None

    def _of_certificate(
        self, certificate: Certificate, expired: timedelta = timedelta()
    ) -> Requester:
        """The participant, by the ledger, with a certificate that ended at most `expired` ago.

        NotAdmittedError for a certificate that is not valid, or was revoked.
        """
        name = certificate.common_name or ""
        own = self._set_of(certificate)
        if own is None:
            raise NotAdmittedError(403, "the client certificate was not issued here")
        revoked = self.ledger.of(own.set_name).of_name("revocation", name)
        if any(each.sha256 == certificate.fingerprint for each in revoked):
            words = "the client certificate was revoked"
            raise NotAdmittedError(403, words, problem=WAS_REVOKED)
        if self.now < certificate.not_before:
            began = said(certificate.not_before)
            raise NotAdmittedError(403, f"its certificate is not valid before {began}")
        if self.now - certificate.not_after > expired:
            raise NotAdmittedError(403, f"its certificate expired: {NEW_TOKEN}")
        return Requester(
            name,
            f"certificate {certificate.serial_number:x}",
            certificate=certificate,
            set_name=own.set_name,
        )


def without_certificate() -> NotAdmittedError:
    """The refusal of a client without a certificate."""
    return NotAdmittedError(401, "show the participant's certificate as client certificate")
