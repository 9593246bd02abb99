"""The configuration of the server: `serve.yaml`.

    url: https://enrol.example:8443
    keystore: robots
    domain: domain.yaml
    tls: [{chain: server.pem, key: server.key}]

Paths are relative to its folder. Errors name the file and the line.
"""

import re
from collections.abc import Mapping
from dataclasses import field, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read as read_file
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    boolean,
    build,
    chosen,
    duration,
    each,
    fields,
    number,
    one_or_more,
    read,
    refused,
    table,
    text,
)
from pqsec_pki.domain import FACTORY
from pqsec_pki.errors import MissingError, located, shown
from pqsec_pki.est import checked_url
from pqsec_pki.keystore import Keystore, SharedRequests
from pqsec_pki.server.addresses import Network, network
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from pqsec_pki.server.waiting_rows import RequestRows

_ADDRESS = re.compile(r"(\[[0-9a-fA-F:]+\]|[0-9a-zA-Z.-]+):([0-9]{1,5})")
_LAST_PORT = 65535


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """The certificate of the server with its CAs, and its key."""

    chain: Path
    key: Path


@dataclass(frozen=True, slots=True)
class FactoryFiles:
    """The CAs of a factory, and their revocation lists."""

    cas: Path
    lists: tuple[Path, ...] = ()
    again: bool = False
    """Whether a device may enrol again, which replaces its certificate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerLimits:
    """Limits for clients that have not yet authenticated."""

    connections: int = 2000
    """At once, of all clients."""
    connections_of_address: int = 50
    """At once, from one address."""
    requests_of_address: int = 300
    """In a minute, from one address."""
    requests_of_label: int = 6000
    """In a minute, for one label, from addresses that no known robot has used."""
    seconds: int = 15
    """For the TLS handshake and a whole request: from the first octet to the last."""
    body: int = 64 << 10
    """Octets of a request; of a receipt 16 times as many."""
    buffered: int = 32 << 20
    """Octets of all requests that are not complete."""
    waiting: int = 500
    """Requests that wait until somebody decides."""

    @property
    def of_status(self) -> "ServerLimits":
        """Those of the status address: the same, but ten times as many requests of an address.

        All checks of one machine come from one; they go on where robots may ask rarely.
        """
        most = 10 * max(self.requests_of_address, ServerLimits().requests_of_address)
        return replace(self, requests_of_address=most)


@dataclass(frozen=True, slots=True, kw_only=True)
class EnrolmentPolicy:
    """Who gets a certificate over the network, and when."""

    approval: bool = False
    """Whether requests without a credential wait until somebody decides."""
    retry_seconds: int = 60
    """Until a robot whose request waits asks again."""
    renew_any_time: bool = False
    """Whether to renew certificates that are not due."""
    renew_expired: timedelta = timedelta()
    """For how long after its end a certificate is still renewed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerSettings:
    """The content of `serve.yaml`."""

    path: Path
    url: str
    listen: tuple[tuple[str, int], ...] = (("127.0.0.1", 8443),)
    proxy_from: tuple[Network, ...] = ()
    """Balancers: only their connections begin with a PROXY header, which has the client's
    address."""
    status: tuple[str, int] | None = None
    """Where health and metrics are served, without TLS: an address of this machine."""
    keystore: Path
    domain: Path
    state: Path
    """The folder of the signer's socket."""
    requests: Path | None = None
    """The folder of requests that wait, if the ledger is in a file; None for one in `state`."""
    tls: tuple[TlsFiles, ...]
    classical: bool = False
    """Whether clients without post-quantum key agreement, and with TLS 1.2, may connect."""
    passphrase_file: Path | None = None
    front_user: str = ""
    """The user of the process that faces the network; empty for the signer's own."""
    factories: Mapping[str, FactoryFiles] = field(default_factory=dict)
    """By the names that the domain file has."""
    policy: EnrolmentPolicy = EnrolmentPolicy()
    token_validity: timedelta = timedelta(days=7)
    revocation_list: timedelta | None = None
    """How long the revocation lists are valid that the server issues by itself; None for none."""
    limits: ServerLimits = ServerLimits()

    @property
    def socket(self) -> Path:
        """Where the signer listens."""
        return self.state / "signer.sock"

    @property
    def notices(self) -> Path:
        """The socket at which the front, started by the signer, reports that it listens."""
        return self.state / "front.sock"

    def waiting(self, keystore: Keystore) -> WaitingRequests:
        """The requests that wait, at all servers with the ledger of that keystore if it is shared.

        With a ledger in a file they are in a folder, of this server alone unless one is named.
        """
        if keystore.ledger_address:
            return WaitingRequests(RequestRows(SharedRequests(keystore.root)), self.limits.waiting)
        folder = self.requests or self.state / "waiting"
        return WaitingRequests(RequestFolder(folder), self.limits.waiting)


