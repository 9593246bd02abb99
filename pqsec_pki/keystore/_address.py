"""The address of a ledger in PostgreSQL, which the settings of a keystore keep.

It names no secret: passwords are where libpq looks for them (a password file, or a service file),
and all who may read the keystore can read its settings.
"""

import os
import re
from typing import Self
from urllib.parse import parse_qsl

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError, shown

_URL = re.compile(
    r"postgres(?:ql)?://(?:(?P<user>[^\s:@/?#]+)(?P<password>:[^\s@/?#]*)?@)?"
    r"(?P<hosts>[^\s@/?#]*)(?:/(?P<database>[^\s@/?#]*))?(?:\?(?P<query>[^\s#]*))?"
)
_TAKEN = frozenset((
    *("service", "host", "port", "dbname", "user", "passfile", "connect_timeout"),
    *("sslmode", "sslrootcert", "sslcert", "sslkey", "sslcrl", "sslcrldir", "sslnegotiation"),
    *("ssl_min_protocol_version", "channel_binding", "require_auth", "gssencmode", "krbsrvname"),
))  # fmt: skip
_SECRET = frozenset({"password", "sslpassword", "scram_client_key", "scram_server_key"})
_LOCAL = re.compile(r"(localhost|127\.[0-9.]+|\[::1\]|/.*|%2[Ff].*)?(:[0-9]*)?")
_HINT = (
    "postgresql://USER@HOST/DATABASE; the password is in a password file (PGPASSFILE) or service"
    " file: docs/how-to/postgresql.md"
)


@dataclass(frozen=True, slots=True)
class LedgerAddress:
    """A URL of PostgreSQL without a secret."""

    url: str

    @classmethod
    def parse(cls, text: str) -> Self:
        """UsageError for a URL that is of something else, or has a password or an unknown part."""
        found = _URL.fullmatch(text)
        if found is None:
            word = "the ledger's address is not a URL of PostgreSQL"
            raise UsageError(word, hint=f"write {_HINT}")
        given = _parameters(found["query"])
        if found["password"] or _SECRET & given.keys():
            raise UsageError("the ledger's address must not have a password", hint=f"write {_HINT}")
        if unknown := sorted(given.keys() - _TAKEN):
            raise UsageError(
                f"the ledger's address has an unknown part: {shown(unknown[0])}",
                hint=f"known are: {', '.join(sorted(_TAKEN))}",
            )
        return cls(text)

    @property
    def place(self) -> str:
        """The address for messages: user, host and database."""
        return shown(self.url.partition("?")[0], limit=200)

    @property
    def parameters(self) -> dict[str, str]:
        """The parameters of its query."""
        return _parameters(self.url.partition("?")[2])

    @property
    def is_local(self) -> bool:
        """Whether all its hosts are this machine, or neither it nor the environment names one."""
        found = _URL.fullmatch(self.url)
        hosts = self.parameters.get("host", found["hosts"] if found else "")
        hosts = hosts or os.environ.get("PGHOST", "")
        return all(_LOCAL.fullmatch(each) for each in hosts.split(","))


def _parameters(query: str | None) -> dict[str, str]:
    return dict(parse_qsl(query or "", keep_blank_values=True))
