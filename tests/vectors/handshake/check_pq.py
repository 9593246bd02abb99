"""Checks pq.json and second.json from their octets, with nothing of pqsec: python check_pq.py

For implementers: every step of docs/reference/wire.md in the shortest form, primitives from the
package `cryptography`. What is left out is said where it is.
"""

import hashlib
import hmac
import json
import re
import struct
import zlib
from base64 import b64decode, b64encode
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, mldsa, mlkem, x25519
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.serialization import load_der_public_key

INTRODUCTION = ("c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo")
ORDER = {
    "request": (*INTRODUCTION, "hash_c1", "dh1", "challenge1"),
    "reply": (
        *(*INTRODUCTION, "dh2", "challenge1", "challenge2", "dh1", "hash_c2", "hash_c1"),
        "signature",
    ),
    "final": ("challenge1", "challenge2", "dh1", "dh2", "hash_c2", "hash_c1", "signature"),
}
SECOND = {
    "request": ("ver", "id", "pd", "alg", "dh1", "ch1"),
    "reply": ("ver", "id", "pd", "alg", "dh2", "ch2", "sig"),
    "final": ("ver", "sig"),
}
"""The second version of the messages (wire.md, 5.1)."""
SHORT = {"ch1": "challenge1", "ch2": "challenge2", "sig": "signature", "pd": "c.pdata"}
TABLES = Path(__file__).parents[3] / "docs" / "reference" / "wire-tables.md"
SIGNED_REPLY = ("hash_c2", "challenge2", "dh2", "challenge1", "dh1", "hash_c1")
SIGNED_FINAL = ("hash_c1", "challenge1", "dh1", "challenge2", "dh2", "hash_c2")
CLASSES = {
    "request": "DDS:Auth:PKI-DH:1.0+Req",
    "reply": "DDS:Auth:PKI-DH:1.0+Reply",
    "final": "DDS:Auth:PKI-DH:1.0+Final",
}


class WrongError(Exception):
    """A step did not give what it should; a bad signature is an InvalidSignature instead."""


def expect(name, found, due):
    if found != due:
        raise WrongError(name)


# Tokens: big-endian CDR. A number is aligned to 4, and every length is a number.


def octets(data, value):
    return data + bytes(-len(data) % 4) + struct.pack(">I", len(value)) + value


def listed(properties, data=b""):
    """The binary properties after `data`: alone, what hashes and signatures cover."""
    data += bytes(-len(data) % 4) + struct.pack(">I", len(properties))
    for name, value in properties:
        data = octets(octets(data, name.encode() + b"\0"), value)
    return data


def parsed(which, data, order):
    """The binary properties of a token; they must be those of `order`, in order."""
    head = octets(b"", CLASSES[which].encode() + b"\0")
    at = len(head) + -len(head) % 4 + 8  # no string properties; then the number of ours
    values = []
    for _ in order * 2:  # a name and a value
        at += -at % 4
        (size,) = struct.unpack_from(">I", data, at)
        values.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    found = dict(zip(order, values[1::2], strict=True))
    head += bytes(-len(head) % 4 + 4)
    expect(f"encoding of {which}", listed(found.items(), head), data)
    return found


# The second version: what it restores of the first


def restored(token):
    """The binary properties by their names in the first version, as far as they are there."""
    expect("version", token["ver"], b"2")
    found = {SHORT.get(name, name): value for name, value in token.items()}
    if "id" in token:
        found["c.dsign_algo"], found["c.kagree_algo"] = token["alg"].split(b"\0")
        whole = zlib.decompressobj(-15, dictionary()).decompress(token["id"])
        certificate, rest = first_value(whole)
        cms, document = first_value(rest)
        found["c.id"] = pem(certificate)
        found["c.perm"] = smime(cms, document)
    return found


def dictionary():
    return re.search(r"(?s)```xml\n(.*?)```", TABLES.read_text())[1].encode()


def first_value(data):
    """The first DER value, and what follows it; both certificate and CMS have long lengths."""
    expect("length of a DER value", data[:2], b"\x30\x82")
    end = 4 + int.from_bytes(data[2:4])
    return data[:end], data[end:]


def base64_lines(data):
    text = b64encode(data).decode()
    return "".join(text[at : at + 64] + "\n" for at in range(0, len(text), 64))


def pem(der):
    label = "CERTIFICATE-----\n"
    return f"-----BEGIN {label}{base64_lines(der)}-----END {label}".encode()


