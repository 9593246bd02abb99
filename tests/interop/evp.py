"""Key agreements of OpenSSL's library, for a process of its own: evp.py LIBCRYPTO.

OpenSSL's command can make no hybrid key, because those have no file format. The library
can, and the process that loads it must run on the C library it was linked with.

First it prints its version. Then it answers a line with a line, octets in hex:

    generate GROUP              a new key's public half
    decapsulate CIPHERTEXT      the secret, with the key that was made last
    encapsulate GROUP PUBLIC    a ciphertext and the secret

GROUP is a key type or, for a curve, as in EC:P-256, where a ciphertext is a public key.
What OpenSSL refuses is answered with "refused" and its words. Nothing is ever freed.
"""

import ctypes
import sys
from ctypes import byref, c_char_p, c_size_t, c_ulong, c_void_p, create_string_buffer


class RefusedError(Exception):
    """OpenSSL gave no result; its words."""


class Library:
    """libcrypto: the few functions needed, each raising RefusedError where it fails."""

    def __init__(self, path):
        self._library = ctypes.CDLL(path)
        self._library.OpenSSL_version.restype = c_char_p
        self._library.ERR_get_error.restype = c_ulong

    @property
    def version(self):
        return self._library.OpenSSL_version(0).decode()

    def context(self, **source):
        """EVP_PKEY_CTX from name=b"..." or pkey=key."""
        [(what, value)] = source.items()
        create = getattr(self._library, f"EVP_PKEY_CTX_new_from_{what}")
        create.restype = c_void_p
        return c_void_p(create(None, value, None))

    def call(self, name, *arguments):
        function = getattr(self._library, f"EVP_PKEY_{name}")
        if function(*arguments) <= 0:
            words = create_string_buffer(256)
            self._library.ERR_error_string_n(c_ulong(self._library.ERR_get_error()), words, 256)
            self._library.ERR_clear_error()
            raise RefusedError(f"{name}: {words.value.decode()}")

    def outputs(self, name, count, context, *arguments):
        """What a function writes that is asked for sizes first."""
        sizes = [c_size_t() for _ in range(count)]
        blank = [item for size in sizes for item in (None, byref(size))]
        self.call(name, context, *blank, *arguments)
        buffers = [create_string_buffer(size.value) for size in sizes]
        full = [item for pair in zip(buffers, map(byref, sizes), strict=True) for item in pair]
        self.call(name, context, *full, *arguments)
        return [buffer.raw[: size.value] for buffer, size in zip(buffers, sizes, strict=True)]

    def encoded(self, key):
        """The public half of `key`, as a TLS key share has it."""
        get = self._library.EVP_PKEY_get1_encoded_public_key
        get.restype = c_size_t
        octets = c_void_p()
        return ctypes.string_at(octets, get(key, byref(octets)))


class Agreement:
    """One process's side of key agreements."""

    def __init__(self, library):
        self._library = library
        self._group = self._key = None

    def generate(self, group):
        self._group, self._key = group, self._made("keygen", group)
        return [self._library.encoded(self._key)]

    def encapsulate(self, group, public):
        peer = self._peer(group, bytes.fromhex(public))
        if ":" in group:
            return [*self.generate(group), self._derived(peer)]
        context = self._library.context(pkey=peer)
        self._library.call("encapsulate_init", context, None)
        return self._library.outputs("encapsulate", 2, context)

    def decapsulate(self, text):
        ciphertext = bytes.fromhex(text)
        if ":" in self._group:
            return [self._derived(self._peer(self._group, ciphertext))]
        context = self._library.context(pkey=self._key)
        self._library.call("decapsulate_init", context, None)
        size = c_size_t(len(ciphertext))
        return self._library.outputs("decapsulate", 1, context, ciphertext, size)

    def _made(self, how, group):
        name, _, curve = group.partition(":")
        context = self._library.context(name=name.encode())
        self._library.call(f"{how}_init", context)
        if curve:
            self._library.call("CTX_set_group_name", context, curve.encode())
        key = c_void_p()
        self._library.call(how, context, byref(key))
        return key

    def _peer(self, group, public):
        key = self._made("paramgen", group)
        self._library.call("set1_encoded_public_key", key, public, c_size_t(len(public)))
        return key

    def _derived(self, peer):
        context = self._library.context(pkey=self._key)
        self._library.call("derive_init", context)
        self._library.call("derive_set_peer", context, peer)
        return self._library.outputs("derive", 1, context)[0]


def main():
    library = Library(sys.argv[1])
    print(library.version, flush=True)
    agreement = Agreement(library)
    for line in sys.stdin:
        name, *arguments = line.split()
        try:
            answer = [octets.hex() for octets in getattr(agreement, name)(*arguments)]
        except RefusedError as refusal:
            answer = ["refused", str(refusal)]
        print(*answer, flush=True)


if __name__ == "__main__":
    main()
