"""Every field of every message, spoilt in every way: where it is refused, in which words.

The table holds for all suites. A message is first read, then taken; then the next one
is. What nobody refuses is in the table too: there both end with one secret, and talk.
"""

import re
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, Family
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    Discovered,
    Final,
    Reply,
    Request,
    Sender,
    key_exchange_material,
    reply_to,
    unprotect_submessage,
)
from tests.fuzz.people import NOW, meet

# cryptography warns of what it will refuse some day, and a spoilt certificate may have that.
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
ECDH = KEY_AGREEMENTS.named("ecdh-p256")
HYBRID = KEY_AGREEMENTS.named("x25519mlkem768")
KINDS = [row.name for row in SIGNATURES if not ("rsa" in row.name and row.parts)]
PAIRS = ["ecdsa-p256 and ml-dsa-65", "rsa-2048 and ml-dsa-44", "ecdsa-p384 and ml-dsa-87"]
"""Certificates with an alternative key; profile transition has the first."""


class Suite(NamedTuple):
    """Whose signatures, over which key agreement, and whether optional properties are sent."""

    kind: str = "ecdsa-p256"
    agreement: str = ECDH.name
    optional: bool = True

    @property
    def row(self):
        return KEY_AGREEMENTS.named(self.agreement)

    def __str__(self):
        return f"{self.kind}, {self.agreement}, {'all' if self.optional else 'least'}"


PLAIN = Suite()
SUITES = sorted(
    {
        Suite(kind, row.name, optional)
        for optional in (True, False)
        for kind in (*KINDS, *PAIRS)
        for row in (KEY_AGREEMENTS if kind == PLAIN.kind else (ECDH, HYBRID))
    }
)
MESSAGES = ["request", "reply", "final"]

TABLE = """
               first    middle   last     dropped  doubled  emptied  longer   shorter  swapped
request
c.id           pem      chain    pem      missing  twice    pem      hash     hash     subject
c.perm         hash     hash     hash     missing  twice    hash     hash     hash     hash
c.pdata        no-guid  guid     hash     missing  twice    no-guid  hash     hash     subject
c.dsign_algo   key      key      key      missing  twice    key      key      hash     half
c.kagree_algo  asks     asks     asks     missing  twice    asks     asks     hash     another
hash_c1        changed  changed  changed  agreed   twice    size     size     size     changed
dh1            dh1      dh1      dh1      missing  twice    public   public   public   later
challenge1     echoed   echoed   echoed   missing  twice    size     size     size     echoed
reply
c.id           pem      chain    pem      missing  twice    pem      hash     hash     subject
c.perm         hash     hash     hash     missing  twice    hash     hash     hash     hash
c.pdata        no-guid  guid     hash     missing  twice    no-guid  hash     hash     subject
c.dsign_algo   key      key      key      missing  twice    key      key      hash     half
c.kagree_algo  asked    asked    asked    missing  twice    asked    asked    hash     asked
dh2            signed   signed   signed   missing  twice    signed   signed   signed   signed
challenge1     changed  changed  changed  missing  twice    size     size     size     changed
challenge2     signed   signed   signed   missing  twice    size     size     size     signed
dh1            changed  changed  changed  agreed   twice    changed  changed  changed  changed
hash_c2        changed  changed  changed  agreed   twice    size     size     size     changed
hash_c1        changed  changed  changed  agreed   twice    size     size     size     changed
signature      signed   signed   signed   missing  twice    signed   signed   signed   signed
final
challenge1     changed  changed  changed  missing  twice    size     size     size     changed
challenge2     changed  changed  changed  missing  twice    size     size     size     changed
dh1            changed  changed  changed  agreed   twice    changed  changed  changed  changed
dh2            changed  changed  changed  agreed   twice    changed  changed  changed  changed
hash_c2        changed  changed  changed  agreed   twice    size     size     size     changed
hash_c1        changed  changed  changed  agreed   twice    size     size     size     changed
signature      signed   signed   signed   missing  twice    signed   signed   signed   signed
"""
"""Flipped bits in three places, and six more ways. The last byte of a name is its NUL."""
FATES = {
    # Where the message is read,
    "missing": ("{message} read", "{name} is missing"),
    "twice": ("{message} read", "'{name}' is there 2 times"),
    "size": ("{message} read", "{name} has [0-9]+ bytes, not 32"),
    # and where it is taken.
    "pem": ("{message} taken", "introduction: (no certificate in|certificate: broken) PEM"),
    "chain": ("{message} taken", "introduction: |not signed by this CA|was issued by"),
    "no-guid": ("{message} taken", "introduction: c.pdata: no participant GUID"),
    "guid": ("{message} taken", "in c.pdata is not the one that was discovered"),
    "subject": ("{message} taken", "does not belong to the certificate's subject"),
    "key": ("{message} taken", "c.dsign_algo '.*' does not match the certificate's key"),
    "asks": ("{message} taken", "the peer asks for '.*'; allowed here: "),
    "asked": ("{message} taken", "c.kagree_algo is not what was asked for"),
    "hash": ("{message} taken", "{hash} is not as expected"),
    "changed": ("{message} taken", "{name} is not as expected"),
    "signed": ("{message} taken", "^bad .* signature$"),
    "public": ("{message} taken", "^(bad|not a) .* public key"),
    # Nothing tells the replier, but it repeats in its Reply what it was told, or signs it.
    "echoed": ("reply taken", "{name} is not as expected"),
    "later": ("reply taken", "{name} is not as expected"),
    "unsigned": ("reply taken", "^bad .* signature$"),
    # Nothing is lost without it.
    "agreed": ("agreed", "^$"),
}
"""Who reads a message, and says what."""


