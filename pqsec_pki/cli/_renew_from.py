"""pqsec renew --from: on a robot, what is due is renewed from a server."""

from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from pqsec_pki._libraries import needs_libraries
from pqsec_pki.cli import _network, _passphrases, _settings
from pqsec_pki.enrolment import Pins
from pqsec_pki.errors import UsageError
from pqsec_pki.est import checked_url

if TYPE_CHECKING:
    from pqsec_pki.est import KnownServer, ServerTrust

_KEYSTORE_ONLY = ("everybody", "validity", "passphrase_file", "compromised_keys")
_ROBOT_ONLY = ("folder", "server_pins", "server_ca", "fingerprints")


def refuse_mixed(url: str | None) -> None:
    """UsageError for options of a keystore with --from, or of a robot without it."""
    given = _settings.given_options()
    refused = _ROBOT_ONLY if url is None else _KEYSTORE_ONLY
    if found := [option for name, option in given.items() if name in refused]:
        words = "needs --from" if url is None else "is for a keystore, and excludes --from"
        hint = "--from URL names the server: DIR/server.json has its URL" if url is None else None
        raise UsageError(f"{found[0]} {words}", hint=hint)


def renew_from(  # noqa: PLR0913 -- what the command line says
    url: str,
    names: Sequence[str],
    folder: Path,
    server: tuple[Sequence[str], Path | None],
    pins: Pins | None,
    *,
    due: timedelta | None,
    rekey: bool | None,
) -> None:
    """Renew the participants in `folder`, and print what became of them."""
    if rekey is False:
        raise UsageError("--keep-key is for a keystore, and excludes --from")
    with needs_libraries(_network.NEEDS):
        from pqsec_pki import est  # noqa: PLC0415 -- a library of an extra

        known = _known(url, folder, _network.server_trust(*server))
        terms = est.KeyTerms(pins=pins, pin=_passphrases.pin)
        found = est.renew(
            known, names, folder, terms, clock=_settings.now, due=due, rekey=bool(rekey)
        )
        _network.report(list(found), folder)


def _known(url: str, folder: Path, trust: "ServerTrust | None") -> "KnownServer":
    """The server of that URL. UsageError if nothing says how it is known."""
    from pqsec_pki.est import KnownServer  # noqa: PLC0415 -- a library of an extra

    server, before = checked_url(url), KnownServer.at(folder)
    if before and before.server == server:
        return replace(before, trust=trust) if trust else before
    if trust:
        return KnownServer(server=server, trust=trust)
    where = (
        f"the server of {folder} is {before.server}" if before else f"{folder} has no server.json"
    )
    raise UsageError(
        f"{where}; say how to trust {server}",
        hint="--server-pin SHA256 or --server-ca FILE; `pqsec enrol` keeps it in server.json",
    )
