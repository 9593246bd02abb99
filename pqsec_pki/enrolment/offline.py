"""CAs on an offline machine: requests go there in one file, and answers come back in one.

The machine that collects requests has no CA key. Both files detect damage, and an answer names
the SHA-256 of the request file. An answer is authentic by the CAs' signatures in it; a
request is authentic if the person who signs compares its SHA-256.
"""

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_there, read
from pqsec_pki.algorithms import PrivateKey, Profile
from pqsec_pki.approvals import EnrolmentOrder, OrderedName, RegistrationGrant
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.credentials import CERTIFICATE, only_certificate
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.enrolment.bundle import Bundle, bundle_path, flat_name, save
from pqsec_pki.enrolment.csr_validation import validate_csrs
from pqsec_pki.enrolment.participant_spec import policy_file, read_spec, spec_value
from pqsec_pki.enrolment.pins import Pins
from pqsec_pki.enrolment.tarball import MAX_ARCHIVE, pack
from pqsec_pki.enrolment.verification import verify_bundle
from pqsec_pki.errors import (
    ExistsError,
    MalformedError,
    PqsecError,
    TooLargeError,
    UsageError,
    VerificationError,
    located,
)
from pqsec_pki.keystore import Authorities, BundleNumbers, Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue

REQUEST_KIND, ANSWER_KIND = "sign request", "sign answer"
ORDER = "order.json"
ORDER_VALIDITY = timedelta(days=7)
"""A later order is not performed."""
_NO_RIGHTS: Mapping[str, object] = {"domains": "0", "publish": [], "subscribe": []}
MAX_UNPACKED = 256 << 20
"""Bytes of all unpacked bundles in an answer: four times the limit of one archive."""

_OF_BUNDLE = 2 << 10
"""Bytes of a packed bundle beside its files and keys: headers and the manifest."""
_FEWER = (
    "ask for fewer participants at once; `pqsec bundle` writes bundles of those that are issued"
)