def read_table():
    """{message: {field: {way to spoil it: word}}}"""
    ways, *lines = [line.split() for line in TABLE.splitlines() if line]
    found = {}
    for name, *words in lines:
        if not words:
            fields = found[name] = {}
        else:
            fields[name] = dict(zip(ways, words, strict=True))
    return found


FIELDS = read_table()


# How a handshake goes on


@cache
def session(suite, alice="alice", bob="bob"):
    """A handshake to spoil; where dh1 is to lose a bit, it has one."""
    while True:
        met = meet(suite.kind, suite.row, alice=alice, bob=bob, optional=suite.optional)
        if all(met.request.dh1[at] for at in places(met.request.dh1)):
            return met


def steps(met, message, holder):
    """What is left when `holder` arrives for `message`: each step is named, then taken."""
    reply, awaiting, done = met.reply, met.awaiting, met.done
    if message == "request":
        yield "request read"
        request = Request.from_holder(holder)
        yield "request taken"
        reply, awaiting = reply_to(met.of_bob, request, now=NOW)
        holder = reply.to_holder()
    if message != "final":
        yield "reply read"
        reply = Reply.from_holder(holder)
        yield "reply taken"
        final, done = met.waiting.receive(reply, now=NOW)
        holder = final.to_holder()
    yield "final read"
    final = Final.from_holder(holder)
    yield "final taken"
    other = awaiting.receive(final)
    yield "protected message read"
    assert heard(done, other) == heard(other, done) == b"hello..."


def heard(one, other):
    """What reaches `other` of a protected message from `one`."""
    sealed = Sender(key_exchange_material(one)).protect_submessage(b"hello...")
    return unprotect_submessage(key_exchange_material(other), sealed)


def fate(going):
    """(the step that refused, in its words), or ("agreed", "") if none did."""
    step = ""
    try:
        for step in going:  # noqa: B007 -- the last one is asked for
            pass
    except VerificationError as error:
        return step, str(error)
    return "agreed", ""


# How a field is spoilt


def places(value):
    return 0, len(value) // 2, len(value) - 1