def smime(cms, document):
    """The canonical signed file. The digest is the first that the CMS structure names."""
    sha256 = bytes.fromhex("608648016503040201")
    micalg = "sha-256" if sha256 in cms[:60] else "sha-512"
    text = document.decode()
    covered = "Content-Type: text/plain\r\n\r\n" + text.replace("\n", "\r\n")
    boundary = "----" + hashlib.sha256(covered.encode()).hexdigest()[:32].upper()
    return (
        "MIME-Version: 1.0\nContent-Type: multipart/signed; "
        f'protocol="application/x-pkcs7-signature"; micalg="{micalg}"; boundary="{boundary}"'
        "\n\nThis is an S/MIME signed message\n\n"
        f"--{boundary}\nContent-Type: text/plain\n\n{text}\n--{boundary}\n"
        'Content-Type: application/x-pkcs7-signature; name="smime.p7s"\n'
        "Content-Transfer-Encoding: base64\n"
        'Content-Disposition: attachment; filename="smime.p7s"\n\n'
        f"{base64_lines(cms)}\n--{boundary}--\n\n"
    ).encode()


# Signatures: each by the name in c.dsign_algo, with a certificate's keys


def ecdsa(certificate, signature, data):
    certificate.public_key().verify(signature, data, ec.ECDSA(hashes.SHA256()))


def ml_dsa(certificate, signature, data):
    certificate.public_key().verify(signature, data)


def composite(certificate, signature, data):
    """draft-ietf-lamps-pq-composite-sigs-19, 3.3: MLDSA65-ECDSA-P256-SHA512."""
    tbs, marker = certificate.tbs_certificate_bytes, bytes.fromhex(COMPOSITE_KEY)
    start = tbs.index(marker) + len(marker)
    first = mldsa.MLDSA65PublicKey.from_public_bytes(tbs[start : start + 1952])
    second = ec.EllipticCurvePublicKey.from_encoded_point(
        ec.SECP256R1(), tbs[start + 1952 : start + 2017]
    )
    label = b"COMPSIG-MLDSA65-ECDSA-P256-SHA512"
    message = b"CompositeAlgorithmSignatures2025" + label + b"\0" + hashlib.sha512(data).digest()
    first.verify(signature[:3309], message, label)
    second.verify(signature[3309:], message, ec.ECDSA(hashes.SHA256()))


COMPOSITE_KEY = "300a06082b0601050507062d038207e200"
"""What stands before the two keys in a certificate: AlgorithmIdentifier, BIT STRING."""


def pair(certificate, signature, data):
    """Both keys sign: the alternative one (X.509 9.8), then the certificate's own."""
    found = certificate.extensions.get_extension_for_oid(x509.ObjectIdentifier("2.5.29.72"))
    load_der_public_key(found.value.value).verify(signature[:3309], data)
    ecdsa(certificate, signature[3309:], data)


SIGNATURES = {
    "ECDSA-SHA256": ecdsa,
    "ML-DSA-44": ml_dsa,
    "ML-DSA-65": ml_dsa,
    "ML-DSA-87": ml_dsa,
    "MLDSA65-ECDSA-P256-SHA512": composite,
    "ECDSA-SHA256+ML-DSA-65": pair,
}


def admitted(token, vector, side, authority, end):
    """The certificate in a Request or Reply, held against authority, GUID and names."""
    certificate = x509.load_pem_x509_certificate(token["c.id"])
    expect("issuer", certificate.issuer, authority.subject)
    # An alternative signature in the certificate (X.509 9.8) is left out here.
    name = vector["signature_algorithm"]
    verify = ecdsa if "+" in name else SIGNATURES[name]
    verify(authority, certificate.signature, certificate.tbs_certificate_bytes)
    guid = bytes.fromhex(vector[f"{side}_guid"])
    expect("c.pdata", token["c.pdata"], b"\0\x50\0\x10" + guid + b"\0\1\0\0")
    subject = hashlib.sha256(certificate.subject.public_bytes()).digest()
    expect("GUID", int.from_bytes(guid[:6]), int.from_bytes(subject[:6]) >> 1 | 1 << 47)
    expect("c.dsign_algo", token["c.dsign_algo"], name.encode() + end)
    expect("c.kagree_algo", token["c.kagree_algo"], vector["key_agreement"].encode() + end)
    return certificate


# The secret: the initiator's ephemeral key against dh2, as each group of TLS has it


def ml_kem(kind):
    def derive(kept, ciphertext):
        key = kind.from_seed_bytes(bytes.fromhex(kept["ml_kem_seed"]))
        return key.public_key().public_bytes_raw(), key.decapsulate(ciphertext)

    return derive


def x_25519(kept, share):
    key = x25519.X25519PrivateKey.from_private_bytes(bytes.fromhex(kept["x25519"]))
    peer = x25519.X25519PublicKey.from_public_bytes(share)
    return key.public_key().public_bytes_raw(), key.exchange(peer)


def ecdh(curve):
    def derive(kept, share):
        key = ec.derive_private_key(int(kept["ecdh"], 16), curve)
        numbers, size = key.public_key().public_numbers(), curve.key_size // 8
        own = b"\4" + numbers.x.to_bytes(size) + numbers.y.to_bytes(size)
        peer = ec.EllipticCurvePublicKey.from_encoded_point(curve, share)
        return own, key.exchange(ec.ECDH(), peer)

    return derive


