"""Do we read what OpenSSL reads? python -m tests.fuzz.differential --inputs 1000000

Makes hostile S/MIME and PEM, and compares what comes out, not only whether something does:
a file that pqsec takes must be the same document, the same signature, the same objects for
OpenSSL's library, and chains are judged alike. It also compares the model of OpenSSL's S/MIME
reader with OpenSSL.

Prints the seed and what it found, keeps the first inputs of each kind of finding in
--findings, and ends with 1 if there is one. OpenSSL is the `openssl` command's, and that of
PQSEC_OPENSSL35 where it is set; --openssl COMMAND names others. Policies and documents go to the
access control of DDS stacks (policies.py).
"""

import argparse
import hashlib
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

from pqsec_pki.algorithms import SIGNATURES, load_private_key, private_key_pem, unpem
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    CertificateRequest,
    RevocationList,
    certificate_request,
    revocation_list,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.smime import (
    Signer,
    _canonical,
    _cms,
    _openssl_reader,
    _reading,
    _signer_info,
    document,
    sign,
)
from tests.fuzz import chains, hostile_files, libcrypto, policies

BATCH = 256
YEAR = timedelta(days=365)


class Peer:
    """A libcrypto that answers."""

    def __init__(self, process):
        self._process = process
        [self.version] = libcrypto.unpack(process.stdout.read)

    def ask(self, kind, files):
        """Its answer to each file."""
        self._process.stdin.write(libcrypto.pack([kind + data for data in files]))
        self._process.stdin.flush()
        return [libcrypto.unpacked(each) for each in libcrypto.unpack(self._process.stdout.read)]


