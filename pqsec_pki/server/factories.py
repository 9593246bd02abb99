"""The factories whose devices may enrol with the certificate that each was made with.

Such a certificate (an IDevID, IEEE 802.1AR) often has intermediate CAs, so OpenSSL verifies its
path. Revocation lists are those that `serve.yaml` names.
"""

from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from OpenSSL import crypto

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.algorithms import broken_digest
from pqsec_pki.certificates import Certificate, RevocationList, verify_not_revoked
from pqsec_pki.domain import Member
from pqsec_pki.errors import (
    PqsecError,
    UsageError,
    VerificationError,
    library_call,
    located,
    words_of,
)
from pqsec_pki.server.configuration import FactoryFiles
from pqsec_pki.server.requester import NotAdmittedError

MOST_CAS = 8
"""Certificates between a device and its factory's CA; real ones have one or two."""
_FLAGS = crypto.X509StoreFlags
_PURPOSES = {ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}


@dataclass(frozen=True, slots=True)
class Factory:
    """A factory, by its CAs."""

    authorities: tuple[Certificate, ...]
    lists: tuple[RevocationList, ...] = ()
    """If there are any, each certificate below the authorities needs one of its issuer."""
    again: bool = False
    """Whether a device that enrolled may enrol again, which replaces its certificate."""

    @classmethod
    def read(cls, files: FactoryFiles, others: Sequence[Certificate]) -> Self:
        """The factory with these files; errors name the file.

        UsageError for a CA that is one of `others`, those of the domain.
        """
        with located(files.cas):
            authorities = Certificate.all_from_pem(read(files.cas))
            if {each.spki for each in authorities} & {each.spki for each in others}:
                raise UsageError("this is a CA of the domain: factories have their own")
        return cls(authorities, tuple(map(_list_at, files.lists)), files.again)

    def verify(self, device: Certificate, between: Sequence[bytes], now: datetime) -> None:
        """VerificationError unless the factory made the certificate, and it is valid now.

        `between` are CA certificates that the device sent.
        """
        path = [device, *self._path(device, between, now)]
        _refuse_other_purpose(device)
        for certificate, issuer in pairwise(path):
            if digest := broken_digest(certificate.identifier):
                raise VerificationError(f"it is signed with {digest}, which is no longer safe")
            if self.lists:
                self._refuse_revoked(certificate, issuer, now)

    def _path(
        self, device: Certificate, between: Sequence[bytes], now: datetime
    ) -> list[Certificate]:
        """The CAs from the device's issuer to one of the authorities."""
        store = crypto.X509Store()
        store.set_time(now)
        store.set_flags(_FLAGS.PARTIAL_CHAIN)
        for each in self.authorities:
            store.add_cert(_parsed(each.der))
        if len(between) > MOST_CAS:
            raise VerificationError(f"it comes with more than {MOST_CAS} certificates of CAs")
        untrusted = [_parsed(each) for each in between]
        with library_call(lambda error: VerificationError(words_of(error))):
            found = crypto.X509StoreContext(store, _parsed(device.der), untrusted)
            chain = found.get_verified_chain()
        return [_certificate(each) for each in chain[1:]]

    def _refuse_revoked(self, certificate: Certificate, issuer: Certificate, now: datetime) -> None:
        own = [each for each in self.lists if each.names_issuer(issuer)]
        if not own:
            raise VerificationError(f"there is no revocation list of {issuer.subject_name}")
        for each in own:
            verify_not_revoked(certificate, each, issuer, now=now)


def read_factories(
    files: Mapping[str, FactoryFiles], others: Sequence[Certificate]
) -> dict[str, Factory]:
    """The factories by name; errors as of `Factory.read`."""
    return {name: Factory.read(each, others) for name, each in files.items()}


def factory_of(member: Member, shown: Certificate, known: Mapping[str, Factory]) -> Factory:
    """The factory of the participant's device; NotAdmittedError if another one is shown."""
    device = member.device
    if device is None or not device.has(shown):
        raise NotAdmittedError(403, f"the domain file has another device for {member.name}")
    if device.factory not in known:
        raise NotAdmittedError(403, f"serve.yaml has no factory {device.factory}")
    return known[device.factory]


def _refuse_other_purpose(device: Certificate) -> None:
    """VerificationError for a CA, and for a key that may not sign, or not authenticate a client."""
    constraints = device.extension(x509.BasicConstraints)
    if constraints and constraints.ca:
        raise VerificationError("it is the certificate of a CA")
    usage = device.extension(x509.KeyUsage)
    if usage and not usage.digital_signature:
        raise VerificationError("its key may not sign (keyUsage lacks digitalSignature)")
    purposes = device.extension(x509.ExtendedKeyUsage)
    if purposes and not _PURPOSES.intersection(purposes):
        raise VerificationError("it is not for clients (extKeyUsage lacks clientAuth)")


def _list_at(path: Path) -> RevocationList:
    with located(path):
        data = read(path)
        pem = data.lstrip().startswith(b"-----")
        return RevocationList.from_pem(data) if pem else RevocationList.from_der(data)


def _parsed(der: bytes) -> crypto.X509:
    with library_call(lambda _: VerificationError("OpenSSL cannot read it as a certificate")):
        return crypto.load_certificate(crypto.FILETYPE_ASN1, der)


def _certificate(found: crypto.X509) -> Certificate:
    try:
        return Certificate.from_der(crypto.dump_certificate(crypto.FILETYPE_ASN1, found))
    except PqsecError as error:
        raise VerificationError(f"one of its CAs: {error}") from None