def less(value, at):
    """`value` with one bit less in a byte, or one more in a byte of zero.

    Less, so that the numbers of an ML-KEM key stay below its modulus.
    """
    byte = value[at]
    return value[:at] + bytes([byte & byte - 1 if byte else 1]) + value[at + 1 :]


def ways_to_spoil(value, other):
    """{way: the values that stand there instead}"""
    first, middle, last = places(value)
    return {
        "first": [less(value, first)],
        "middle": [less(value, middle)],
        "last": [less(value, last)],
        "dropped": [],
        "doubled": [value, value],
        "emptied": [b""],
        "longer": [value + b"\0"],
        "shorter": [value[:-1]],
        "swapped": [other],
    }


def with_values(holder, name, values):
    items = []
    for key, value in holder.binary_properties:
        items += [(key, each) for each in values] if key == name else [(key, value)]
    return DataHolder(holder.class_id, (), tuple(items))


def of_others(suite, message):
    """What other people with the same keys say there; algorithm names are of other suites."""
    other = session(suite, "carol", "dave")
    values = dict(getattr(other, message).to_holder().binary_properties)
    # Of a pair first the plain key's name: a stock peer signs so, and the policy here allows it.
    plain = other.of_alice.own.certificate.public_key.algorithm
    for name, rows in (("c.dsign_algo", [plain, *SIGNATURES]), ("c.kagree_algo", KEY_AGREEMENTS)):
        names = [row.wire_name.encode() + b"\0" for row in rows]
        values[name] = next(each for each in names if each != values.get(name))
    return values


# What becomes of it


def expected(word, suite, message, name, way):
    """(step, words): what the table says, for this suite."""
    match word:
        case "half":
            word = "hash" if suite.kind in PAIRS else "key"
        case "another":
            word = "hash" if suite.optional else "public"
        case "dh1":
            # A point is checked at once. Numbers below the modulus are some ML-KEM key.
            word = "public" if is_point(suite.row, way) else "later"
    if word in {"hash", "later"} and not suite.optional:
        word = "unsigned"
    step, words = FATES[word]
    own_hash = "hash_c1" if message == "request" else "hash_c2"
    return step.format(message=message), words.format(name=name, hash=own_hash)


def is_point(row, way):
    """Whether the byte at `way` in the row's public key or ciphertext is a point's."""
    return row.family is Family.CLASSICAL or (way == "first" and row.name.startswith("secp"))


@pytest.mark.slow(but=150)
@pytest.mark.parametrize("message", MESSAGES)
@pytest.mark.parametrize("suite", SUITES, ids=str)
def test_spoilt_fields_are_refused_where_the_table_says(suite, message):
    met, others = session(suite), of_others(suite, message)
    holder = getattr(met, message).to_holder()
    wrong = []
    for name, value in holder.binary_properties:
        for way, values in ways_to_spoil(value, others[name]).items():
            word = FIELDS[message][name][way]
            due = expected(word, suite, message, name, way)
            got = fate(steps(met, message, with_values(holder, name, values)))
            if got[0] != due[0] or not re.search(due[1], got[1]):
                wrong.append((name, way, got, due))
    assert not wrong


def test_the_table_has_every_field_of_every_message():
    met = session(PLAIN)
    for message, fields in FIELDS.items():
        names = [name for name, _ in getattr(met, message).to_holder().binary_properties]
        assert names == list(fields)


@pytest.mark.parametrize("way", ["first", "middle", "last", "swapped"])
@pytest.mark.parametrize(("message", "name"), [("request", "challenge1"), ("reply", "challenge2")])
def test_a_spoilt_challenge_is_refused_at_once_if_it_was_announced(message, name, way):
    met = session(PLAIN)
    holder = getattr(met, message).to_holder()
    value = dict(holder.binary_properties)[name]
    announced = Discovered(future_challenge=value)
    met = replace(
        met,
        of_bob=replace(met.of_bob, discovered=announced),
        waiting=replace(met.waiting, terms=replace(met.of_alice, discovered=announced)),
    )
    spoilt = ways_to_spoil(value, bytes(32))[way]
    got = fate(steps(met, message, with_values(holder, name, spoilt)))
    assert got[0] == f"{message} taken"
    assert f"{name} is not the one that the peer announced" in got[1]


