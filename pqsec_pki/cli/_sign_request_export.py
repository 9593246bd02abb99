"""pqsec sign-request export: requests and the rights they need, for CAs on an offline machine."""

import hashlib
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from pqsec_pki import _files
from pqsec_pki.approvals import MAX_GRANT, RegistrationGrant, SignedGrant
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.cli import _approver, _bundles, _help, _printing, _settings
from pqsec_pki.cli._participant_options import (
    TOPIC_NAMES,
    ParticipantOptions,
    participant_options,
)
from pqsec_pki.documents import DomainSet
from pqsec_pki.domain import uncovered
from pqsec_pki.enrolment import NAMELESS, SignRequest, name_asked_for, ordered
from pqsec_pki.errors import UsageError, VerificationError, located

force_option = click.option("--force", is_flag=True, help="Replace existing files or participants.")


@_help.command(
    examples={
        "Collect the requests of two robots": (
            "pqsec sign-request export robot2.csr robot3.csr --publish rt/chatter -o fleet.request"
        ),
        "Order an enrolment as a registration authority": (
            "pqsec sign-request export robot2.csr --grant line1.grant --key line1.pem -o order"
        ),
    },
    exit_codes={
        0: "the file is written",
        1: "a request or the policy is not valid",
        3: "a file cannot be read or written",
    },
)
@click.argument("requests", nargs=-1, required=True, type=_settings.FILE, metavar="CSR...")
@click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="Allow these DDS domains: 0, or 0-3, or 0,5.",
)
@participant_options
@click.option(
    "--grant",
    type=_settings.FILE,
    help="Order it as a registration authority: the file of its grant, from `pqsec ra add`.",
)
@click.option("--key", metavar="FILE|URI", help="With --grant: the RA's private key.")
@click.option(
    "--role",
    metavar="ROLE",
    help="With --grant: enrol them in this role.  [default: its only one]",
)
@_approver.passphrase_option
@click.option("-o", "--output", type=_settings.FILE, required=True, help="Write to this file.")
@force_option
@_settings.command_options
def export(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    requests: tuple[Path, ...],
    domains: str,
    grant: Path | None,
    key: str | None,
    role: str | None,
    key_passphrase_file: Path | None,
    output: Path,
    *,
    force: bool,
    **wanted: Any,
) -> None:
    """Write requests of robots, and the rights they need, into one file.

    A keystore is not needed. Compare the SHA-256 that is printed with the one that
    `pqsec sign-request sign` prints. With --grant and --key it is an order of a registration
    authority, whose grant has the rights, and is performed without a question.
    """
    if (grant is None) is not (key is None) or (role and not grant):
        raise UsageError("--grant and --key need each other, and --role needs both")
    found = _bundles.load_requests(requests)
    names = _names_in(found)
    csrs = tuple(each for _, each in found)
    if grant and key is not None:
        given = _settings.given_options()
        _refuse_rights(given)
        validity = wanted["validity"] if "validity" in given else None
        asked = _ordered(csrs, _grant(grant), key, key_passphrase_file, role, validity)
    else:
        specs = ParticipantOptions.of(**wanted).specs(tuple(names), DomainSet.parse(domains))
        asked = SignRequest(csrs, tuple(specs))
    data = asked.to_bytes(now=_settings.now())
    _files.write(output, data, force=force)
    sha256 = hashlib.sha256(data).hexdigest()
    value = {"written": output, "names": names, "sha256": sha256}
    _printing.emit(value, [*names, f"{output}  SHA-256 {sha256}"])


def _names_in(requests: Sequence[tuple[Path, CertificateRequest]]) -> list[str]:
    """The name that each request asks for. Each proves possession of its keys."""
    names = []
    for path, request in requests:
        with located(path):
            request.verify()
            name = name_asked_for(request)
            if name is None:
                raise VerificationError(NAMELESS)
            names.append(name)
    if len(set(names)) < len(names):
        raise UsageError("two requests have the same name")
    return names


def _ordered(  # noqa: PLR0913, PLR0917 -- the options of the command
    requests: tuple[CertificateRequest, ...],
    grant: RegistrationGrant,
    key: str,
    key_passphrase_file: Path | None,
    role: str | None,
    validity: timedelta | None,
) -> SignRequest:
    """These requests as an order with that grant; UsageError if the grant does not cover it."""
    signer = _approver.key_at(key, key_passphrase_file)
    length = grant.longest if validity is None else validity
    asked = ordered(requests, grant, signer, role, validity=length, now=_settings.now())
    if asked.order and (why := next(uncovered(asked.order.items, grant), None)):
        raise UsageError(why)
    return asked


def _grant(path: Path) -> RegistrationGrant:
    with located(path):
        return SignedGrant.from_file(_files.read(path, limit=MAX_GRANT)).grant


def _refuse_rights(given: Mapping[str, str]) -> None:
    """UsageError for an option that names rights: those of a role are in the grant."""
    rights = [given[each] for each in (*TOPIC_NAMES, "policy", "domains") if each in given]
    if rights:
        raise UsageError(
            f"{rights[0]} cannot be ordered: the grant has the rights of each role",
            hint="--role names one of them",
        )
