"""A first configuration: `serve.yaml`, with a key and a certificate for TLS beside it."""

import os
from datetime import datetime, timedelta
from pathlib import Path
from string import Template
from urllib.parse import urlsplit

from pqsec_pki._assets import asset
from pqsec_pki._files import refuse_existing, write
from pqsec_pki.algorithms import DEFAULT_PROFILE, private_key_pem
from pqsec_pki.certificates import Authority
from pqsec_pki.errors import UsageError
from pqsec_pki.est import checked_url
from pqsec_pki.keystore import GITIGNORE, secrets_ignored

_PAIRS = {
    "tls-pq": DEFAULT_PROFILE.alternative_key,
    "tls-classical": DEFAULT_PROFILE.participant_key,
}
"""Robots with pqsec take either; stock clients without ML-DSA take the second."""
_VALIDITY = timedelta(days=3650)
"""Robots know the server by its key, whose certificate is therefore not exchanged often."""
_PORT = 443
_NAME = "pqsec serve"
_LOOPBACK = {"127.0.0.1", "localhost"}
"""Hosts of a server that only this machine reaches."""


def begin_server(url: str, config: Path, keystore: Path, *, now: datetime) -> list[Path]:
    """Write a configuration for the server with that URL; returns the files.

    A `.gitignore` beside them, which may be there, keeps keys and tokens out of git.

    ExistsError if one of them exists; UsageError for an invalid URL.
    """
    parts = urlsplit(checked_url(url))
    host, port = parts.hostname or "", parts.port or _PORT
    if config.suffix not in {".yaml", ".yml"}:
        raise UsageError("the configuration is YAML: name a file as serve.yaml")
    names = [f"{each}.{end}" for each in _PAIRS for end in ("pem", "key")]
    goals = [config, *(config.parent / each for each in names)]
    for goal in goals:
        refuse_existing(goal, replaceable=False)
    for each, algorithm in _PAIRS.items():
        if algorithm:
            key = algorithm.generate()
            made = Authority.self_signed(_NAME, key, host=host, now=now, validity=_VALIDITY)
            write(config.parent / f"{each}.key", private_key_pem(key), private=True)
            write(config.parent / f"{each}.pem", made.certificate.pem)
    address = "127.0.0.1" if host in _LOOPBACK else "0.0.0.0"  # noqa: S104 -- a server's purpose
    template = Template(asset("templates", "serve.yaml").read_text("utf-8"))
    place = os.path.relpath(keystore, config.parent)
    text = template.substitute(url=checked_url(url), address=address, port=port, keystore=place)
    ignored = secrets_ignored(config.parent, "/state/")
    write(config.parent / GITIGNORE, ignored, force=True)
    write(config, text.encode())
    return goals
