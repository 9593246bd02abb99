"""Is a bundle what its robot should run with? Asked before anything is replaced.

What is believed without proof is the fingerprints of the CAs' certificates. The order is
that of DDS-Security 1.1, 9.3.3 (identity) and 9.4.3 (permissions).
"""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Self

from pqsec_pki.algorithms import Family, PrivateKey, load_private_key
from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    common_name,
    verify_authority,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.enrolment.bundle import Bundle, certificates_in
from pqsec_pki.errors import MalformedError, PqsecError, UsageError, VerificationError, located
from pqsec_pki.keystore.enclave import (
    ALT_KEY,
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    LIST,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
)
from pqsec_pki.smime import Require, verify


@dataclass(frozen=True, slots=True, kw_only=True)
class Credentials:
    """One enclave's files, read."""

    name: str
    certificate: Certificate
    identity_ca: Certificate
    trusts_two: bool
    """Whether another identity CA stands behind it: then no revocation list can be given."""
    permissions_ca: Certificate
    countersigner: Certificate | None
    revocation_list: RevocationList | None
    permissions: bytes = field(repr=False)
    governance: bytes = field(repr=False)

    @classmethod
    def of(cls, name: str, files: Mapping[str, bytes]) -> Self:
        """MalformedError, naming the file, for one that cannot be read.

        Of several identity CAs the first is the one that counts here; there is one of
        everything else.
        """

        def only(file: str) -> Certificate:
            found = certificates_in(files[file], f"{name} {file}")
            if len(found) > 1:
                raise MalformedError(f"{name} {file}: {len(found)} certificates, not one")
            return found[0]

        identity_cas = certificates_in(files[IDENTITY_CA], f"{name} {IDENTITY_CA}")
        return cls(
            name=name,
            certificate=only(CERTIFICATE),
            identity_ca=identity_cas[0],
            trusts_two=len(identity_cas) > 1,
            permissions_ca=only(PERMISSIONS_CA),
            countersigner=only(PERMISSIONS_ALT_CA) if PERMISSIONS_ALT_CA in files else None,
            revocation_list=_revocation_list(name, files.get(LIST)),
            permissions=files[PERMISSIONS],
            governance=files[GOVERNANCE],
        )

    @property
    def twice(self) -> bool:
        """Whether everything is signed twice: the identity CA's certificate tells."""
        return self.identity_ca.alternative is not None

    @property
    def required(self) -> Require:
        """Which signatures its documents must have, so that none can be left out."""
        family = self.permissions_ca.public_key.algorithm.family
        if self.twice or family is Family.HYBRID:
            return Require.BOTH
        return Require.PQ if family is Family.PQ else Require.CLASSICAL


def pin(text: str) -> str:
    """A fingerprint that a person gives, as certificates have theirs; UsageError if it is none."""
    plain = text.replace(":", "").lower()
    if not re.fullmatch("[0-9a-f]{64}", plain):
        raise UsageError(f"{text!r} is not a SHA-256 fingerprint: 64 hexadecimal digits")
    return plain


def verify_bundle(
    bundle: Bundle, pins: Collection[str], *, now: datetime
) -> tuple[Credentials, ...]:
    """The credentials in `bundle`, if everything in it holds at `now`; its keys aside.

    `pins` are SHA-256 fingerprints: the bundle's CAs must be these and no others, so that
    none can be left out either. VerificationError lists everything that is wrong,
    MalformedError tells of a file that cannot be read.
    """
    _check_pins(bundle, pins)
    found = [Credentials.of(name, files) for name, files in bundle.enclaves.items()]
    problems = [f"{each.name}: {problem}" for each in found for problem in _problems(each, now)]
    if problems:
        raise VerificationError(*problems)
    return tuple(found)


def older_parts(new: Credentials, old: Credentials) -> list[str]:
    """What of `new` is older than in `old`, by what their signers say; both hold.

    Of another participant only what all of them share can be.
    """
    problems, files = [], [GOVERNANCE]
    if new.name == old.name:
        files.append(PERMISSIONS)
        if new.certificate.not_before < old.certificate.not_before:
            problems.append("the certificate is older than the one installed")
    # Another CA counts its lists from one, and who trusts two has none (docs/rollover.md).
    comparable = new.identity_ca.spki == old.identity_ca.spki
    comparable &= not (new.trusts_two and new.revocation_list is None)
    if comparable and _number(new) < _number(old):
        problems.append("the revocation list is older than the one installed")
    problems += [
        f"{file} is older than the one installed"
        for file in files
        if _signed_at(new, file) < _signed_at(old, file)
    ]
    return [f"{new.name}: {problem}" for problem in problems]


