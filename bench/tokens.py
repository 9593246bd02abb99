"""Issuing from CAs whose keys are in a token, against the token's own signing speed.

Makes a token of SoftHSM in a new folder. Run, with SoftHSM and OpenSC installed:

    python bench/tokens.py [PARTICIPANTS]
"""

import hashlib
import os
import sys
import tempfile
import time
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pkcs11

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has the other side

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.tokens import made_keys
from tests.interop.tokens import PIN, Token

KEYS = {"identity_ca.key.pem": "identity-ca", "permissions_ca.key.pem": "permissions-ca"}
SIGNATURES = 2
"""For each participant: the certificate and the permissions."""


@contextmanager
def timed(what, found):
    begin, cpu = time.perf_counter(), time.process_time()
    yield
    found[what] = time.process_time() - cpu
    print(f"{what:<32} {found[what]:6.2f} s of CPU, {time.perf_counter() - begin:6.2f} s")


def keystore_on(folder, now):
    profile = profile_named("classical")
    uris = {
        name: (f"pkcs11:token=lab;object={label}", profile.identity_key)
        for name, label in KEYS.items()
    }
    with made_keys(uris, lambda _: PIN) as made:
        return Keystore.create(
            folder,
            profile,
            name="Bench",
            domains=DomainSet.parse("0"),
            validity=timedelta(days=3650),
            passphrase=None,
            keys=made.keys,
            now=now,
        )


def main():
    count, now, found = int(sys.argv[1]) if len(sys.argv) > 1 else 1000, datetime.now(UTC), {}
    with tempfile.TemporaryDirectory() as folder:
        token = Token.softhsm(Path(folder))
        os.environ |= {**token.environment, "PQSEC_PKCS11_MODULE": str(token.module)}
        keystore = keystore_on(Path(folder) / "k", now)
        authorities = keystore.unlock(None, lambda _: PIN)
        specs = [
            ParticipantSpec(
                name=f"/r{number}",
                publish=("x",),
                domains=DomainSet.parse("0"),
                validity=timedelta(days=90),
            )
            for number in range(count)
        ]
        session = authorities.identity.key.handle.login.session
        private = session.get_key(
            object_class=pkcs11.ObjectClass.PRIVATE_KEY, label=KEYS["identity_ca.key.pem"]
        )
        digest = hashlib.sha256(b"x").digest()
        with timed(f"{count * SIGNATURES} signatures of the token", found):
            for _ in range(count * SIGNATURES):
                private.sign(digest, mechanism=pkcs11.Mechanism.ECDSA)
        with timed(f"{count} participants issued", found):
            issue(keystore, authorities, specs, now=now)
    raw, whole = found.values()
    print(f"pqsec's own work: {1000 * (whole - raw) / count:.1f} ms of CPU for each participant,")
    print(f"{whole / raw:.0f} x that of a token without a cable or a chip")


if __name__ == "__main__":
    main()
