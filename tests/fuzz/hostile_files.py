"""Signed files and PEM that readers could disagree on, made of what they are made of.

All choices are `rng`'s. Blind changes of a file end at the first check; these are built by
the grammar, and wrong in one or a few places of it.
"""

import base64
import re

from tests.fuzz.mutation import blindly
from tests.unit.signed_files import CONSTRUCTIONS, parts_of

ENDS = (
    [b"\n"] * 12
    + [b"\r\n"] * 4
    + [b"\r\r\n", b"\r", b" \n", b"\n\n", b"\n\r\n", b"\t\n", b"\n ", b""]
)
SPACES = (
    [b""] * 6
    + [b" "] * 6
    + [b"\t", b"\x0b", b"\x0c", b"  ", b"\n ", b"\r\n\t", b"\r", b"(x)", b"(", b")", b'"']
)
BOUNDARIES = [
    b"OLD",
    b"NEW",
    b"X",
    b"Xa",
    b"----0A1B",
    b"OLD NEW",
    b"a;b",
    b"--",
    b"-",
    b"",
    b"O\\LD",
    b"OLD--",
]
NAMES = [b"boundary"] * 5 + [
    b"BOUNDARY",
    b"bound",
    b"a",
    b"protocol",
    b" boundary",
    b"boundary*",
    b'"boundary"',
    b"",
]
KINDS = [b"multipart/signed"] * 9 + [
    b"Multipart/SIGNED",
    b"multipart/mixed",
    b"text/plain",
    b"multipart/signed x",
    b'"multipart/signed"',
    b"multipart/signedx",
]
FIELDS = [b"Content-Type"] * 8 + [
    b"content-type",
    b"Content-Type ",
    b" Content-Type",
    b"X-Content-Type",
    b"MIME-Version",
    b"Subject",
    b"",
    b'"Content-Type"',
]


def choice_of(rng, *odds):
    """One of (weight, value)."""
    return rng.choices([value for _, value in odds], [weight for weight, _ in odds])[0]


class SignedFiles:
    """Makes S/MIME of the parts of real signed files."""

    def __init__(self, messages):
        self._messages = messages
        self._parts = [parts_of(message) for message in messages]

    def make(self, rng):
        """One file."""
        match choice_of(rng, (5, "built"), (3, "spoilt"), (2, "two"), (2, "long")):
            case "built":
                data = self._built(rng)
            case "two":
                data = rng.choice(CONSTRUCTIONS)(*rng.choices(self._messages, k=2))
            case "long":
                data = self._with_long_line(rng)
            case _:
                data = rng.choice(self._messages)
        for _ in range(choice_of(rng, (6, 0), (4, 1), (2, 2), (1, 4))):
            data = self._changed(data, rng)
        return data

    def _built(self, rng):
        boundaries = rng.choices(BOUNDARIES, k=2)
        head = b"".join(self._field(rng, boundaries) for _ in range(rng.choice([1, 1, 2, 3])))
        text, signature = rng.choice(self._parts)
        pieces = [head, rng.choice(ENDS[:20]), rng.choice([b"", b"", b"preamble\n"])]
        for part in (text, signature) if rng.random() < 0.8 else (text, text, signature):
            pieces += [self._line(rng, boundaries), part.removesuffix(b"\n"), rng.choice(ENDS)]
        end = b"--" + boundaries[0] + rng.choice([b"--"] * 6 + [b"", b"-", b"-- ", b"--x"])
        return b"".join((*pieces, end, rng.choice(ENDS), rng.choice([b"", b"", b"trailer\n"])))

    def _field(self, rng, boundaries):
        parameters = b"".join(
            b";" + rng.choice(SPACES) + self._parameter(rng, boundaries)
            for _ in range(rng.choice([1, 1, 1, 2, 2, 3]))
        )
        name = rng.choice(FIELDS) + b":" + rng.choice(SPACES)
        return name + rng.choice(KINDS) + parameters + rng.choice(ENDS)

    def _parameter(self, rng, boundaries):
        value = rng.choice(boundaries) if rng.random() < 0.8 else rng.choice(BOUNDARIES)
        form = rng.choice(
            [
                b"%s",
                b'"%s"',
                b'"%s"',
                b'"%s',
                b"(%s)",
                b'"; boundary=%s"',
                b"x(%s",
                b' "%s" ',
                b'"%s"x',
            ]
        )
        return rng.choice(NAMES) + b"=" + form % value + rng.choice(SPACES)

    def _line(self, rng, boundaries):
        which = boundaries[0] if rng.random() < 0.85 else boundaries[1]
        start = rng.choice([b"--"] * 15 + [b"-", b"---", b" --", b""])
        return (
            start
            + which
            + rng.choice([b""] * 10 + [b" ", b"x", b"-", b"--", b"\t"])
            + rng.choice(ENDS)
        )

    def _with_long_line(self, rng):
        """A line of about 1023 octets where lines matter, with something at the cut."""
        data = rng.choice(self._messages)
        lines = data.split(b"\n")
        at = rng.randrange(min(len(lines), 14))
        [boundary] = re.findall(rb'boundary="(.*?)"', data)
        tail = rng.choice(
            [
                b"",
                b"\r",
                b"x",
                b"\r\r",
                b"--" + boundary,
                b"--" + boundary + b"--",
                b"Content-Type: text/plain",
                b'Content-Type: multipart/signed; boundary="' + boundary + b'"',
                b'; boundary="NEW"',
                b": x",
            ]
        )
        start = rng.choice([lines[at], lines[at] + b"; x=", b"X-Long: ", b"", b"--" + boundary])
        pad = rng.choice([1021, 1022, 1023, 1024, 2046]) - len(start)
        line = start + rng.choice([b"a", b" ", b"\r", b";"]) * max(pad, 0) + tail
        where = rng.choice([at, at + 1])
        return b"\n".join([*lines[:at], line, *lines[where:]])

    def _changed(self, data, rng):
        if rng.random() < 0.3:
            return blindly(rng)(data)
        lines = data.split(b"\n")
        at = rng.randrange(len(lines))
        match rng.choice(["end", "double", "drop", "swap", "token", "insert", "fold"]):
            case "end":
                lines[at] += rng.choice(
                    [b"\r", b" ", b"\t", b"\r\r", b"\x0b", b"\0", b"-", b"--", b"=", b"=="]
                )
            case "double":
                lines.insert(rng.randrange(len(lines)), lines[at])
            case "drop":
                del lines[at]
            case "swap":
                lines.append(lines.pop(at))
            case "token":
                token = rng.choice([*SPACES, *BOUNDARIES, b";", b":", b"=", b'"'])
                place = rng.randint(0, len(lines[at]))
                lines[at] = lines[at][:place] + token + lines[at][place:]
            case "insert":
                lines.insert(
                    at,
                    rng.choice(
                        [
                            b"",
                            b" ",
                            b"\r",
                            b"x: y",
                            b" x=y",
                            b"--X",
                            b"AAAA",
                            b"Content-Type: text/plain",
                        ]
                    ),
                )
            case "fold":
                place = rng.randint(0, len(lines[at]))
                lines[at : at + 1] = [
                    lines[at][:place],
                    rng.choice([b" ", b"\t", b""]) + lines[at][place:],
                ]
        return b"\n".join(lines)


