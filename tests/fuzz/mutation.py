"""Spoiling messages where it hurts: in one field, at a length, inside PEM, DER or a list.

Blind changes of a signed message end at the first hash. These keep the rest of it whole.
All choices are `rng`'s; `spoil` changes plain bytes, and is libFuzzer's or `blindly`.
"""

import struct
from contextlib import suppress
from dataclasses import replace

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, pem, unpem
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import ByteOrder, DataHolder, Final, GenericMessage, Reply, Request
from tests.interop.der import Der

NUMBERS = (0, 1, 4, 16, 64, 65, 255, 1 << 16, 1 << 18, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
PARAMETERS = (0x0000, 0x0001, 0x0050, 0x4050, 0x8050, 0x1001, 0x7FFF)
"""PIDs: padding, sentinel, the participant's GUID as it is and with flags, and others."""
NAMES = [
    row.wire_name.encode() + end for row in (*SIGNATURES, *KEY_AGREEMENTS) for end in (b"", b"\0")
]
BIT_STRING = 3
TAGS = [
    1,
    2,
    BIT_STRING,
    4,
    5,
    6,
    10,
    12,
    19,
    20,
    22,
    23,
    24,
    28,
    30,
    0x30,
    0x31,
    0x80,
    0x82,
    0xA0,
    0xA3,
]
"""Of DER: what X.509, CMS and PKCS#8 are made of."""
CLASSES = [kind.CLASS_ID for kind in (Request, Reply, Final)]
PROPERTIES = [
    *("c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo", "c.other", "dh1", "dh2"),
    *("hash_c1", "hash_c2", "challenge1", "challenge2", "signature", "dds.cert.sn", ""),
]


def blindly(rng):
    """A `spoil` that needs no fuzzer: one flip, number, cut, insertion or repetition."""

    def spoil(data):
        at, size = rng.randint(0, len(data)), rng.randint(1, 40)
        head, tail = data[:at], data[at:]
        match rng.choice(["flip", "number", "cut", "insert", "delete", "repeat"]):
            case "flip" if tail:
                return head + bytes([tail[0] ^ 1 << rng.randint(0, 7)]) + tail[1:]
            case "number":
                return head + struct.pack(">I", rng.choice(NUMBERS)) + tail[4:]
            case "cut":
                return head
            case "insert":
                return head + rng.randbytes(size) + tail
            case "delete":
                return head + tail[size:]
        return head + tail[:size] * rng.choice([2, 3, 70]) + tail[size:]

    return spoil


def plain(data, rng, spoil):
    """Bytes of no form known here."""
    del rng
    return spoil(data)


def token(data, rng, spoil):
    """A data holder in big-endian CDR; what cannot be read as one is only spoilt."""
    try:
        holder = DataHolder.decode(data)
    except PqsecError:
        return spoil(data)
    return _at_a_length(_changed(holder, rng, spoil).encode(), rng)


def message(data, rng, spoil):
    """The sample of a generic message, in either byte order."""
    try:
        found = GenericMessage.decode(data)
    except PqsecError:
        return spoil(data)
    tokens = [_changed(each, rng, spoil) for each in found.tokens]
    if rng.randint(0, 4) == 0:
        tokens *= rng.choice([0, 2, 9])
    data = replace(found, tokens=tuple(tokens)).encode(rng.choice(list(ByteOrder)))
    return _at_a_length(data, rng)


def parameters(data, rng, spoil):
    """c.pdata: a parameter list with one parameter changed, added, or of another size."""
    found, at = [], 0
    while at + 4 <= len(data):
        kind, size = struct.unpack_from(">HH", data, at)
        found.append((kind, size, data[at + 4 : at + 4 + size]))
        at += 4 + size
    if not found:
        return spoil(data)
    index = rng.randrange(len(found))
    kind, size, value = found[index]
    match rng.choice(["kind", "size", "value", "insert", "double"]):
        case "kind":
            found[index] = rng.choice(PARAMETERS), size, value
        case "size":
            found[index] = kind, rng.choice([0, 1, 3, 15, 17, 0x7FFF, 0xFFFF]), value
        case "value":
            value = spoil(value)[:0xFFFF]
            found[index] = kind, len(value), value
        case "insert":
            found.insert(index, (rng.choice(PARAMETERS), 3, b"abc"))
        case "double":
            found.insert(index, found[index])
    return b"".join(struct.pack(">HH", kind, size) + value for kind, size, value in found)


def in_pem(data, rng, spoil):
    """PEM or DER with one value spoilt, or the text of PEM."""
    with suppress(PqsecError):
        if blocks := unpem(data, ""):
            label, inner = rng.choice(blocks)
            return rng.choice([spoil(data), pem(label, der(inner, rng, spoil))])
    return der(data, rng, spoil)


def der(data, rng, spoil):
    """DER with one value, at any depth, spoilt; the lengths around it are right again."""
    values = list(_values(data))
    if not values or values[-1] is None:
        return spoil(data)
    index = rng.randrange(len(values))
    tag, content = values[index]
    unused = content[:1] if tag == BIT_STRING else b""
    match rng.choice(["inside"] * 9 + ["tag", "spoil", "empty", "drop", "double", "move"]):
        case "inside":
            content = unused + der(content[len(unused) :], rng, spoil)
            values[index] = tag, content
        case "tag":
            values[index] = rng.choice(TAGS), content
        case "spoil":
            values[index] = tag, spoil(content)
        case "empty":
            values[index] = tag, b""
        case "drop":
            del values[index]
        case "double":
            values.insert(index, values[index])
        case "move":
            values.append(values.pop(index))
    return b"".join(Der.of(tag, content) for tag, content in values)


def _values(data):
    """(tag, content) of each DER value in `data`, and None at the end if there is more."""
    at = 0
    while at < len(data):
        head = data[at : at + 2]
        at += 2
        size = head[-1]
        if size & 0x80:
            more = size & 0x7F
            size = int.from_bytes(data[at : at + more])
            at += more
        if len(head) < 2 or at + size > len(data):
            yield None
            return
        yield head[0], data[at : at + size]
        at += size


def _changed(holder, rng, spoil):
    """`holder` with one binary property other than it was, or the class."""
    items = list(holder.binary_properties)
    if not items:
        texts = [
            (name, spoil(value.encode()).decode(errors="replace").replace("\0", ""))
            for name, value in holder.properties
        ]
        return replace(holder, properties=tuple(texts))
    index = rng.randrange(len(items))
    name, value = items[index]
    match rng.choice(["value"] * 8 + ["drop", "double", "rename", "move", "class", "as text"]):
        case "value":
            items[index] = name, _spoilt(name, value, rng, spoil)
        case "drop":
            del items[index]
        case "double":
            items.insert(rng.randrange(len(items)), items[index])
        case "rename":
            items[index] = rng.choice(PROPERTIES), value
        case "move":
            items.append(items.pop(index))
        case "class":
            return replace(holder, class_id=rng.choice(CLASSES))
        case "as text":
            return replace(holder, properties=((name, "text"),))
    return replace(holder, binary_properties=tuple(items))


def _spoilt(name, value, rng, spoil):
    """A value, by what it is."""
    if name.endswith("_algo") and rng.randint(0, 1):
        return rng.choice(NAMES)
    kinds = {"c.id": in_pem, "c.pdata": parameters}
    return kinds.get(name, plain)(value, rng, spoil)


def _at_a_length(data, rng):
    """`data`, one time in eight with another number where a length or count seems to be."""
    if rng.randint(0, 7):
        return data
    places = [
        at for at in range(0, len(data) - 3, 4) if 0 < int.from_bytes(data[at : at + 4]) < len(data)
    ]
    if not places:
        return data
    at = rng.choice(places)
    number = int.from_bytes(data[at : at + 4])
    new = rng.choice([*NUMBERS, number - 1, number + 1, number + 4])
    return data[:at] + struct.pack(">I", new) + data[at + 4 :]
