"""Signs a file with the permissions CA of PQSEC_KEYSTORE: FILE.p7s, for `pqsec verify`."""

import os
import sys
from datetime import UTC, datetime
from pathlib import Path

from pqsec_pki.keystore import Keystore, SigningCa
from pqsec_pki.report import signature_path, statement_of

path = Path(sys.argv[1])
secret = os.environ.get("PQSEC_PASSPHRASE_FILE")
passphrase = Path(secret).read_bytes().splitlines()[0] if secret else None
keystore = Keystore.open(Path(os.environ["PQSEC_KEYSTORE"]))
authorities = keystore.unlock(passphrase, cas=(SigningCa.PERMISSIONS,))
statement = statement_of(path, path.read_bytes())
now = datetime.now(UTC)
signature_path(path).write_bytes(authorities.sign(statement, now=now, embed_certificate=True))
