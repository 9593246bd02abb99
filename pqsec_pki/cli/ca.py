"""pqsec ca: create and show the two CAs, and the identity CA's revocation list."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki._files import refuse_existing, write
from pqsec_pki.algorithms import DEFAULT_PROFILE, PROFILES, Profile, profile_named
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.cli import _completion, _help, _key_uris, _passphrases, _printing, _settings
from pqsec_pki.cli._times import day
from pqsec_pki.cli.add_set import add_set
from pqsec_pki.cli.passphrase import passphrase
from pqsec_pki.cli.remove_set import remove_set
from pqsec_pki.cli.revoke import list_line, list_validity_option
from pqsec_pki.cli.rotate import rotate
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import (
    CurrentFiles,
    Keystore,
    LedgerAddress,
    Overview,
    SigningCa,
    ca_key_places,
    list_delivery,
    one_set,
    overview_of,
)
from pqsec_pki.lifecycle import renew_list


@_help.group()
@_settings.command_options
def ca() -> None:
    """Create, show and change the CAs and the revocation list."""


ca.add_command(add_set)
ca.add_command(passphrase)
ca.add_command(remove_set)
ca.add_command(rotate)

profile_option = click.option(
    "--profile",
    "profile_name",
    type=click.Choice([profile.name for profile in PROFILES], case_sensitive=False),
    default=DEFAULT_PROFILE.name,
    show_default=True,
    help="Choose the algorithms; `pqsec profiles` explains them.",
)


class Profiles(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """Profiles with commas between them: one for each set of credentials."""

    name = "profiles"

    def __init__(self) -> None:
        super().__init__([profile.name for profile in PROFILES], case_sensitive=False)

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """The names. Raises click's error for an unknown one."""
        if isinstance(value, tuple):
            return value
        one = super().convert
        return tuple(one(each, param, ctx) for each in str(value).split(","))


@ca.command(
    examples={
        "Create a keystore for ROS 2 nodes on domain 0": (
            "pqsec -k my-domain ca init --name Robots --passphrase-file passphrase"
        ),
        "Create one with post-quantum keys only, for tests": (
            "pqsec -k my-test ca init --profile pq --no-passphrase"
        ),
        "Create one with two sets of credentials": (
            "pqsec -k my-domain ca init --profile classical,hybrid --no-passphrase"
        ),
    },
    exit_codes={
        0: "the keystore is created",
        3: (
            "the folder already has a keystore or cannot be written, or the passphrase file cannot"
            " be read"
        ),
    },
)
@click.option(
    "--profile",
    "profile_names",
    type=Profiles(),
    default=DEFAULT_PROFILE.name,
    show_default=True,
    help="Choose the algorithms; `pqsec profiles` explains them. Profiles with commas between"
    " them give a set of credentials each.",
)
@click.option(
    "--identity-key",
    metavar="NAME",
    help="Choose another kind of identity CA key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--permissions-key",
    metavar="NAME",
    help="Choose another kind of permissions CA key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--participant-key",
    metavar="NAME",
    help="Choose another kind of participant key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--alt-key",
    metavar="NAME",
    help="Choose another kind of alternative key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--kem",
    metavar="NAME",
    help="Choose another key agreement.",
    shell_complete=_completion.key_agreements,
)
@_key_uris.options_of_sets
@click.option("--name", default="", help="Start the names of the CAs with this.")
@click.option(
    "--validity",
    type=_settings.Duration(),
    default="10y",
    show_default=True,
    help="Issue the CA certificates for this long.",
)
@click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="Govern these DDS domains: 0, or 0-3, or 0,5.",
)
@click.option(
    "--ledger",
    metavar="URL",
    help="Keep the ledger in this database, for several machines: postgresql://USER@HOST/DATABASE.",
)
@_passphrases.option
@_passphrases.weak_option
@click.option("--no-passphrase", is_flag=True, help="Leave the CA keys unencrypted.")
@_settings.command_options
def init(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    profile_names: tuple[str, ...],
    identity_key: str | None,
    permissions_key: str | None,
    participant_key: str | None,
    alt_key: str | None,
    kem: str | None,
    name: str,
    validity: timedelta,
    domains: str,
    ledger: str | None,
    passphrase_file: Path | None,
    *,
    no_passphrase: bool,
) -> None:
    """Create a keystore: two CAs and a signed governance document.

    The governance authenticates and encrypts everything on the domains. To change that,
    edit enclaves/governance.xml and sign it with `pqsec sign-governance`.
    """
    choices = {
        "identity_key": identity_key,
        "permissions_key": permissions_key,
        "participant_key": participant_key,
        "alternative_key": alt_key,
        "key_agreement": kem,
    }
    profiles = profiles_of(profile_names, choices)
    domain_set = DomainSet.parse(domains)
    path = _settings.keystore_path()
    Keystore.refuse_occupied(path)
    places = ca_key_places(profiles)
    with _key_uris.keys(places, _key_uris.given_for_sets(profiles)) as keys:
        in_files = len(keys) < len(places)
        keystore = Keystore.create(
            path,
            *profiles,
            name=name,
            domains=domain_set,
            validity=validity,
            passphrase=_passphrases.new(passphrase_file, none=no_passphrase) if in_files else None,
            keys=keys,
            ledger=LedgerAddress.parse(ledger) if ledger else None,
            gitignore=True,
            now=_settings.now(),
        )
    if no_passphrase and in_files:
        _passphrases.note_unencrypted(path)
    _show(keystore)