@dataclass(frozen=True, slots=True)
class SignRequest:
    """Certificate requests of robots, and the permissions that each asks for."""

    requests: tuple[CertificateRequest, ...]
    specs: tuple[ParticipantSpec, ...]
    """One for each request, in their order; without rights if there is an order."""
    sha256: str = ""
    """SHA-256 of the file it was read from, in hex."""
    order: EnrolmentOrder | None = None
    """The order of a registration authority, whose grant decides; None without one."""

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The sign request in `data`; MalformedError, or VerificationError if it is damaged."""
        archive = Archive.unpack(data, REQUEST_KIND)
        order = None
        if ORDER in archive.files:
            order = EnrolmentOrder.from_file(archive.files[ORDER])
        try:
            specs = tuple(map(_ordered, order.items) if order else _specs_in(archive))
            pems = [archive.files[_request_file(spec.name)] for spec in specs]
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise MalformedError(f"the {REQUEST_KIND} cannot be read: {error}") from error
        except UsageError as error:
            raise MalformedError(f"the {REQUEST_KIND} is not valid: {error}") from error
        if not specs:
            raise MalformedError(f"the {REQUEST_KIND} asks for nothing")
        requests = tuple(map(CertificateRequest.from_pem, pems))
        return cls(requests, specs, hashlib.sha256(data).hexdigest(), order)

    def to_bytes(self, *, now: datetime) -> bytes:
        """The sign request as the bytes of a file."""
        files: dict[str, bytes] = {}
        for request, spec in zip(self.requests, self.specs, strict=True):
            files[_request_file(spec.name)] = request.pem
            if policy := spec.policy:
                files[policy_file(spec.name)] = policy
        about: dict[str, object] = {"created": now.isoformat(timespec="seconds")}
        if self.order:
            files[ORDER] = self.order.to_file()
        else:
            about["wishes"] = [spec_value(spec) for spec in self.specs]
        return Archive(REQUEST_KIND, about, files).pack()

    def to_json(self) -> dict[str, object]:
        """What is asked for each participant, for --json."""
        return {"sha256": self.sha256, "participants": list(map(_spec_json, self.specs))}

    def admitted(
        self, profiles: Sequence[Profile], patterns: Collection[str] = ()
    ) -> tuple[ParticipantSpec, ...]:
        """The participant specs with their public keys, after all requests were validated.

        Each request must be valid and for the name of its spec; with `patterns`, the name must
        also match one of them. VerificationError if not.
        """
        names = [spec.name for spec in self.specs]
        keys = validate_csrs(self.requests, profiles, names=names)
        if patterns:
            validate_csrs(self.requests, profiles, patterns=patterns)
        return tuple(
            replace(spec, keys=keys[spec.name].answering(self.sha256)) for spec in self.specs
        )


def _specs_in(archive: Archive) -> Iterator[ParticipantSpec]:
    """What is asked for; errors as of `read_spec`, and KeyError."""
    for each in archive.about["wishes"]:
        yield read_spec(each, archive.files)


def _ordered(item: OrderedName) -> ParticipantSpec:
    """The participant without rights: its grant has them."""
    return read_spec({**_NO_RIGHTS, "name": item.name, "validity_hours": item.hours}, {})


def _spec_json(spec: ParticipantSpec) -> dict[str, object]:
    return {
        "name": spec.name,
        "domains": str(spec.domains),
        "publish": spec.publish,
        "subscribe": spec.subscribe,
        "policy": bool(spec.grants),
        "permissions": spec.policy and spec.policy.decode().rstrip("\n"),
        "hours": spec.validity // timedelta(hours=1),
    }


def ordered(  # noqa: PLR0913 -- the choices are the user's, and by name
    requests: Sequence[CertificateRequest],
    grant: RegistrationGrant,
    key: PrivateKey,
    role: str | None = None,
    *,
    validity: timedelta,
    now: datetime,
) -> SignRequest:
    """These requests as an order of the registration authority with that grant and `key`.

    `role` may be left out if there is one. UsageError for what the grant visibly does not have;
    what it covers is decided where the order is performed. VerificationError for another key.
    """
    if key.public_key.spki != grant.key.spki:
        raise VerificationError(f"this key is not that of {grant.authority} in the grant")
    roles = [*grant.roles]
    if role is None and len(roles) > 1:
        raise UsageError("the grant has several roles", hint=f"--role: {', '.join(roles)}")
    chosen = roles[0] if role is None else role
    if chosen not in roles:
        raise UsageError(f"the grant has no role {chosen}", hint=f"it has {', '.join(roles)}")
    items = tuple(
        OrderedName(each.common_name or "", chosen, validity, each.fingerprint) for each in requests
    )
    order = EnrolmentOrder.signed(grant.digest, items, key, now=now, validity=ORDER_VALIDITY)
    return SignRequest(tuple(requests), tuple(map(_ordered, items)), order=order)


def sign(  # noqa: PLR0913 -- the choices are the user's, and by name
    asked: SignRequest,
    keystore: Keystore,
    authorities: Authorities,
    *,
    now: datetime,
    patterns: Collection[str] = (),
    force: bool = False,
    after_revocation: bool = False,
    compromised_keys: bool = False,
) -> bytes:
    """Issue everything in the sign request `asked`; returns the answer, a bundle per request.

    A certificate that was issued for the same request before, and is still the newest, is not
    issued again. Errors as in `validate_csrs` and `issue`; VerificationError for an order, whose
    rights only its grant says.
    """
    if asked.order:
        raise VerificationError("a registration authority's order is performed by its grant")
    specs = asked.admitted(keystore.profiles, patterns)
    with keystore.open_ledger() as ledger:
        done = {each.name: each.details.get("request") for each in ledger.newest("participant")}
    new = [spec for spec in specs if done.get(spec.name) != asked.sha256]
    refuse_large_answer(asked, keystore)
    if new:
        issue(
            keystore,
            authorities,
            new,
            now=now,
            force=force,
            after_revocation=after_revocation,
            compromised_keys=compromised_keys,
        )
    return answered(asked, keystore, now=now)


def refuse_large_answer(asked: SignRequest, keystore: Keystore) -> None:
    """TooLargeError if the answer would be too large, before anything is issued for it.

    Its size is estimated: each bundle has the CAs' files, the governance and the list of each set,
    as they are now, and a certificate with the request's keys.
    """
    found = [data for each in keystore.sets for data in _shared_files(each)]
    shared = {f"n{number}": data for number, data in enumerate(found)}
    count, packed = len(asked.specs), len(pack(shared))
    own = sum(len(each.der) for each in asked.requests)
    own += sum(len(each.policy or b"") + _OF_BUNDLE for each in asked.specs)
    signed = count * sum(len(each.identity_ca.der) for each in keystore.sets)
    TooLargeError.check("the answer", count * packed + own + signed, MAX_ARCHIVE, hint=_FEWER)
    whole = count * sum(map(len, shared.values()))
    TooLargeError.check("the bundles in the answer", whole + own, MAX_UNPACKED, hint=_FEWER)


def _shared_files(keystore: Keystore) -> Iterator[bytes]:
    """About what a set's enclaves have in common; and permissions, which are signed likewise."""
    anchors, revoked = keystore.anchors, keystore.revocation_list
    yield from (each.pem for each in (*anchors.identity_cas, anchors.permissions_ca))
    yield from (keystore.governance,) * 2
    if revoked:
        yield revoked.pem


