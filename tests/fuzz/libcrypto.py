"""What OpenSSL's library reads in a file, for a process of its own: libcrypto.py LIBCRYPTO.

The process that loads a libcrypto must run on the C library it was linked with, and what a
hostile file does to it must not end the tests. Questions and answers are lists of octet
strings, each with its length before it (4 octets, big-endian), the list with its count.

A list of questions is answered with one answer for each, in order: a question is its kind,
one letter, and the file. An answer is empty if OpenSSL refuses.

    S   S/MIME: the signed part, "+" and the document or "", and the CMS structure in DER
    C   PEM: each certificate in DER;  L  each revocation list;  R  each request
    K   PEM: the SubjectPublicKeyInfo of the first private key
    V   a list of a CA, a participant and maybe a revocation list, in DER: "good" if it verifies
"""

import ctypes
import struct
import subprocess
import sys
from ctypes import byref, c_char_p, c_int, c_long, c_void_p, string_at
from pathlib import Path

REFUSED = b""


class Library:
    """libcrypto: what reads, and octets of what was read."""

    def __init__(self, path):
        self._library = ctypes.CDLL(path)
        self._library.OpenSSL_version.restype = c_char_p

    @property
    def version(self):
        return self._library.OpenSSL_version(0)

    def get(self, name, *arguments):
        """What a function returns that returns a pointer."""
        function = getattr(self._library, name)
        function.restype = c_void_p
        return c_void_p(function(*arguments))

    def do(self, name, *arguments):
        """What a function returns that returns a number, or nothing."""
        return getattr(self._library, name)(*arguments)

    def source(self, data):
        return self.get("BIO_new_mem_buf", data, c_int(len(data)))

    def taken(self, bio):
        """What is left in a memory BIO."""
        start = c_void_p()
        self._library.BIO_ctrl.restype = c_long
        size = self._library.BIO_ctrl(bio, c_int(3), c_long(0), byref(start))  # BIO_CTRL_INFO
        return string_at(start, size) if size > 0 else b""

    def der(self, kind, value):
        """`value` encoded by i2d_`kind`."""
        octets = c_void_p()
        size = self.do(f"i2d_{kind}", value, byref(octets))
        if size < 0:
            return REFUSED
        found = string_at(octets, size)
        self.do("CRYPTO_free", octets, None, c_int(0))
        return found


def smime(library, data):
    source, content = library.source(data), c_void_p()
    structure = library.get("SMIME_read_CMS", source, byref(content))
    found = []
    if structure.value and content.value:
        signed = library.taken(content)
        goal = library.get("BIO_new", library.get("BIO_s_mem"))
        read = library.do("SMIME_text", content, goal) == 1
        document = b"+" + library.taken(goal) if read else REFUSED
        found = [signed, document, library.der("CMS_ContentInfo", structure)]
        library.do("BIO_free", goal)
    if content.value:
        library.do("BIO_free", content)
    library.do("CMS_ContentInfo_free", structure)
    library.do("BIO_free", source)
    return found


def objects(kind):
    """A reader of all that are of `kind` in PEM."""

    def read(library, data):
        source, found = library.source(data), []
        while True:
            value = library.get(f"PEM_read_bio_{kind}", source, None, None, None)
            if not value.value:
                break
            if kind == "PrivateKey":
                found.append(library.der("PUBKEY", value))
                library.do("EVP_PKEY_free", value)
                break
            found.append(library.der(kind, value))
            library.do(f"{kind}_free", value)
        library.do("BIO_free", source)
        return found

    return read


def chain(library, data):
    """Verified as stacks verify: revocation of the participant alone, and only with a list."""
    store, context = library.get("X509_STORE_new"), library.get("X509_STORE_CTX_new")
    kinds = ["X509", "X509", "X509_CRL"]
    values = [parsed(library, *each) for each in zip(kinds, unpacked(data), strict=False)]
    found = []
    if all(each.value for each in values):
        ca, leaf, *crls = values
        library.do("X509_STORE_add_cert", store, ca)
        for each in crls:
            library.do("X509_STORE_add_crl", store, each)
            library.do("X509_STORE_set_flags", store, c_long(4))  # X509_V_FLAG_CRL_CHECK
        library.do("X509_STORE_CTX_init", context, store, leaf, None)
        if library.do("X509_verify_cert", context) == 1:
            found = [b"good"]
    library.do("X509_STORE_CTX_free", context)
    library.do("X509_STORE_free", store)
    for kind, value in zip(kinds, values, strict=False):
        library.do(f"{kind}_free", value)
    return found


def parsed(library, kind, der):
    start = c_char_p(der)
    return library.get(f"d2i_{kind}", None, byref(start), c_long(len(der)))


READERS = {
    b"S": smime,
    b"C": objects("X509"),
    b"L": objects("X509_CRL"),
    b"R": objects("X509_REQ"),
    b"K": objects("PrivateKey"),
    b"V": chain,
}


def command(openssl, script):
    """What starts `script` with the library of the command `openssl`, on its C library."""
    words = subprocess.run([openssl, "version", "-m"], capture_output=True, text=True, check=True)
    modules = words.stdout.split('"')[1]
    # Unpacked by .ci/openssl35, it stands in a root of its own.
    root = Path(openssl).resolve().parent / "root"
    folder = Path(f"{root if root.exists() else ''}{modules}").parent
    loader = next(folder.glob("ld-linux*.so.*"), None)
    start = [loader, "--library-path", folder] if loader else []
    [library] = folder.glob("libcrypto.so.?")
    return [*start, sys.executable, "-I", "-S", script, library]


def pack(items):
    """A list as it is written."""
    return struct.pack(">I", len(items)) + b"".join(
        struct.pack(">I", len(item)) + item for item in items
    )


def unpack(read):
    """A list as `read(size)` has it; EOFError at its end."""
    count = _number(read)
    return [read(_number(read)) for _ in range(count)]


def unpacked(data):
    """A list from octets."""
    at = 0

    def read(size):
        nonlocal at
        at += size
        return data[at - size : at]

    return unpack(read)


def _number(read):
    octets = read(4)
    if len(octets) < 4:
        raise EOFError
    return struct.unpack(">I", octets)[0]


def answer(library, question):
    # PEM_read_bio_PrivateKey goes on behind a damaged block or gives up, after the oldest error
    # in the queue: of an earlier file, unless that is empty.
    library.do("ERR_clear_error")
    return READERS[question[:1]](library, question[1:])


def main():
    library = Library(sys.argv[1])
    write = sys.stdout.buffer
    write.write(pack([library.version]))
    write.flush()
    while True:
        try:
            questions = unpack(sys.stdin.buffer.read)
        except EOFError:
            return
        write.write(pack([pack(answer(library, each)) for each in questions]))
        write.flush()


if __name__ == "__main__":
    main()