LABELS = [b"CERTIFICATE"] * 8 + [
    b"X509 CERTIFICATE",
    b"TRUSTED CERTIFICATE",
    b"X509 CRL",
    b"CERTIFICATE REQUEST",
    b"NEW CERTIFICATE REQUEST",
    b"PRIVATE KEY",
    b"certificate",
    b"CERTIFICATE ",
    b" CERTIFICATE",
    b"",
    b"CMS",
    b"EC PARAMETERS",
    b"A-B",
]
BEFORE = [b""] * 12 + [
    b"x",
    b" ",
    b"\t",
    b"-",
    b"\xef\xbb\xbf",
    b"\0",
    b"\r",
    b"a" * 253,
    b"a" * 254,
    b"a" * 255,
]
AFTER = [b""] * 12 + [b" ", b"\t", b"x", b"-", b"\r", b"\x80", b"\0", b"\x01", b"\x0b"]
TEXT = [
    b"",
    b"Bag Attributes",
    b"    localKeyID: 01",
    b"subject=CN = x",
    b"-----",
    b"-----BEGIN",
    b"-----END CERTIFICATE-----",
    b"-----BEGIN CERTIFICATE-----",
    b"\0",
    b"\xef\xbb\xbf",
    b"a" * 253,
    b"a" * 300,
    b"AAAA",
]
LINE_ENDS = (
    [b"\n"] * 12
    + [b"\r\n"] * 3
    + [b"\r\r\n", b"\r", b"\n\n", b" \n", b"\n\r\n", b"\t\n", b"\x0b\n", b"\x80\n", b"\0\n", b"\n "]
)


class Pem:
    """Makes PEM of real certificates, revocation lists, requests and keys."""

    def __init__(self, blocks):
        self._blocks = blocks
        """(label, DER) of each."""

    def make(self, rng):
        """One file."""
        pieces = []
        for _ in range(rng.choice([1, 1, 2, 2, 3])):
            if rng.random() < 0.4:
                pieces += [rng.choice(TEXT), rng.choice(LINE_ENDS)]
            pieces.append(self._block(rng))
        data = b"".join(pieces)
        for _ in range(choice_of(rng, (7, 0), (2, 1), (1, 3))):
            data = blindly(rng)(data)
        return data

    def _block(self, rng):
        label, der = rng.choice(self._blocks)
        label = label.encode() if rng.random() < 0.8 else rng.choice(LABELS)
        other = label if rng.random() < 0.9 else rng.choice(LABELS)
        odd = rng.random() < 0.6
        end = (lambda: rng.choice(LINE_ENDS)) if odd else (lambda: b"\n")
        around = rng.choice if odd else (lambda places: b"")
        text = base64.b64encode(der)
        size = (
            rng.choice([64] * 8 + [76, 63, 65, 48, 253, 254, 255, 508, 5000, 4, 7]) if odd else 64
        )
        lines = [text[at : at + size] for at in range(0, len(text), size)]
        if odd and rng.random() < 0.3:
            lines.insert(
                rng.choice([0, 0, 1, len(lines) // 2, len(lines)]),
                rng.choice(
                    [
                        b"",
                        b" ",
                        b"Proc-Type: 4,CLEAR",
                        b"X: y",
                        b"X: y\n",
                        b"=",
                        b"====",
                        b"AAAA",
                        b"-",
                        b"# x",
                        b"AAA=",
                    ]
                ),
            )
        body = (
            b"".join(line + end() for line in lines)
            if rng.random() < 0.5
            else b"\n".join(lines) + b"\n"
        )
        start = around(BEFORE) + b"-----BEGIN " + label + b"-----" + around(AFTER) + end()
        return (
            start + body + around(BEFORE) + b"-----END " + other + b"-----" + around(AFTER) + end()
        )
