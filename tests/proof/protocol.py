"""The part of the model that is made from the code: names, orders, suites and sizes.

A change of the protocol changes this text, so the recorded results are no longer those of the
model, and test_proof.py fails until the proof is run again.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import fields

from pqsec_pki.algorithms import KEY_AGREEMENTS, Family, KeyAgreement
from pqsec_pki.handshake import (
    CHALLENGE_SIZE,
    HASH_SIZE,
    AuthRequest,
    Final,
    Introduction,
    Reply,
    Request,
    Transcript,
    WireVersion,
    compact,
)

KINDS = {Family.CLASSICAL: "DH", Family.PQ: "KEM", Family.HYBRID: "HYBRID"}
"""A suite of the model stands for all key agreements of a family."""
SIX = ("hash_c1", "hash_c2", "challenge1", "challenge2", "dh1", "dh2")
LABELS = ("keyexchange salt", "key exchange key")
"""Of the key of the key exchange: the first is between challenge1 and challenge2, the second is
between challenge2 and challenge1."""
_MESSAGES = {"request": Request, "reply": Reply, "final": Final}
_SECOND = {
    "ver": "version_2",
    "id": "(c_id, c_perm)",
    "pd": "c_pdata",
    "alg": "(c_dsign_algo, c_kagree_algo)",
    "ch1": "challenge1",
    "ch2": "challenge2",
    "sig": "signature",
}
"""What the names of the second version hold; the others mean what they mean in the first."""
_READ = {
    "request": ("dh1", "challenge1", "hash_c1"),
    "reply": ("dh2", "challenge2", "signature", ("challenge1", "dh1", "hash_c2", "hash_c1")),
    "final": ("signature", ("challenge1", "challenge2", "dh1", "dh2", "hash_c2", "hash_c1")),
}
"""What a receiver takes from a message; in parentheses what only the first version repeats."""


def in_signature(covered: bytes) -> list[str]:
    """The names of the values that a signature covers, in order."""
    return [name.decode() for name in re.findall(rb"<(\w+)>", covered)]


def of_kind(kind: str) -> list[KeyAgreement]:
    """The key agreements that a suite of the model stands for."""
    return [row for row in KEY_AGREEMENTS if KINDS[row.family] == kind]


def wire(words: frozenset[str], versions: Iterable[int]) -> str:
    """The text; `words` are the conditions of the scenario."""
    probe = Transcript(**{name: b"<%s>" % name.encode() for name in SIX})
    readable = sorted(versions) if "C28" in words else [1, 2]
    return "\n".join(
        [
            "(* Made from the code by tests/proof/protocol.py. *)",
            *_constants(),
            *_suites(words),
            *_octets("reply_octets", in_signature(probe.reply_octets()), words),
            *_octets("final_octets", in_signature(probe.final_octets()), words),
            *(line for version in (1, 2) for line in _hash(version)),
            *(line for version in (1, 2) for line in _writers(version)),
            _hash_of(readable),
            *(_reader(kind, readable, words) for kind in _MESSAGES),
            *_keys(words),
        ]
    )


def _plain(name: str) -> str:
    return name.replace(".", "_")


def _arguments(names: Iterable[str]) -> str:
    return ", ".join(f"{name}: bitstring" for name in names)


def _constants() -> Iterator[str]:
    kinds = [*_MESSAGES.values(), AuthRequest]
    yield f"(* Challenges have {CHALLENGE_SIZE} octets, hashes {HASH_SIZE}. *)"
    for kind in kinds:
        yield f"const {kind.__name__}: bitstring [data].   (* {kind.CLASS_ID} *)"
    marked = [name for name, _ in WireVersion.SECOND.mark]
    properties = [_plain(name) for name in (*Introduction.NAMES, *SIX, *marked)]
    yield f"const {', '.join(f'n_{name}' for name in properties)}: bitstring [data]."
    yield "const version_1, version_2: bitstring [data]."
    yield f"fun transcript({', '.join(['bitstring'] * len(SIX))}): bitstring [data]."
    yield "fun first_message(bitstring, bitstring, bitstring): bitstring [data]."
    yield "   (* destination_participant_guid, message_identity.source_guid, crypto token *)"


def _suites(words: frozenset[str]) -> Iterator[str]:
    for kind in KINDS.values():
        rows = of_kind(kind)
        for row in rows:
            sizes = f"dh1 {row.public_size}, dh2 {row.ciphertext_size}, secret {row.secret_size}"
            yield f"(* {kind}: {row.wire_name}, {sizes} *)"
        (bound,) = {row.binds_transcript for row in rows}
        yield f"const suite_{kind}: bitstring [data]."
        value = "(agreed, sha256(signed))" if bound and "plain" not in words else "agreed"
        yield (
            f"letfun shared_secret_{kind}(agreed: bitstring, signed: bitstring) = sha256({value})."
        )


def _octets(function: str, names: list[str], words: frozenset[str]) -> Iterator[str]:
    """A list of properties that is signed."""
    signed = [name for name in names if not ("unsigned_hashes" in words and "hash" in name)]
    yield f"letfun {function}(t: bitstring) ="
    yield f"  let transcript({_arguments(SIX)}) = t in"
    yield f"  ({', '.join(f'n_{name}, {name}' for name in signed)})."


def _opened(name: str = "introduction") -> str:
    return f"  let ({_arguments(map(_plain, Introduction.NAMES))}) = {name} in"


def _hash(version: int) -> Iterator[str]:
    covered = [f"n_{_plain(name)}, {_plain(name)}" for name in Introduction.NAMES]
    mark = WireVersion(version).mark
    covered += [f"n_{_plain(name)}, version_{version}" for name, _ in mark]
    yield f"letfun hash_{version}(introduction: bitstring) ="
    yield _opened()
    yield f"  sha256(({', '.join(covered)}))."


def _hash_of(readable: list[int]) -> str:
    head = "letfun hash_of(version: bitstring, introduction: bitstring) =\n  "
    if readable == [1, 2]:
        return head + (
            "if version = version_1 then hash_1(introduction)\n  else hash_2(introduction)."
        )
    return f"{head}hash_{readable[0]}(introduction)."


def _fields(kind: str, version: int) -> list[str]:
    """The values of a message, in order."""
    message = _MESSAGES[kind]
    if version == WireVersion.FIRST:
        own = [each.name for each in fields(message)]
        introduced = map(_plain, Introduction.NAMES)
        return [*introduced, *own[1:]] if own[0] == "introduction" else own
    return [_SECOND.get(name, name) for name in compact.names(message.CLASS_ID)]


def _message(kind: str, version: int, tag: str = "") -> str:
    return f"({', '.join([tag or _MESSAGES[kind].__name__, *_fields(kind, version)])})"


def _writers(version: int) -> Iterator[str]:
    six = f"  let transcript({_arguments(SIX)}) = t in"
    values = _arguments(("introduction", "hash_c1", "dh1", "challenge1"))
    yield f"letfun request_{version}({values}) =\n{_opened()}\n  {_message('request', version)}."
    values = _arguments(("introduction", "t", "signature"))
    yield f"letfun reply_{version}({values}) =\n{_opened()}\n{six}\n  {_message('reply', version)}."
    values = _arguments(("t", "signature"))
    yield f"letfun final_{version}({values}) =\n{six}\n  {_message('final', version)}."


def _reader(kind: str, readable: list[int], words: frozenset[str]) -> str:
    """What a receiver reads, in any version that it knows; without C3 from any class id."""
    tag = "" if "C3" in words else "tag"
    rules = []
    for version in readable:
        read = [_read_value(each, version) for each in _READ[kind]]
        if kind != "final":
            read.insert(0, f"({', '.join(map(_plain, Introduction.NAMES))})")
        found = set(re.findall(r"\w+", " ".join(_fields(kind, version)))) - {"version_2"}
        names = sorted({*found, *([tag] if tag else [])})
        left = f"{kind}_of({_message(kind, version, tag)})"
        rules.append(
            f"forall {_arguments(names)};\n  {left}\n    = (version_{version}, {', '.join(read)})"
        )
    return "reduc " + ";\n  ".join(rules) + "."


def _read_value(value: str | tuple[str, ...], version: int) -> str:
    first = version == WireVersion.FIRST
    if isinstance(value, tuple):
        return f"({', '.join(value)})" if first else "absent"
    return "absent" if value == "hash_c1" and not first else value


def _keys(words: frozenset[str]) -> Iterator[str]:
    names = [label.replace(" ", "_") for label in LABELS]
    yield f"const {', '.join(names)}: bitstring [data]."
    yield f"letfun kx({_arguments(('key', 'challenge1', 'challenge2'))}) ="
    orders = ("challenge1, {}, challenge2", "challenge2, {}, challenge1")
    if (
        "C6" not in words
    ):  # as if an attacker could choose challenges that add up to the same octets
        orders = ("{}", "{}")
    parts = [
        f"hmac(sha256(({order.format(name)})), key)"
        for order, name in zip(orders, names, strict=True)
    ]
    yield f"  ({', '.join(parts)})."