@pytest.mark.parametrize("name", ["c.perm", "dh1", "challenge1"])
@pytest.mark.parametrize("suite", SUITES, ids=str)
def test_what_is_spoilt_on_the_way_there_and_put_right_on_the_way_back_is_refused(suite, name):
    met = session(suite)
    stranger = of_others(suite, "request")[name]
    holder = met.request.without_optional().to_holder()
    request = Request.from_holder(with_values(holder, name, [stranger]))
    reply, _ = reply_to(met.of_bob, request, now=NOW)
    # What Alice looks for is as she said it; only Bob's signature is over what he was told.
    hers = {key: getattr(met.reply, key) for key in ("challenge1", "dh1", "hash_c1")}
    got = fate(steps(met, "reply", replace(reply, **hers).to_holder()))
    assert got[0] == "reply taken"
    assert re.search("^bad .* signature$", got[1])


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("message", ["reply", "final"])
def test_a_pair_of_signatures_cut_down_to_the_plain_one_is_refused(kind, message):
    suite = Suite(kind, HYBRID.name, optional=False)
    met = session(suite)
    holder = getattr(met, message).to_holder()
    values = dict(holder.binary_properties)
    cut = SIGNATURES.named(kind.split(" and ")[1]).signature_size
    for part in (values["signature"][cut:], values["signature"][:cut]):
        spoilt = with_values(holder, "signature", [part])
        if message == "reply":
            plain = of_others(suite, message)["c.dsign_algo"]
            spoilt = with_values(spoilt, "c.dsign_algo", [plain])
        step, words = fate(steps(met, message, spoilt))
        assert step == f"{message} taken"
        assert re.search("^bad .* signature$", words)


# A wrong ciphertext, honestly signed


def replied_with(met, spoil):
    """What an honest Bob says and waits for, if `spoil` befalls his ciphertext."""
    agreement = met.done.agreement
    ciphertext, secret = agreement.encapsulate(met.request.dh1)
    transcript = replace(met.awaiting.transcript, dh2=spoil(ciphertext))
    signed = transcript.reply_octets()
    signature = met.of_bob.own.key.sign_handshake(signed)
    reply = replace(met.reply, dh2=transcript.dh2, signature=signature)
    outcome = replace(met.awaiting._outcome, shared_secret=agreement.shared_secret(secret, signed))
    return reply, replace(met.awaiting, transcript=transcript, _outcome=outcome)


@pytest.mark.parametrize("way", ["first", "middle", "last"])
@pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_a_wrong_ciphertext_that_is_signed_is_no_point_or_shows_when_they_talk(row, way):
    met = session(Suite(agreement=row.name))
    sound, awaiting = replied_with(met, lambda ciphertext: ciphertext)
    met = replace(met, awaiting=awaiting)
    assert fate(steps(met, "reply", sound.to_holder())) == ("agreed", "")

    wrong, awaiting = replied_with(met, lambda dh2: ways_to_spoil(dh2, b"")[way][0])
    met = replace(met, awaiting=awaiting)
    got = fate(steps(met, "reply", wrong.to_holder()))
    if is_point(row, way):
        assert got[0] == "reply taken"
        assert re.search("^bad .* ciphertext$", got[1])
        return
    # FIPS 203 6.3: implicit rejection; and X25519 takes any number. Nobody confirms the key.
    assert got == (
        "protected message read",
        "the two sides have different keys, or the data changed",
    )
    final, one = met.waiting.receive(wrong, now=NOW)
    other = awaiting.receive(final)
    for sender, receiver in ((one, other), (other, one)):
        with pytest.raises(VerificationError, match="different keys"):
            heard(sender, receiver)