def read_settings(path: Path) -> ServerSettings:
    """Read `serve.yaml`. InvalidDocumentError with all its problems; FileError if unreadable."""
    try:
        data = read_file(path)
    except MissingError as error:
        named = f"--config {quote(str(path))}"
        error.hint = f"name it with --config FILE, or write one: `pqsec serve {named} --init URL`"
        raise
    with located(path):
        found = read(data, partial(_settings, path.parent))
    return ServerSettings(path=path, **found)


def _settings(folder: Path, item: Item) -> dict[str, Any]:
    file = partial(_path, folder)
    readers: Readers = {
        "url": _url,
        "listen": partial(one_or_more, reader=_address),
        "proxy_from": partial(one_or_more, reader=_network),
        "status": _address,
        "keystore": file,
        "domain": file,
        "state": file,
        "requests": file,
        "tls": partial(each, reader=partial(_tls, folder)),
        "classical": boolean,
        "passphrase_file": file,
        "front_user": text,
        "factories": partial(_factories, folder),
        "approval": boolean,
        "retry_seconds": _positive,
        "renew_expired": duration,
        "renew": partial(chosen, names=("due", "any-time")),
        "token_validity": duration,
        "revocation_list": duration,
        "limits": _limits,
    }
    found = fields(item, readers, required=("url", "keystore", "domain", "tls"))
    if not found["tls"]:
        raise refused(item, "tls: no certificate is named")
    found["renew_any_time"] = found.pop("renew", "due") == "any-time"
    names = EnrolmentPolicy.__dataclass_fields__.keys() & found.keys()
    policy = EnrolmentPolicy(**{each: found.pop(each) for each in names})
    return {"state": folder / "state", "policy": policy, **found}


def _limits(item: Item) -> ServerLimits:
    names = ServerLimits.__dataclass_fields__
    return ServerLimits(**fields(item, dict.fromkeys(names, _positive)))


def _tls(folder: Path, item: Item) -> TlsFiles:
    file = partial(_path, folder)
    found = fields(item, {"chain": file, "key": file}, required=("chain", "key"))
    return TlsFiles(**found)


def _factories(folder: Path, item: Item) -> dict[str, FactoryFiles]:
    found = table(item)
    for key, _ in found.entries.values():
        if not FACTORY.fullmatch(key.text):
            raise refused(key, f"'{shown(key.text)}' cannot be the name of a factory")
    return fields(found, dict.fromkeys(found.entries, partial(_factory, folder)))


def _factory(folder: Path, item: Item) -> FactoryFiles:
    file = partial(_path, folder)
    readers: Readers = {
        "cas": file,
        "revocation_lists": partial(one_or_more, reader=file),
        "again": boolean,
    }
    found = fields(item, readers, required=("cas",))
    return FactoryFiles(found["cas"], found.get("revocation_lists", ()), found.get("again", False))


def _path(folder: Path, item: Item) -> Path:
    return folder / text(item)


def _positive(item: Item) -> int:
    found = number(item)
    if not found:
        raise refused(item, "0 is not allowed: write 1 or more")
    return found


def _url(item: Item) -> str:
    """The server's URL as robots use it: https, a host, perhaps a port, no path."""
    return build(item, lambda: checked_url(text(item)))


def _address(item: Item) -> tuple[str, int]:
    found = _ADDRESS.fullmatch(text(item))
    if not found or not 0 < int(found[2]) <= _LAST_PORT:
        raise refused(item, "write ADDRESS:PORT, as 127.0.0.1:8443 or [::1]:8443")
    return found[1].strip("[]"), int(found[2])


def _network(item: Item) -> Network:
    try:
        return network(text(item))
    except ValueError:
        words = "write the address or the network of a balancer, as 192.0.2.10 or 2001:db8::/64"
        raise refused(item, words) from None