def profiles_of(names: Sequence[str], choices: Mapping[str, str | None]) -> list[Profile]:
    """The profile of each set; UsageError for other algorithms that could be for several sets."""
    if len(names) > 1 and any(choices.values()):
        raise UsageError("options for single algorithms are for a keystore with one profile")
    return [profile_named(each).changed({**choices}) for each in names]


@ca.command(
    examples={
        "Show the CAs and participants": "pqsec ca show",
        "Print the options with which a robot trusts exactly these CAs": "pqsec ca show --pins",
    },
    exit_codes={
        0: "the CAs are shown",
        3: "the keystore cannot be read",
    },
)
@click.option(
    "--pins", is_flag=True, help="Print only the --ca-fingerprint options for `pqsec install`."
)
@_settings.command_options
def show(*, pins: bool) -> None:
    """Show the CAs, the profile and the participants of a keystore."""
    keystore = _settings.open_keystore()
    if pins:
        _show_pins(keystore)
    else:
        _show(keystore)


@ca.command(
    examples={
        "Issue a list that is valid for 90 days": "pqsec ca crl --validity 90d",
        "Write a copy of the current list": "pqsec ca crl --show -o crl.pem",
    },
    exit_codes={
        0: "the list is issued or shown",
        3: "there is no list to show, the keystore cannot be changed, or the passphrase is wrong",
    },
)
@click.option("--show", is_flag=True, help="Show the current list, and do not issue a new one.")
@list_validity_option
@click.option("-o", "--out", type=_settings.FILE, help="Also write the list to this file, in PEM.")
@click.option(
    "--set", "profile", metavar="PROFILE", help="Write the list of the CA of this profile to --out."
)
@click.option("--force", is_flag=True, help="Replace an existing file at --out.")
@_passphrases.option
@_settings.command_options
def crl(  # noqa: PLR0913 -- one for each option, by name
    validity: timedelta,
    out: Path | None,
    profile: str | None,
    passphrase_file: Path | None,
    *,
    show: bool,
    force: bool,
) -> None:
    """Issue a new revocation list, or show the current one: one for each set of credentials.

    Without revoked certificates the list is empty. Stacks refuse all peers once their list
    has expired: issue a list early only if you will renew it in time.
    """
    keystore = _settings.open_keystore(to_change=not show)
    if profile and not out:
        raise UsageError("--set chooses the list that --out writes")
    chosen = one_set(keystore, profile) if out else None
    if out and not force:
        refuse_existing(out)
    if not show:
        authorities = _passphrases.unlock_with_signers(
            keystore, passphrase_file, SigningCa.IDENTITY
        )
        with keystore.hold():  # so that the ledger, as it is then, is not read again
            renew_list(keystore, authorities, now=_settings.now(), validity=validity)
            lists = [(each, _current_list(each)) for each in keystore.sets]
            delivery = list_delivery(keystore, now=_settings.now())
    else:
        lists = [(each, _current_list(each)) for each in keystore.sets]
        delivery = list_delivery(keystore, now=_settings.now())
    if out:
        [copied] = [found for each, found in lists if each == chosen]
        with _printing.with_hint("the list is issued: `pqsec ca crl --show -o FILE` writes a copy"):
            write(out, copied.pem, force=force)
    first, *further = [
        {"list": each.revocation_list_path, **found.to_json()} for each, found in lists
    ]
    lines = [list_line(each, found) for each, found in lists]
    value = {**first, "delivery": delivery, "further": further}
    _printing.emit(value, [*lines, *(delivery.lines if delivery else ())])


