"""What must stay secret does: keys, passphrases, and what a handshake ends with.

All that commands print, and all they write for others to read, is searched for every
private key that there was at any time, as raw octets, in hexadecimal and in base64.
"""

import re
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from pqsec_pki.algorithms import (
    KEY_AGREEMENTS,
    KeyAgreement,
    load_private_key,
    private_key_pem,
)
from pqsec_pki.algorithms.keys import is_encrypted
from pqsec_pki.errors import PassphraseError
from tests.cli.conftest import secret
from tests.longer import some

WIDTH, STRIDE = 16, 8
"""Octets of a piece of a secret, and from one to the next: no leak of 23 goes between them."""
PEM = re.compile(rb"-----BEGIN ([A-Z ]+)-----\r?\n(.*?)-----END", re.DOTALL)


def pieces(data: bytes) -> list[bytes]:
    return [data[at : at + WIDTH] for at in range(0, len(data) - WIDTH + 1, STRIDE)]


def written(piece: bytes) -> Iterator[bytes]:
    """The piece in the ways in which it could be written; base64 of it may begin at any octet."""
    yield piece
    yield piece.hex().encode()
    yield piece.hex().upper().encode()
    for shift in range(3):
        yield b64encode(bytes(shift) + piece)[-(-shift * 4 // 3) + (shift > 0) : -4]


def leaks(haystack: bytes, secrets: Iterable[bytes]) -> list[str]:
    """The pieces that are in it, also where white space parts them."""
    dense = re.sub(rb"\s", b"", haystack)
    return [
        piece.hex()
        for piece in secrets
        if piece in haystack or any(form in dense for form in written(piece))
    ]


@pytest.mark.parametrize("form", range(6))
@pytest.mark.parametrize("before", range(3))
def test_the_search_finds_what_is_there(form, before):
    """Each form, wherever in a longer text the secret begins."""
    key = bytes(range(100, 164))
    text = bytes(before) + key + b"tail"
    forms = [text, text.hex(), text.hex().upper(), b64encode(text), b64encode(text), key.hex(" ")]
    found = forms[form]
    found = found.encode() if isinstance(found, str) else found
    if form == 4:
        found = b"\n".join(found[at : at + 30] for at in range(0, len(found), 30))
    assert leaks(b"prefix" + found, pieces(key)[:1])
    assert not leaks(b"prefix" + found, pieces(bytes(64)))


# The handshake


@pytest.fixture
def handshake_secrets(monkeypatch) -> dict[str, list[bytes]]:
    """What every key agreement makes while the test runs, told where it is made."""
    found: dict[str, list[bytes]] = {"private": [], "secret": [], "SharedSecret": []}

    def spied(name: str, note: Callable[[object], None]) -> None:
        inner = getattr(KeyAgreement, name)

        def spy(self, *arguments):
            result = inner(self, *arguments)
            note((arguments, result))
            return result

        monkeypatch.setattr(KeyAgreement, name, spy)

    spied("key_pair", lambda made: found["private"].extend(private_octets(made[0][0])))
    spied("encapsulate", lambda made: found["secret"].append(made[1][1]))
    spied("decapsulate", lambda made: found["secret"].append(made[1]))
    spied("shared_secret", lambda made: found["SharedSecret"].append(made[1]))
    return found


def private_octets(handle) -> list[bytes]:
    """The private number or seed of an ephemeral key, however its library calls it."""
    if isinstance(handle, tuple):  # two halves, which are seen when each is made
        return []
    if hasattr(handle, "private_bytes_raw"):
        return [handle.private_bytes_raw()]
    number = getattr(handle, "exponent", None) or handle.private_numbers().private_value
    return [number.to_bytes((number.bit_length() + 7) // 8)]


@pytest.mark.parametrize("options", ["", "--json", "--insecure-show-secrets"])
@pytest.mark.parametrize("kem", [row.name for row in KEY_AGREEMENTS])
def test_a_trace_has_no_secret_of_the_handshake(pqsec, keystore, handshake_secrets, kem, options):
    """Nor has it with --insecure-show-secrets what only one side knows."""
    trace = keystore("transition").with_name("t")
    said = pqsec(f"-k k verify-handshake /talker /listener --kem {kem} --trace t {options}").done()
    told = (said.out + said.err).encode() + trace.read_bytes()
    assert len(handshake_secrets["private"]) >= 1
    assert len(set(handshake_secrets["SharedSecret"])) == 1
    for kind, values in handshake_secrets.items():
        found = leaks(told, [piece for value in values for piece in pieces(value)])
        assert bool(found) == (kind == "SharedSecret" and "insecure" in options), kind


# A life of commands

PASSPHRASE, NEXT = "correct horse battery", "staple in the meadow"
SESSION = """
-k k ca init --name Robots --passphrase-file first --profile {profile}
-k k issue /talker /listener /gone --publish rt/chatter --passphrase-file first
-k k ca show
-k k ca show --json
request /fleet/robot --profile {profile} --dir robot --json
bundle-key --dir robot
sign-request export robot/requests/fleet+robot/request.csr --publish t -o asked --json
-k k sign-request sign asked --show --json
-k k sign-request sign asked -o answer --passphrase-file first
sign-request import answer --request asked --bundles bundles
-k k bundle /talker --seal-for robot/bundle.pub.pem -o sealed --json
-k k bundle /talker --no-keys -o without-keys --json
install bundles/fleet+robot.bundle --dir robot --trust-first --json
-k k renew --all --rekey --passphrase-file first --json
-k k revoke /gone --yes --reason keyCompromise --passphrase-file first
-k k ca crl --passphrase-file first -o list.pem
-k k ca passphrase --passphrase-file first --new-passphrase-file second
-k k ca rotate
-k k ca rotate --apply --yes --passphrase-file second --json
-k k status --prometheus metrics --json
-k k log
-k k log --json
-k k log --verify --json
-k k verify-handshake /talker /listener
-k k verify-handshake --all --json
-k k verify-handshake /talker /listener --trace t
-k k verify-handshake /talker /listener --trace - --json
-k k verify-handshake /talker /listener --attack all
-k k check --json
-k k check --sarif
check k/private k/enclaves/talker --json
inspect k/private/identity_ca.key.pem k/enclaves/talker/key.pem k/enclaves/talker/cert.pem
inspect --json k/private/identity_ca.key.pem k/enclaves/talker/key.pem robot/bundle.key.pem
-k k export cyclonedds /talker -o cyclone --anyway
-k k export fastdds /talker --anyway
-k k export opendds /talker --json --anyway
-k k export connext /talker --anyway
-k k export ros2 /talker -o ros2 --anyway
-k k try ros2 /talker --dry-run
-k k who-may --format json
-k k explain --participant /talker --publish rt/chatter --json
-k k issue /talker
-k k issue /late --publish t --passphrase-file first
-k k issue /late --publish t --passphrase-file k/enclaves/talker/key.pem
-k k ca passphrase --passphrase-file k/private/identity_ca.key.pem --new-passphrase-file second
verify k/private/identity_ca.key.pem --ca k/enclaves/talker/key.pem
validate k/enclaves/talker/key.pem
-k new plan k/enclaves/talker/key.pem
-k new plan second
issue -k k /late --policy k/enclaves/talker/key.pem --passphrase-file second
permissions render k/enclaves/talker/key.pem
permissions import k/enclaves/talker/key.pem
permissions learn k/enclaves/talker/key.pem
governance read second
issue -k k /late --csr k/enclaves/talker/key.pem --passphrase-file second
install k/enclaves/talker/key.pem --dir robot
bundle -k k --robot k/enclaves/talker/key.pem --no-keys -o never
-k k bundle /talker --seal-for robot/bundle.key.pem -o never
diff k/enclaves/talker/key.pem k/enclaves/listener/key.pem
explain-error -- "-----BEGIN"
"""
OWN = re.compile(r".*key\.pem|first|second|ledger\.sqlite3.*")
"""What is there to hold a secret, or (the ledger) is for its owner only."""


def key_octets(data: bytes) -> bytes:
    """The octets of a private key, decrypted, as they are in its file."""
    for passphrase in (PASSPHRASE, NEXT):
        if is_encrypted(data):
            with suppress(PassphraseError):
                data = private_key_pem(load_private_key(data, passphrase.encode()))
    [(label, body)] = PEM.findall(data)
    assert label.endswith(b"PRIVATE KEY")
    assert not label.startswith(b"ENCRYPTED")
    return b64decode(body)


def public_octets(folder: Path) -> list[bytes]:
    """All that certificates and requests below hold: also in private keys, and no secret."""
    files = [each for end in ("cert.pem", "csr", "pub.pem") for each in folder.rglob(f"*{end}")]
    return [b64decode(body) for path in files for _, body in PEM.findall(path.read_bytes())]


def for_others(folder: Path) -> Iterator[bytes]:
    """What is in files that are not there to hold secrets."""
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink() and not OWN.fullmatch(path.name):
            yield path.read_bytes()


@pytest.mark.parametrize("profile", some(["transition", "hybrid"]))
def test_no_command_tells_a_key_or_a_passphrase(run_in, tmp_path, profile):
    secret(tmp_path / "first", PASSPHRASE + "\n")
    secret(tmp_path / "second", NEXT + "\n")
    keys, public, said, codes = dict[bytes, bytes](), set[bytes](), [], Counter[int]()
    for line in SESSION.format(profile=profile).strip().splitlines():
        result = run_in(tmp_path, line)
        codes[result.code] += 1
        said.append((line, (result.out + result.err).encode()))
        files = {path.read_bytes() for path in tmp_path.rglob("*key.pem")}
        keys |= {data: key_octets(data) for data in files - set(keys)}
        public |= set(public_octets(tmp_path))
    assert codes[0] >= 35, [(line, text) for line, text in said]
    in_how_many = Counter(piece for key in set(keys.values()) for piece in set(pieces(key)))
    alone = [piece for piece, times in in_how_many.items() if times == 1]
    known = b"".join(public)
    secrets = [piece for piece in alone if piece not in known]
    assert len(secrets) > 4 * len(keys) > 40
    words = [each.encode() for each in (PASSPHRASE, NEXT)]
    told = [*said, *(("a file", data) for data in for_others(tmp_path))]
    assert [(line, word) for line, text in told for word in words if word in text] == []
    everything = b"\n".join(text for _, text in told)
    assert leaks(everything, secrets) == []