def keys_of(
    credentials: Credentials, candidates: Iterable[Mapping[str, bytes]]
) -> Mapping[str, bytes]:
    """The first of `candidates`, files by name, with the certificate's key or keys.

    VerificationError if none has them.
    """
    certificate = credentials.certificate
    second = certificate.alternative_key
    for files in candidates:
        key, other = _key(files, KEY), _key(files, ALT_KEY)
        if key is None or key.public_key.spki != certificate.spki:
            continue
        if second is None:
            return {KEY: files[KEY]}
        if other is not None and other.public_key.spki == second.spki:
            return {KEY: files[KEY], ALT_KEY: files[ALT_KEY]}
    raise VerificationError(
        f"{credentials.name}: no private key here is that of the certificate",
        hint="the bundle is for another robot, or answers another request",
    )


def _key(files: Mapping[str, bytes], name: str) -> PrivateKey | None:
    with suppress(PqsecError):
        return load_private_key(files[name]) if name in files else None
    return None


def _revocation_list(name: str, data: bytes | None) -> RevocationList | None:
    if data is None:
        return None
    with located(f"{name} {LIST}"):
        if data.count(b"-----BEGIN") != 1:
            raise MalformedError("not one revocation list in PEM")
        return RevocationList.from_pem(data)


def _check_pins(bundle: Bundle, pins: Collection[str]) -> None:
    unknown = [each for each in bundle.fingerprints if each not in pins]
    lacking = [each for each in pins if each not in bundle.fingerprints]
    problems = [f"a CA in the bundle is not one that is trusted: SHA-256 {e}" for e in unknown]
    problems += [f"the bundle lacks a CA that is trusted: SHA-256 {each}" for each in lacking]
    if problems:
        raise VerificationError(
            *problems, hint="`pqsec ca show`, where the CAs are, prints the fingerprints"
        )


def _problems(who: Credentials, now: datetime) -> Iterator[str]:
    ca, list_, countersigner = who.identity_ca, who.revocation_list, who.countersigner
    twice = who.twice
    # 9.3.3: the identity
    yield from _wrong(lambda: verify_chain(who.certificate, ca, now=now, require_alternative=twice))
    if who.certificate.subject_der != common_name(who.name):
        yield f"the certificate is for {who.certificate.subject_name}"
    if list_:
        yield from _wrong(
            lambda: verify_not_revoked(
                who.certificate, list_, ca, now=now, require_alternative=twice
            )
        )
    # 9.4.3: the permissions CA, then what it signed
    if who.permissions_ca.spki == ca.spki:
        yield "one key is identity CA and permissions CA (CVE-2023-24010)"
    yield from _wrong(lambda: verify_authority(who.permissions_ca, now=now), PERMISSIONS_CA)
    if countersigner:
        yield from _wrong(lambda: verify_authority(countersigner, now=now), PERMISSIONS_ALT_CA)
    yield from _wrong(lambda: Governance.from_xml(_document(who, who.governance)), GOVERNANCE)
    yield from _wrong(lambda: _check_permissions(who, now), PERMISSIONS)


def _check_permissions(who: Credentials, now: datetime) -> None:
    permissions = Permissions.from_xml(_document(who, who.permissions))
    subject = who.certificate.subject_name
    own = [grant for grant in permissions.grants if grant.subject_name == subject]
    if not own:
        raise VerificationError(f"nothing in them is granted to {subject}")
    if not any(grant.not_before <= now <= grant.not_after for grant in own):
        spans = [f"{each.not_before:%Y-%m-%d} to {each.not_after:%Y-%m-%d}" for each in own]
        raise VerificationError(f"not valid now, but {', '.join(spans)}")


def _number(who: Credentials) -> int:
    """Of the revocation list; -1 where there is none."""
    found = who.revocation_list
    return -1 if found is None or found.number is None else found.number


def _signed_at(who: Credentials, file: str) -> datetime:
    """When the document was, as its signer says; long ago where it does not."""
    message = who.permissions if file == PERMISSIONS else who.governance
    found = verify(message, who.permissions_ca).signatures[0].signed_at
    return found or datetime.min.replace(tzinfo=UTC)


def _document(who: Credentials, message: bytes) -> bytes:
    return verify(
        message, who.permissions_ca, alternative_ca=who.countersigner, require=who.required
    ).document


def _wrong(check: Callable[[], object], what: str = "") -> list[str]:
    """What `check` complains of, each with `what` it is about."""
    try:
        check()
    except PqsecError as error:
        return [f"{what}: {line}" if what else line for line in error.lines]
    return []
