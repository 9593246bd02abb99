"""The server: robots enrol and renew over a network (EST, RFC 7030, and requests for bundles).

Two processes, which `running.py` starts by `serve.yaml` (`configuration.py`; `beginning.py` writes
a first one). The front answers HTTP: `listening.py`, `balancing.py` and `proxy_header.py` for
clients of balancers, `channel.py`, `front.py`, `reading.py`, `routes.py`, `limiting.py`,
`addresses.py`, `asking.py`, `sending.py` and `metrics.py`. The signer (`signer.py`) has the CA
keys: it decides who is admitted (`admission.py`, `requester.py`, `token_lines.py`; `waiting.py`,
`waiting_folder.py`, `waiting_rows.py` and `deciding.py` for requests that wait; `factories.py` for
devices with a certificate of their factory) and answers from the keystore (`call_handling.py`);
`list_keeping.py` keeps a revocation list in force, `receipt_taking.py` takes receipts.
Between them are calls (`call.py`).
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.server.beginning import begin_server
    from pqsec_pki.server.configuration import ServerSettings, read_settings
    from pqsec_pki.server.deciding import (
        APPROVAL,
        REFUSAL,
        decide,
        demanded,
        end_of,
        open_approvals,
        replacing,
    )
    from pqsec_pki.server.listening import run_front
    from pqsec_pki.server.running import run_both, run_signer
    from pqsec_pki.server.token_lines import (
        TokenState,
        record_token,
        revoke_tokens,
        token_states,
    )
    from pqsec_pki.server.waiting import WaitingRequest
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "APPROVAL",
    "REFUSAL",
    "ServerSettings",
    "TokenState",
    "WaitingRequest",
    "begin_server",
    "decide",
    "demanded",
    "end_of",
    "open_approvals",
    "read_settings",
    "record_token",
    "replacing",
    "revoke_tokens",
    "run_both",
    "run_front",
    "run_signer",
    "token_states",
]