@contextmanager
def peer(openssl):
    """The library of that openssl command."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(libcrypto.command(openssl, libcrypto.__file__), **pipes) as process:
        yield Peer(process)
        process.stdin.close()


@contextmanager
def peers(paths):
    with ExitStack() as stack:
        yield [stack.enter_context(peer(path)) for path in paths]


# What we read: lists as libcrypto.py answers them, empty where we refuse


def smime_reader(cas):
    """The signed part, the document, and the structure as we hand it on, if a CA is named."""

    def read(data):
        found = _reading.read(data)
        info = document._signer(_cms.parse(found.cms))
        if not any(_signer_info.names(info, each.certificate) for each in cas):
            return []
        return [found.content, b"+" + found.document, handed_on(found.content, found.cms)]

    return read


def handed_on(content, cms):
    """The file of a CMS structure, as verify() hands it on."""
    structure = _cms.parse(cms)
    info = document._signer(structure)
    return _canonical.file_of(content, info, document._counters(info), None)


def disagreement_on_smime(data, ours, theirs, ask):
    """What is wrong, if something is."""
    if ours:
        # Where OpenSSL refuses for what we do not hand on, as a broken certificate that came
        # along, it has to read what we do hand on.
        content, text, structure = theirs or ask(ours[2]) or [b"", b"", b""]
        if [content, text, silent(partial(handed_on, content))(structure)] != ours:
            return "two documents" if content else "pqsec reads what OpenSSL does not"
    return disagreement_of_model(data, theirs)


def disagreement_of_model(data, theirs):
    """Where the model of OpenSSL is not OpenSSL."""
    try:
        model = _openssl_reader.read(data)
    except PqsecError as error:
        cautious = any(
            word in str(error) for word in ("content types", "boundaries", "longer than")
        )
        return "the model refuses" if theirs and not cautious and b"\0" not in data else None
    if not theirs or b"\0" in data:
        return None  # the model has no ASN.1
    if model.content != theirs[0]:
        return "the model reads another text"
    try:
        text = b"+" + _openssl_reader.text(model.content)
    except PqsecError as error:
        return (
            "the model refuses the text"
            if theirs[1] and "content types" not in str(error)
            else None
        )
    return "the model reads another document" if text != theirs[1] else None


def other_objects(data, ours, theirs, ask):
    """All that OpenSSL finds in PEM must be what we find."""
    return "other objects" if ours and ours != theirs else None


def another_object(data, ours, theirs, ask):
    """The first that OpenSSL finds in PEM must be what we find."""
    return other_objects(data, ours, theirs[:1], ask)


def silent(read):
    """`read`, which gives an empty list where it refuses."""

    def quietly(data):
        try:
            return read(data)
        except PqsecError:
            return []

    return quietly


@dataclass
class Kind:
    """Files of one kind."""

    question: bytes
    make: object
    read: object
    disagreement: object

    def peers(self, paths):
        return peers(paths)

    def ask(self, peer, files):
        return peer.ask(self.question, files)

    def compared(self, ours, answers):
        return len(answers)

    def disagreements(self, data, ours, peers, answers):
        """What each peer reads otherwise; they mostly answer the same."""
        known = {}
        for peer, theirs in zip(peers, answers, strict=True):
            key = tuple(theirs)
            if key not in known:
                known[key] = self.disagreement(data, ours, theirs, partial(self._ask, peer))
            if known[key]:
                yield f"{peer.version.decode()}: {known[key]}"

    def _ask(self, peer, data):
        [answer] = peer.ask(self.question, [data])
        return answer


@dataclass
class Result:
    """What came of many files."""

    inputs: int = 0
    taken: int = 0
    answers: int = 0
    findings: Counter = field(default_factory=Counter)
    examples: dict = field(default_factory=dict)

    def add(self, words, data):
        self.findings[words] += 1
        self.examples.setdefault(words, data)


def kinds():
    """By name. Keys are made for each run."""
    now = datetime.now(UTC)
    names = ("One CA", "Another CA", "Third CA")
    cas = [
        Authority.create(each, SIGNATURES.named("ecdsa-p256"), now=now, validity=YEAR)
        for each in names
    ]
    signers = [Signer(each.certificate, each.key) for each in cas]
    texts = [b"<dds>\n<one/>\n</dds>\n", b"\n<dds/>\n", b"<!-- " + b"x" * 1500 + b" -->\n<dds/>"]
    messages = [sign(*each, now=now) for each in zip(texts, signers, strict=True)]
    smime = hostile_files.SignedFiles(messages)
    return {
        "smime": Kind(b"S", smime.make, smime_reader(cas), disagreement_on_smime),
        "chains": Kind(b"V", chains.make, own_verdict, another_verdict),
    } | (pem_kinds(cas, now) | policies.kinds())


def pem_kinds(cas, now):
    """Those in PEM, by name."""
    keys = [unpem(private_key_pem(each.key), "key")[0] for each in cas[:2]]
    certificates = [("CERTIFICATE", each.certificate.der) for each in cas]
    crls = [revocation_list(each, [], number=1, now=now, validity=YEAR) for each in cas]
    lists = [("X509 CRL", each.der) for each in crls]
    requests = [("CERTIFICATE REQUEST", certificate_request("x", each.key).der) for each in cas]
    other = [certificates[0], keys[0]]

    def made_of(blocks):
        return hostile_files.Pem(blocks).make

    return {
        "certificates": Kind(
            b"C", made_of(certificates * 4 + keys), own_certificates, other_objects
        ),
        "lists": Kind(b"L", made_of(lists * 4 + other), own_list, another_object),
        "requests": Kind(b"R", made_of(requests * 4 + other), own_request, another_object),
        "keys": Kind(b"K", made_of(keys * 4 + certificates), own_key, another_object),
    }


def own_certificates(data):
    return [each.der for each in Certificate.all_from_pem(data)]


def own_list(data):
    return [RevocationList.from_pem(data).der]


def own_request(data):
    return [CertificateRequest.from_pem(data).der]


def own_key(data):
    return [load_private_key(data).public_key.spki]


def own_verdict(data):
    ca, leaf, *crls = libcrypto.unpacked(data)
    issuer, participant = Certificate.from_der(ca), Certificate.from_der(leaf)
    now = datetime.now(UTC)
    verify_chain(participant, issuer, now=now)
    for each in crls:
        verify_not_revoked(participant, RevocationList.from_der(each), issuer, now=now)
    return [b"good"]


STRICTER = (
    "deltaCRLIndicator",
    "certificateIssuer",
    "has the name of the CA",
    "RFC 3779",
    "relative name",
    "Cannot create empty extension",
    "cannot be compared",
)
"""What pqsec alone refuses: docs/explanation/adr/0043."""


def another_verdict(data, ours, theirs, ask):
    """Both must accept, or both refuse."""
    if ours and not theirs:
        return "pqsec alone accepts"
    if theirs and not ours:
        try:
            own_verdict(data)
        except PqsecError as error:
            if not any(words in str(error) for words in STRICTER):
                return f"pqsec alone refuses: {error}"
    return None


def run(kind, peers, inputs, seed):
    """`inputs` files of one kind, each to all peers."""
    rng, result = random.Random(seed), Result()  # noqa: S311 -- reproducible, not secret
    while result.inputs < inputs:
        files = [kind.make(rng) for _ in range(min(BATCH, inputs - result.inputs))]
        compare(kind, peers, files, result)
    return result


def compare(kind, peers, files, result):
    """Add what comes of these files."""
    read = silent(kind.read)
    result.inputs += len(files)
    all_answers = zip(*(kind.ask(each, files) for each in peers), strict=True)
    for data, answers in zip(files, all_answers, strict=True):
        ours = read(data)
        result.taken += bool(ours)
        result.answers += kind.compared(ours, answers)
        for words in kind.disagreements(data, ours, peers, answers):
            result.add(words, data)


def commands():
    """The openssl commands that there are."""
    named = [shutil.which("openssl"), os.environ.get("PQSEC_OPENSSL35")]
    return [each for each in named if each]


def main():
    known = kinds()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "kinds", nargs="*", metavar="KIND", help=f"of {', '.join(known)}; all unless told"
    )
    parser.add_argument("--inputs", type=int, default=100_000, help="files of each kind")
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(1 << 32))
    parser.add_argument("--openssl", action="append", help="an openssl command")
    parser.add_argument("--findings", type=Path, default=Path("findings"), help="folder")
    parser.add_argument("--file", type=Path, action="append", help="a finding, to compare again")
    options = parser.parse_args()
    print("seed", options.seed)
    failed = False
    for name in options.kinds or known:
        result = Result()
        with known[name].peers(options.openssl or commands()) as found:
            if options.file:
                compare(known[name], found, [each.read_bytes() for each in options.file], result)
            else:
                result = run(known[name], found, options.inputs, options.seed)
        counts = f"{result.inputs} files, {result.taken} read, {result.answers} answers"
        print(f"{name}: {counts}, {result.findings.total()} findings", flush=True)
        for words, count in result.findings.items():
            failed = True
            data = result.examples[words]
            options.findings.mkdir(exist_ok=True, parents=True)
            path = options.findings / f"{name}-{hashlib.sha256(data).hexdigest()[:12]}"
            path.write_bytes(data)
            print(f"  {count} times {words}; {path}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