ML_KEM_768, ML_KEM_1024 = ml_kem(mlkem.MLKEM768PrivateKey), ml_kem(mlkem.MLKEM1024PrivateKey)
HALVES = {
    "MLKEM768": ((ML_KEM_768, 1088),),
    "MLKEM1024": ((ML_KEM_1024, 1568),),
    "X25519MLKEM768": ((ML_KEM_768, 1088), (x_25519, 32)),
    "SecP256r1MLKEM768": ((ecdh(ec.SECP256R1()), 65), (ML_KEM_768, 1088)),
    "SecP384r1MLKEM1024": ((ecdh(ec.SECP384R1()), 97), (ML_KEM_1024, 1568)),
}
"""What derives each part of the secret, and how many octets of dh2 it takes."""


def agreed(vector, dh1, dh2):
    """The secret: the halves in the order of HALVES."""
    own = secret = b""
    for derive, size in HALVES[vector["key_agreement"]]:
        public, part = derive(vector["initiator_ephemeral"], dh2[:size])
        own, secret, dh2 = own + public, secret + part, dh2[size:]
    expect("dh1", dh1, own)
    expect("size of dh2", dh2, b"")
    return secret


def opened(key, salt, data):
    """The submessage between SEC_PREFIX and SEC_POSTFIX, protected by AES256-GCM."""
    size = len(data) - 4 - 20 - 8 - 24
    layout = f">4sI4s12s4sI{size}s4s16sI"
    prefix, kind, key_id, iv, body, length, sealed, postfix, tag, macs = struct.unpack(layout, data)
    frames = (b"\x31\0\0\x14", 4, bytes(4), b"\x30\0" + struct.pack(">H", size + 4), size, 0)
    expect("frames", (prefix, kind, key_id, body, length, macs), frames)
    expect("SEC_POSTFIX", postfix, b"\x32\0\0\x14")
    session_key = hmac.digest(key, b"SessionKey" + salt + iv[:4], "sha256")
    return AESGCM(session_key).decrypt(iv, sealed + tag, None)


def sha256(data):
    return hashlib.sha256(data).digest()


def transcript(request, reply, final, mark):
    """What both sides signed over, by name; what a token repeats must be the same."""
    both = {**request, **reply}
    both["hash_c1"] = sha256(listed([(name, request[name]) for name in INTRODUCTION] + mark))
    both["hash_c2"] = sha256(listed([(name, reply[name]) for name in INTRODUCTION] + mark))
    for token in (request, reply, final):
        for name in both.keys() & token.keys() - {*INTRODUCTION, "signature", "id", "alg"}:
            expect(f"{name} repeated", token[name], both[name])
    return both


def recomputed(vector):
    """Every value of `vector` that follows from its tokens and the ephemeral key."""
    authority = x509.load_pem_x509_certificate(vector["identity_ca"].encode())
    is_second = b"\0\0\0\4ver\0" in b64decode(vector["final"])
    order = SECOND if is_second else ORDER
    tokens = [parsed(name, b64decode(vector[name]), order[name]) for name in ORDER]
    request, reply, final = map(restored, tokens) if is_second else tokens
    end, mark = (b"", [("ver", b"2")]) if is_second else (b"\0", [])
    initiator = admitted(request, vector, "initiator", authority, end)
    replier = admitted(reply, vector, "replier", authority, end)

    both = transcript(request, reply, final, mark)
    signed_reply = listed([(name, both[name]) for name in SIGNED_REPLY])
    signed_final = listed([(name, both[name]) for name in SIGNED_FINAL])
    verify = SIGNATURES[vector["signature_algorithm"]]
    verify(replier, reply["signature"], signed_reply)
    verify(initiator, final["signature"], signed_final)

    secret = agreed(vector, both["dh1"], both["dh2"])
    shared = sha256(secret + sha256(signed_reply))
    one, two = both["challenge1"], both["challenge2"]
    salt = hmac.digest(sha256(one + b"keyexchange salt" + two), shared, "sha256")
    key = hmac.digest(sha256(two + b"key exchange key" + one), shared, "sha256")
    return {
        "hash_c1": both["hash_c1"],
        "hash_c2": both["hash_c2"],
        "signed_reply_sha256": sha256(signed_reply),
        "signed_final_sha256": sha256(signed_final),
        "secret": secret,
        "shared_secret": shared,
        "kx_salt": salt,
        "kx_key": key,
        "submessage": opened(key, salt, bytes.fromhex(vector["protected_submessage"])),
    }


def check(vector):
    """WrongError or InvalidSignature unless all of `vector` holds."""
    for name, value in recomputed(vector).items():
        expect(name, value.hex(), vector[name])


if __name__ == "__main__":
    for file in ("pq.json", "second.json"):
        for each in json.loads(Path(__file__).with_name(file).read_text()):
            check(each)
            print("ok", file, each["name"])