def answered(asked: SignRequest, keystore: Keystore, *, now: datetime) -> bytes:
    """The answer to a sign request whose participants are issued: a bundle for each.

    TooLargeError for one that `accept` would refuse.
    """
    names = [spec.name for spec in asked.specs]
    with BundleNumbers.of(keystore) as numbers:
        one = partial(Bundle.of, keystore, now=now, keys=False, numbers=numbers)
        bundles = {name: one([name]) for name in names}
    size = sum(map(_unpacked, bundles.values()))
    TooLargeError.check("the bundles in the answer", size, MAX_UNPACKED, hint=_FEWER)
    files = {_bundle_file(name): bundle.to_bytes() for name, bundle in bundles.items()}
    about = {
        "created": now.isoformat(timespec="seconds"),
        "request_sha256": asked.sha256,
        "names": names,
    }
    return Archive(ANSWER_KIND, about, files).pack()


def same_answers(one: bytes, other: bytes) -> bool:
    """Whether both answer the same request with the same files, whenever they were made."""
    try:
        return _content(one) == _content(other)
    except PqsecError:
        return False


def _content(answer: bytes) -> tuple[str, dict[str, str]]:
    """The request, and for each file its bundle's SHA-256."""
    archive = Archive.unpack(answer, ANSWER_KIND)
    files = {name: Bundle.from_bytes(data).sha256 for name, data in archive.files.items()}
    return archive.text("request_sha256"), files


@dataclass(frozen=True, slots=True)
class Accepted:
    """A bundle from an answer, for one participant."""

    name: str
    path: Path
    already: bool
    """Whether the file existed already with the same content."""


def accept(  # noqa: PLR0913 -- the choices are the user's, and by name
    answer: bytes,
    asked: SignRequest,
    folder: Path,
    *,
    pins: Pins | None = None,
    now: datetime,
    force: bool = False,
) -> list[Accepted]:
    """Write the bundles of an answer to the sign request `asked` into `folder`, all or none.

    VerificationError if it answers another request or is not valid; with `pins` its CAs must
    be these. ExistsError if another bundle exists in the place of one, unless `force`.
    """
    bundles = _answers(Archive.unpack(answer, ANSWER_KIND), asked)
    for bundle in bundles.values():
        verify_bundle(bundle, pins or bundle.roles, now=now)
    goals = {name: bundle_path(folder, name) for name in bundles}
    there = {name for name, goal in goals.items() if _is_there(goal, bundles[name], force=force)}
    for name in (each for each in bundles if each not in there):
        save(goals[name], bundles[name].to_bytes(), force=force)
    return [Accepted(name, goal, name in there) for name, goal in goals.items()]


def _answers(archive: Archive, asked: SignRequest) -> dict[str, Bundle]:
    """The bundles by name: exactly one for each request, with a certificate for its keys."""
    if archive.text("request_sha256") != asked.sha256:
        raise VerificationError("it answers another request than this one")
    names = [spec.name for spec in asked.specs]
    if sorted(archive.files) != sorted(map(_bundle_file, names)):
        raise VerificationError("it does not have exactly one answer for each request")
    found = dict(_bundles_in(archive, names))
    problems = []
    for (name, bundle), request in zip(found.items(), asked.requests, strict=True):
        if bundle.names != (name,):
            problems.append(f"the bundle of {name} is for {', '.join(bundle.names)}")
        elif not _fits(bundle, name, request):
            problems.append(f"the certificate of {name} is for another key than in the request")
    if problems:
        raise VerificationError(*problems)
    return found


def _bundles_in(archive: Archive, names: Sequence[str]) -> Iterator[tuple[str, Bundle]]:
    """The bundles in the answer, with a limit for their total size against compression bombs."""
    size = 0
    for name in names:
        bundle = Bundle.from_bytes(archive.files[_bundle_file(name)])
        size += _unpacked(bundle)
        if size > MAX_UNPACKED:
            raise MalformedError(f"its bundles are larger than {MAX_UNPACKED} bytes in total")
        yield name, bundle


def _unpacked(bundle: Bundle) -> int:
    return bundle.unpacked_size


def _fits(bundle: Bundle, name: str, request: CertificateRequest) -> bool:
    """Whether it has, in each set, the certificate for the keys that were asked for."""
    with located(name):
        found = [
            only_certificate(files[name][CERTIFICATE], CERTIFICATE)
            for files in bundle.sets.values()
        ]
    return [(each.spki, each.alternative_spki) for each in found] == [
        (each.spki, each.alternative_spki) for each in request.sets
    ]


def _is_there(goal: Path, bundle: Bundle, *, force: bool) -> bool:
    """Whether the same bundle exists already; ExistsError if anything else does."""
    if not is_there(goal):
        return False
    try:
        same = Bundle.from_bytes(read(goal, limit=MAX_ARCHIVE)).sha256 == bundle.sha256
    except PqsecError:
        same = False
    if not same and not force:
        raise ExistsError(
            f"{goal} exists and is a different bundle",
            hint="choose another -o, or --force to replace it",
        )
    return same


def _request_file(name: str) -> str:
    return f"requests/{flat_name(name)}.csr"


def _bundle_file(name: str) -> str:
    return f"bundles/{flat_name(name)}.bundle"
