"""pqsec enrol: a robot gets its first credentials from a server."""

from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pqsec_pki._dataclass import dataclass
from pqsec_pki._libraries import needs_libraries
from pqsec_pki.algorithms import profile_named
from pqsec_pki.cli import _help, _key_uris, _network, _passphrases, _settings
from pqsec_pki.cli.ca import Profiles
from pqsec_pki.cli.request import folder_option
from pqsec_pki.enrolment import Pins, pins_of
from pqsec_pki.errors import PqsecError, UsageError, located
from pqsec_pki.est import EnrolmentToken, checked_url

if TYPE_CHECKING:
    from pqsec_pki.est import EstClient, ServerTrust


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """The values of the command line and the token file together."""

    token: EnrolmentToken | None
    server: str
    names: tuple[str, ...]
    profiles: tuple[str, ...]
    pins: Pins | None


@_help.command(
    examples={
        "Enrol with the token that you got for this robot": (
            "pqsec enrol --token-file robot1.token --dir /etc/dds"
        ),
        "Enrol two participants of this robot with a token for both": (
            "pqsec enrol --token-file robot1.token --name /robot1/nav --name /robot1/arm"
        ),
        "Enrol with the certificate of the device, at a server with one of the factory's CA": (
            "pqsec enrol https://enrol.example --name /fleet/robot2 --factory-cert device.pem"
            " --factory-key device.key --server-ca factory.pem --trust-first"
        ),
    },
    exit_codes={
        0: "enrolled, now or earlier",
        1: "refused, by the server or by the checks of `pqsec install`",
        3: (
            "not enrolled yet: the request waits for an approval, the server cannot be reached, or"
            " DIR cannot be written; run it again"
        ),
    },
)
@click.argument("url", required=False, metavar="[URL]")
@click.option(
    "--token-file",
    type=_settings.FILE,
    metavar="FILE",
    help="Enrol with the token in this file, which also names the server and the CAs.",
)
@click.option(
    "--name",
    "names",
    multiple=True,
    metavar="NAME",
    help="Enrol as this participant; one option for each.  [default: that of the token]",
)
@click.option(
    "--factory-cert",
    type=_settings.FILE,
    metavar="FILE",
    help="Enrol with this certificate of the device, and the CAs below it.",
)
@click.option("--factory-key", type=_settings.FILE, metavar="FILE", help="Its private key.")
@_network.server_options
@click.option(
    "--trust-first",
    is_flag=True,
    help="If nothing is installed yet, trust the CAs that the server sends.",
)
@click.option(
    "--profile",
    "profile_names",
    type=Profiles(),
    help="Make keys of this profile, or of several with commas between them.  [default: as the"
    " token says, or as the installed keys]",
)
@_key_uris.participant_options
@folder_option
@click.option(
    "--wait",
    type=_settings.WaitingTime(),
    default=timedelta(),
    metavar="TIME",
    help="If somebody must approve the request, wait for so long, such as 90s, 5m or 12h."
    "  [default: not at all]",
)
@click.option(
    "--classical", is_flag=True, help="Accept a server without post-quantum key agreement."
)
@click.option("--force", is_flag=True, help="Make a new request, whatever is installed or waits.")
@_settings.command_options
def enrol(  # noqa: PLR0913 -- one for each option, by name
    *,
    url: str | None,
    token_file: Path | None,
    names: tuple[str, ...],
    factory_cert: Path | None,
    factory_key: Path | None,
    server_pins: tuple[str, ...],
    server_ca: Path | None,
    fingerprints: tuple[str, ...],
    profile_names: tuple[str, ...] | None,
    folder: Path,
    wait: timedelta,
    trust_first: bool,
    classical: bool,
    force: bool,
) -> None:
    """Enrol this robot at a server: make its keys, install what it answers.

    The keys stay on the robot. The server is known by its key or by its CA, and what it sends is
    checked as by `pqsec install`, under the CAs of the token or of --ca-fingerprint. Then the
    server gets the receipt. DIR/server.json says where to renew: `pqsec renew --from URL`.

    The command may be stopped at any time: run it again, and it sends the same request, to which
    the server gives the same answer.
    """
    asked = _asked(url, names, token_file, profile_names or (), pins_of(fingerprints) or None)
    with needs_libraries(_network.NEEDS):
        from pqsec_pki import est  # noqa: PLC0415 -- a library of an extra

        trust = _network.server_trust(server_pins, server_ca) or _token_trust(asked.token)
        client = _client(asked, trust, (factory_cert, factory_key), classical=classical)
        profiles = tuple(map(profile_named, asked.profiles))
        terms = est.KeyTerms(
            profile=profiles[0] if profiles else None,
            further=profiles[1:],
            pins=asked.pins,
            trust_first=trust_first,
            uris=_key_uris.given_for_participant(),
            pin=_passphrases.pin,
            force=force,
        )
        found: list[est.Obtained | PqsecError] = []
        for name in asked.names:
            try:
                done = est.enrol(client, name, folder, terms, clock=_settings.now, patience=wait)
            except PqsecError as error:
                if len(asked.names) == 1:
                    raise
                error.where = error.where or name
                found.append(error)
            else:
                found.append(done)
        _network.report(found, folder)


def _asked(
    url: str | None,
    names: tuple[str, ...],
    file: Path | None,
    profiles: tuple[str, ...],
    pins: Pins | None,
) -> _Asked:
    token = _token(file) if file else None
    server = checked_url(url) if url else token and token.server
    if not server:
        raise UsageError("no server is named: give its URL, or --token-file")
    if token and server != token.server:
        raise UsageError(f"the token is for {token.server}, not for {server}")
    if not names and token and "*" not in token.names:
        names = (token.names,)
    if not names:
        of_token = f", one of the token's {token.names}" if token else ""
        raise UsageError(f"no participant is named{of_token}", hint="--name NAME")
    return _Asked(
        token=token,
        server=server,
        names=tuple(dict.fromkeys(names)),
        profiles=profiles or (tuple(token.profile.split(",")) if token else ()),
        pins=pins or (token.cas if token else None),
    )


def _token(file: Path) -> EnrolmentToken:
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for --help
    from pqsec_pki._places import refuse_obeyed  # noqa: PLC0415 -- likewise
    from pqsec_pki.est import MAX_TOKEN_FILE  # noqa: PLC0415 -- likewise

    _passphrases.note_open(file)
    refuse_obeyed([file], "which server and CAs are trusted")
    with located(file):
        return EnrolmentToken.from_bytes(read(file, limit=MAX_TOKEN_FILE))


def _token_trust(token: EnrolmentToken | None) -> "ServerTrust":
    from pqsec_pki.est import ServerTrust  # noqa: PLC0415 -- a library of an extra

    return ServerTrust(token.server_pins if token else frozenset())


def _client(
    asked: _Asked,
    trust: "ServerTrust",
    factory: tuple[Path | None, Path | None],
    *,
    classical: bool,
) -> "EstClient":
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for --help
    from pqsec_pki.est import EstClient, TlsIdentity  # noqa: PLC0415 -- a library of an extra

    certificate, key = factory
    if bool(certificate) != bool(key):
        raise UsageError("--factory-cert and --factory-key need each other")
    identity = None
    if certificate and key:
        with located(key):
            identity = TlsIdentity.of(read(certificate), read(key))
    return EstClient(
        server=asked.server,
        trust=trust,
        identity=identity,
        secret=(asked.token.id, asked.token.secret) if asked.token else None,
        classical=classical,
    )
