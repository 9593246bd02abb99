"""The server's log: each event, of both processes, is a line of JSON on stderr."""

import json
import sys
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from pqsec_pki._times import rfc3339

Log = Callable[[Mapping[str, object]], None]


def log(event: Mapping[str, object]) -> None:
    """Write the event, with the time; it has no secret, no token and no request's content."""
    at = rfc3339(datetime.now(UTC), timespec="milliseconds")
    sys.stderr.write(f"{json.dumps({'at': at, **event})}\n")