@ca.command(
    examples={
        "Finish an interrupted change": "pqsec ca recover",
    },
    exit_codes={
        0: "no change is left to finish",
        3: "the keystore cannot be read or changed",
    },
)
@_settings.command_options
def recover() -> None:
    """Finish a change of the keystore that was interrupted.

    Every command that changes the keystore does this first. Commands that only read the
    keystore refuse to run until it is done. With a ledger that machines share, it also gets the
    governance and the revocation list that another one made.
    """
    path = _settings.keystore_path()
    finished = Keystore.recover(path)
    line = "the interrupted change is finished" if finished else "no change was interrupted"
    _printing.emit({"keystore": path, "finished": finished}, [f"{path}: {line}"])


def _current_list(keystore: Keystore) -> RevocationList:
    """The newest list of that set; KeystoreError if there is none."""
    with CurrentFiles.of(keystore) as current:
        found = current.revocation_list
    if found is None:
        of_set = f" of profile {keystore.profile.name}" if keystore.sets[1:] else ""
        raise KeystoreError(
            f"there is no revocation list{of_set}",
            hint="`pqsec revoke` issues one, or `pqsec ca crl` an empty one",
        )
    return found


def _show_pins(keystore: Keystore) -> None:
    """Print the trusted CAs as options of `pqsec install`."""
    from pqsec_pki.enrolment import pin_texts, pins_in_use  # noqa: PLC0415 -- for --pins alone

    pins = pin_texts(pins_in_use(keystore))
    _printing.emit({"pins": pins}, [f"--ca-fingerprint {each}" for each in pins])


def _show(keystore: Keystore) -> None:
    found = overview_of(keystore)
    lines = (
        f"keystore       {found.keystore} ({_described(found.profile)})",
        *_set_lines(found),
        *(line for each in found.further for line in _further_lines(each)),
        f"{found.domains.noun:<14} {found.domains}",
        *([f"approvals      {found.approvals}"] if found.approvals else ()),
        *([f"ledger         {found.ledger.place}"] if found.ledger else []),
        f"participants   {', '.join(found.participants) or 'none yet: pqsec issue NAME'}",
    )
    _printing.emit(found.to_json(), lines)


def _further_lines(found: Overview) -> Iterator[str]:
    yield f"set            {found.folder} ({_described(found.profile)})"
    yield from _set_lines(found)


def _set_lines(found: Overview) -> Iterator[str]:
    """The CAs of a set, and where their keys are."""
    yield from (line for role, each in found.cas for line in _ca_lines(role, each))
    yield f"CA keys        {found.keys}"
    yield from (f"{'':<14} {name}: {uri}" for name, uri in found.key_uris.items())


def _ca_lines(role: str, ca: Certificate) -> Iterator[str]:
    yield f"{role:<14} {ca.subject_name}, {_algorithms(ca)}"
    yield f"{'':<14} until {day(ca.not_after)}, SHA-256 {ca.fingerprint}"


def _described(profile: Profile) -> str:
    return f"profile {profile.name}: {profile.summary}"


def _algorithms(certificate: Certificate) -> str:
    second = certificate.alternative_key
    main = certificate.public_key.algorithm.name
    return f"{main} and {second.algorithm.name}" if second else main
