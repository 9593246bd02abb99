"""The files of participants as a bundle has them: verified, and written again."""

from collections.abc import Mapping
from datetime import datetime
from typing import TypeAlias

from pqsec_pki.credentials import KEYS, Credentials, VerifiedCredentials, verify_credentials
from pqsec_pki.enrolment.one_meaning import differences
from pqsec_pki.errors import PassphraseError, UsageError, VerificationError
from pqsec_pki.tokens import is_reference

Enclaves: TypeAlias = Mapping[str, Mapping[str, bytes]]
"""Files by name, for each participant's name."""


def verified_again(
    sets: Mapping[str, Enclaves], now: datetime, *, keys: bool
) -> dict[str, Enclaves]:
    """`sets` with all files written again from the verified values.

    With `keys`, also the private keys, which must match the certificates. VerificationError lists
    everything that is wrong with one participant, or what differs between the sets.
    """
    written, found = dict[str, Enclaves](), dict[str, list[VerifiedCredentials]]()
    for place, enclaves in sets.items():
        private = {name: _private(name, files) if keys else {} for name, files in enclaves.items()}
        found[place] = [
            verify_credentials(
                _credentials(name, {**without_keys(files), **private[name]}), now=now
            )
            for name, files in enclaves.items()
        ]
        written[place] = {each.name: {**each.files, **private[each.name]} for each in found[place]}
    if problems := [*differences(found)]:
        raise VerificationError(*problems, hint="`pqsec check` of the keystore says more")
    return written


def without_keys(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files but private keys."""
    return {file: data for file, data in files.items() if file not in KEYS}


def _credentials(name: str, files: Mapping[str, bytes]) -> Credentials:
    try:
        return Credentials.of(name, files)
    except PassphraseError as error:
        error.hint = (
            "a robot cannot open it: decrypt the key, or let the robot generate its own keys"
        )
        raise


def _private(name: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files of private keys; none if they are in a token, whose URI the robot knows itself."""
    private = {file: data for file, data in files.items() if file in KEYS}
    outside = [file for file, data in private.items() if is_reference(data)]
    if outside and len(outside) < len(private):
        raise UsageError(
            f"{name} has one key in a token and one in a file: a bundle can bring neither",
            hint="request it on its robot: `pqsec request --participant-key-uri`",
        )
    return {} if outside else private
