"""The trust anchors of a participant, each with its role, and what they alone decide."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from datetime import datetime
from functools import cached_property, partial
from itertools import combinations
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Family
from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    verify_authority,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.credentials._pem_files import certificates_in, only_certificate, only_list
from pqsec_pki.credentials._signed_documents import (
    SignedDocument,
    Value,
    governance_in,
    permissions_in,
    verified_by,
)
from pqsec_pki.credentials.names import (
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    REVOCATION_LIST,
)
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import (
    InvalidDocumentError,
    PqsecError,
    VerificationError,
    problems_of,
)
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import FoundSignature, Require, SignedFile, Verified, verify


@dataclass(frozen=True, kw_only=True)  # no slots, for cached properties
class TrustAnchors:
    """The CAs of a participant by their roles, and the revocation list that applies."""

    identity_cas: tuple[Certificate, ...]
    """The participant's own issuer first; after it, in a rollover, the other one. Empty if only
    documents are verified."""
    permissions_ca: Certificate
    countersigner: Certificate | None = None
    revocation_list: RevocationList | None = None
    """The revocation list of the first identity CA."""
    stock_peers: bool = False
    """Whether peers may lack alternative signatures: then documents need a countersignature
    only if there is a countersigner."""
    remembers_all: bool = field(default=False, compare=False)
    """Whether it remembers every document that it verified, for passes over all participants of a
    keystore; otherwise only the latest ones are remembered."""

    @classmethod
    def of(cls, files: Mapping[str, bytes], *, folder: str = "") -> Self:
        """The anchors in the files of an enclave. MalformedError, naming the file in `folder`."""
        where = f"{folder}/" if folder else ""
        second, list_ = files.get(PERMISSIONS_ALT_CA), files.get(REVOCATION_LIST)
        return cls(
            identity_cas=certificates_in(files[IDENTITY_CA], f"{where}{IDENTITY_CA}"),
            permissions_ca=only_certificate(files[PERMISSIONS_CA], f"{where}{PERMISSIONS_CA}"),
            countersigner=only_certificate(second, f"{where}{PERMISSIONS_ALT_CA}")
            if second is not None
            else None,
            revocation_list=only_list(list_, f"{where}{REVOCATION_LIST}")
            if list_ is not None
            else None,
        )

    @property
    def identity_ca(self) -> Certificate:
        """The first identity CA, whose revocation list applies."""
        return self.identity_cas[0]

    @property
    def content(self) -> tuple[object, ...]:
        """A key that is equal for two values with the same CAs, list and rules."""
        list_ = self.revocation_list
        roles = tuple(tuple(each.der for each in found) for found in self.roles.values())
        return *roles, list_ and list_.der, self.stock_peers

    @property
    def signed_twice(self) -> bool:
        """Whether everything is signed twice, as the identity CA's certificate shows."""
        issuers = self.identity_cas[:1]
        return not self.stock_peers and any(each.alternative is not None for each in issuers)

    @property
    def required(self) -> Require:
        """The signatures that a document must have, so that none can be stripped."""
        family = _family(self.permissions_ca)
        if self.countersigner or self.signed_twice or family is Family.HYBRID:
            return Require.BOTH
        return Require.PQ if family is Family.PQ else Require.CLASSICAL

    @property
    def signers(self) -> tuple[Certificate, ...]:
        """The CAs that sign documents."""
        return (self.permissions_ca, *((self.countersigner,) if self.countersigner else ()))

    @property
    def in_overlap(self) -> bool:
        """Whether two identity CAs are trusted, as in a rollover, without a revocation list."""
        return len({each.spki for each in self.identity_cas}) > 1

    @property
    def roles(self) -> Mapping[str, tuple[Certificate, ...]]:
        """The CAs by the files that contain them."""
        return {
            IDENTITY_CA: self.identity_cas,
            PERMISSIONS_CA: (self.permissions_ca,),
            PERMISSIONS_ALT_CA: (self.countersigner,) if self.countersigner else (),
        }

    @property
    def not_after(self) -> datetime:
        """The end of the CA that ends first; decisions that need all CAs end with it."""
        return min(each.not_after for found in self.roles.values() for each in found)

    def problems(self, now: datetime) -> tuple[Problem, ...]:
        """Problems of the CAs themselves, and of a CA that has two roles."""
        found = self._problems_at.get(now)
        if found is None:
            found = (*self._role_problems, *self._authority_problems(now))
            self._problems_at.clear()  # all participants are checked for one time
            self._problems_at[now] = found
        return found

    def signer_problems(self, now: datetime) -> tuple[Problem, ...]:
        """The problems of the CAs that sign documents."""
        return tuple(each for each in self.problems(now) if each.subject != IDENTITY_CA)

    def identity_problems(self, certificate: Certificate, now: datetime) -> Iterator[Problem]:
        """9.3.3: problems of `certificate`: issuer not trusted, not valid at `now`, or revoked."""
        ca, twice = self.issuer_of(certificate), self.signed_twice
        yield from _problems_of(
            lambda: verify_chain(certificate, ca, now=now, require_alternative=twice)
        )
        if self.revocation_list is not None:
            list_ = self.revocation_list
            yield from _problems_of(
                lambda: verify_not_revoked(
                    certificate, list_, self.identity_ca, now=now, require_alternative=twice
                )
            )

    def list_problems(self, now: datetime) -> Iterator[Problem]:
        """Problems of the revocation list itself, if there is one: its CA, its time."""
        list_, twice = self.revocation_list, self.signed_twice
        if list_ is not None:
            check = partial(list_.verify, self.identity_ca, require_alternative=twice)
            yield from _problems_of(check)
            yield from list_.validity_problems(now)

    def own_identity_problems(self, certificate: Certificate, now: datetime) -> Iterator[Problem]:
        """Like `identity_problems`, for the own certificate, which the first CA must have issued.

        No signature covers the order of the CAs in a file, and stacks that read only one
        certificate read the first.
        """
        yield from self.identity_problems(certificate, now)
        if self.issuer_of(certificate) is not self.identity_ca:
            words = "the first CA in it did not issue the certificate: a later one did"
            yield Problem(words, Code.WRONG_ISSUER, IDENTITY_CA)

    def issuer_of(self, certificate: Certificate) -> Certificate:
        """The identity CA that issued `certificate`; the first CA if none of them did.

        With a revocation list, which is the first CA's, the other CAs are ignored.
        """
        for each in () if self.revocation_list else self.identity_cas[1:]:
            if certificate.names_issuer(each) and each.signed(certificate):
                return each
        return self.identity_ca

    def governance(self, message: bytes, now: datetime) -> SignedDocument[Governance]:
        """9.4.3: the governance in S/MIME `message`, if signed by CAs that are valid at `now`.

        VerificationError lists everything that is wrong.
        """
        self._refuse_signers(now)
        return self.signed_governance(message)

    def permissions(self, message: bytes, now: datetime) -> SignedDocument[Permissions]:
        """The permissions in S/MIME `message`, likewise; their grants are not checked."""
        self._refuse_signers(now)
        return self.signed_permissions(message)

    def signed_governance(self, message: bytes) -> SignedDocument[Governance]:
        """The governance, if the CAs signed it; their own validity is not checked."""
        return self._document(message, GOVERNANCE, governance_in)

    def signed_permissions(self, message: bytes) -> SignedDocument[Permissions]:
        """The permissions, likewise."""
        return self._document(message, PERMISSIONS, permissions_in)

    def signatures(self, message: bytes | SignedFile) -> tuple[FoundSignature, ...]:
        """The signatures on S/MIME `message`, likewise."""
        return self.signed(message).signatures

    def signed(self, message: bytes | SignedFile, demanded: Require | None = None) -> Verified:
        """The document of any kind in S/MIME `message`, likewise.

        If the user gives the signatures that are `demanded`, these replace `required`.
        """
        if demanded is None and self.remembers_all:
            return self._remembered(SignedFile.of(message))
        required, data = demanded or self.required, SignedFile.of(message).message
        return verified_by(
            data, self.permissions_ca, self.countersigner, required, pinned=demanded is None
        )

    def _remembered(self, file: SignedFile) -> Verified:
        if file.message not in self._verified:
            self._verified[file.message] = verify(
                file,
                self.permissions_ca,
                alternative_ca=self.countersigner,
                require=self.required,
                pinned=True,
            )
        return self._verified[file.message]

    @cached_property
    def _verified(self) -> dict[bytes, Verified]:
        return {}

    def verified(self, message: bytes, now: datetime) -> Verified:
        """The document in `message`, if signed by CAs that are valid at `now`."""
        self._refuse_signers(now)
        return self.signed(message)

    def _refuse_signers(self, now: datetime) -> None:
        problems = self.signer_problems(now)
        if problems:
            raise VerificationError(*problems)

    def _document(
        self, message: bytes, file: str, read: Callable[[bytes], Value]
    ) -> SignedDocument[Value]:
        code = Code.NOT_SIGNED
        try:
            verified = self.signed(message)
            code = Code.DOCUMENT_INVALID
            return SignedDocument(read(verified.document), verified)
        except InvalidDocumentError as error:
            problems = tuple(each.as_code(code) for each in error.problems)
            raise VerificationError(*(each.of(file) for each in problems)) from error
        except PqsecError as error:
            problems = problems_of(error, code)
            raise VerificationError(
                *(each.of(file) for each in problems), hint=error.hint
            ) from error

    @cached_property
    def _problems_at(self) -> dict[datetime, tuple[Problem, ...]]:
        return {}

    @cached_property
    def _role_problems(self) -> tuple[Problem, ...]:
        return tuple(self._find_role_problems())

    def _find_role_problems(self) -> Iterator[Problem]:
        keys = [each.spki for each in self.identity_cas]
        if len(set(keys)) < len(keys):
            yield Problem("it contains the same CA twice", Code.CA_DOUBLED, IDENTITY_CA)
        for (one, first), (other, second) in combinations(self.roles.items(), 2):
            if not _keys_of(first).isdisjoint(_keys_of(second)):
                yield Problem(
                    f"this CA has the same key as {one}: any participant with a certificate"
                    " could sign permissions (CVE-2023-24010)"
                    if one == IDENTITY_CA
                    else f"this CA has the same key as {one}",
                    Code.ONE_KEY_TWO_ROLES,
                    other,
                )
        classical = _family(self.permissions_ca) is Family.CLASSICAL
        if self.signed_twice and classical and self.countersigner is None:
            words = "the identity CA has an alternative key, but the countersigner is missing"
            yield Problem(words, Code.COUNTERSIGNER_MISSING, PERMISSIONS_ALT_CA)

    def _authority_problems(self, now: datetime) -> Iterator[Problem]:
        for file, found in self.roles.items():
            for each in found:
                for problem in _problems_of(partial(verify_authority, each, now=now)):
                    yield problem.of(file)


def _family(certificate: Certificate) -> Family | None:
    """The family of its key; None if unknown, which the signature check reports."""
    try:
        return certificate.public_key.algorithm.family
    except PqsecError:
        return None


def _keys_of(certificates: tuple[Certificate, ...]) -> set[bytes]:
    """Subject public keys, DER, alternative ones among them."""
    found = {each.spki for each in certificates}
    for each in certificates:
        try:
            second = each.alternative_key
        except PqsecError:  # the chain check reports it
            continue
        if second is not None:
            found.add(second.spki)
    return found


def _problems_of(check: Callable[[], object]) -> tuple[Problem, ...]:
    try:
        check()
    except PqsecError as error:
        return problems_of(error)
    return ()
