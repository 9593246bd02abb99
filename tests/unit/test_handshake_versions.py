"""The second version of the messages: what it says, what it refuses, and who may use it."""

import zlib
from dataclasses import replace

import pytest

from pqsec_pki._asn1 import attribute
from pqsec_pki._der import leading
from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.handshake import (
    CREDENTIALS_DICTIONARY,
    DataHolder,
    Final,
    IdentityToken,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    WireVersion,
    compact,
)
from pqsec_pki.problems import Code
from pqsec_pki.smime import (
    Require,
    Signer,
    _ber,
    _canonical,
    _cms,
    _mime,
    document_in,
    is_canonical,
    joined,
    parts_of,
    sign,
    verify,
)
from pqsec_pki.smime._ber import _value, limit_values
from pqsec_pki.smime._cms import parse
from pqsec_pki.smime.document import MAX_CARRIED, MAX_CARRIED_VALUES
from tests.unit.test_handshake import DAY, ECDH, HYBRID, KINDS, Meeting, authority, changed

FIRST, SECOND = WireVersion
KINDS_OF_BOTH = {"request": Request, "reply": Reply, "final": Final}


def signed(now, kind, name):
    """A document of CN=`name`, signed as that kind of keystore does, its certificate embedded."""
    main = kind if isinstance(kind, str) else kind[0]
    second = None if isinstance(kind, str) else authority(kind[1], now, "countersigner")
    ca = authority(main, now, "permissions")
    grant = Grant.least(
        subject_name=f"CN={name}",
        not_before=now,
        not_after=now + DAY,
        domains=DomainSet.of(0),
        publish=["rt/chatter"],
        subscribe=[],
    )
    return sign(
        Permissions(grants=(grant,)).to_xml(),
        Signer(ca.certificate, ca.key),
        countersigner=Signer(second.certificate, second.key) if second else None,
        now=now,
    )


def meeting(now, kind="ml-dsa-65", agreement=HYBRID, mine=(SECOND,), theirs=(SECOND,)):
    """Alice, who allows the versions `mine`, and Bob, who allows `theirs`."""
    met = Meeting(now, kind, agreement)
    for side, name, versions in (("of_alice", "alice", mine), ("of_bob", "bob", theirs)):
        terms = getattr(met, side)
        own = replace(terms.own, permissions=signed(now, kind, name))
        policy = replace(terms.policy, versions=versions)
        setattr(met, side, replace(terms, own=own, policy=policy))
    return met


def tokens(met):
    request, waiting = met.request()
    reply, _ = met.reply(Request.from_holder(request.to_holder()))
    final, _ = waiting.receive(Reply.from_holder(reply.to_holder()), now=met.now)
    return {"request": request, "reply": reply, "final": final}


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_both_end_with_one_secret_and_with_documents_that_verify(now, kind):
    met = meeting(now, kind)
    one, other = met.run()
    assert one.shared_secret == other.shared_secret
    for done, name in ((one, "bob"), (other, "alice")):
        whole = signed(now, kind, name)
        assert is_canonical(done.peer.permissions)
        main = kind if isinstance(kind, str) else kind[0]
        verified = verify(
            done.peer.permissions,
            authority(main, now, "permissions").certificate,
            alternative_ca=None
            if main is kind
            else authority(kind[1], now, "countersigner").certificate,
            pinned=main is not kind,
            require=Require.ANY,
        )
        assert verified.document == document_in(whole)


def test_messages_have_the_properties_of_the_table_and_read_back_as_they_were(now):
    for name, message in tokens(meeting(now)).items():
        holder = message.to_holder()
        assert tuple(each for each, _ in holder.binary_properties) == compact.names(holder.class_id)
        read = KINDS_OF_BOTH[name].from_holder(DataHolder.decode(holder.encode()))
        assert KINDS_OF_BOTH[name].from_holder(read.to_holder()) == read
        assert read.version is SECOND


def test_the_hashes_of_the_two_versions_of_one_introduction_differ(now):
    introduction = tokens(meeting(now))["request"].introduction
    first = replace(introduction, version=FIRST)
    assert first.properties == introduction.properties
    assert first.digest() != introduction.digest()


@pytest.mark.parametrize(
    ("mine", "theirs", "used"),
    [
        ((FIRST,), (SECOND, FIRST), FIRST),
        ((SECOND, FIRST), (FIRST, SECOND), SECOND),
        ((SECOND,), (FIRST,), None),
        ((FIRST,), (SECOND,), None),
    ],
)
def test_the_replier_answers_in_the_version_of_the_request_or_refuses(now, mine, theirs, used):
    met = meeting(now, mine=mine, theirs=theirs)
    if used:
        assert {each.version for each in tokens(met).values()} == {used}
        return
    with pytest.raises(VerificationError, match="allowed here: ") as refused:
        met.run()
    assert refused.value.codes == {Code.C28}


def test_a_suite_of_stock_stacks_has_the_first_version_always(now):
    met = meeting(now, "ecdsa-p256", ECDH)
    assert {each.version for each in tokens(met).values()} == {FIRST}


def test_a_reply_or_final_of_another_version_is_refused(now):
    met = meeting(now, mine=(SECOND, FIRST), theirs=(SECOND, FIRST))
    request, waiting = met.request()
    reply, awaiting = met.reply(request)
    final, _ = waiting.receive(reply, now=now)
    other = replace(reply, introduction=replace(reply.introduction, version=FIRST))
    for late in (
        lambda: waiting.receive(other, now=now),
        lambda: awaiting.receive(replace(final, challenge1=bytes(32), challenge2=bytes(32))),
    ):
        with pytest.raises(VerificationError) as refused:
            late()
        assert refused.value.codes == {Code.C28}


@pytest.mark.parametrize("which", KINDS_OF_BOTH)
def test_a_property_of_neither_the_version_nor_known_is_refused(now, which):
    message = tokens(meeting(now))[which]
    holder = message.to_holder()
    for name in ("c.id", "dh9", "x"):
        more = replace(holder, binary_properties=(*holder.binary_properties, (name, b"")))
        with pytest.raises(VerificationError, match="is not in this version") as refused:
            type(message).from_holder(more)
        assert refused.value.codes == {Code.C7}


@pytest.mark.parametrize("which", KINDS_OF_BOTH)
def test_a_version_that_is_not_allowed_is_refused_before_anything_is_expanded(
    now, which, monkeypatch
):
    """Else anybody could have credentials inflated and parsed, also where only [1] is allowed."""
    message = tokens(meeting(now))[which]
    monkeypatch.setattr(compact, "expanded", None)
    with pytest.raises(VerificationError, match="of version 2; allowed here: 1") as refused:
        type(message).from_holder(message.to_holder(), (FIRST,))
    assert refused.value.codes == {Code.C28}


def deflated(data):
    compressor = zlib.compressobj(9, wbits=-15, zdict=CREDENTIALS_DICTIONARY)
    return compressor.compress(data) + compressor.flush()


def inflated(data):
    return zlib.decompressobj(wbits=-15, zdict=CREDENTIALS_DICTIONARY).decompress(data)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: deflated(bytes(compact.MAX_CREDENTIALS + 1)), "larger than"),
        (lambda data: data[:-1], "end too soon"),
        (lambda data: data + b"\0", "bytes follow"),
        (lambda data: b"", "end too soon"),
        (lambda data: zlib.compress(inflated(data)), "not deflated with pqsec's dictionary"),
        (lambda data: deflated(b"\x30\x82"), "ends too soon"),
        (lambda data: deflated(b"\x30\x82\xff\xff" + inflated(data)), "ends too soon"),
        (lambda data: deflated(inflated(data) + b"\r"), "canonical"),
        (lambda data: deflated(inflated(data)[:4000]), "ends too soon"),
    ],
)
def test_credentials_that_do_not_inflate_to_what_is_due_are_refused(now, spoil, words):
    request = tokens(meeting(now))["request"]
    with pytest.raises(VerificationError, match=words) as refused:
        changed(request, "id", spoil)
    assert refused.value.codes == {Code.C27}


def test_no_more_is_inflated_than_the_limit_however_much_is_claimed(now):
    """A megabyte that inflates to a gigabyte costs what the limit costs."""
    request = tokens(meeting(now))["request"]
    bomb = deflated(bytes(64 << 20))
    assert len(bomb) < 100_000
    with pytest.raises(VerificationError, match="larger than"):
        changed(request, "id", lambda _: bomb)


def test_the_largest_document_that_is_carried_is_within_the_limit_for_tokens(now):
    ca = authority("ml-dsa-65", now, "permissions")
    most = b"<a>" + b"x" * (compact.MAX_CREDENTIALS - 10_000) + b"</a>"
    file = sign(most, Signer(ca.certificate, ca.key), embed_certificate=False, now=now)
    met = meeting(now)
    met.of_alice = replace(met.of_alice, own=replace(met.of_alice.own, permissions=file))
    request, _ = met.request()
    assert len(request.to_holder().encode()) < 20_000
    assert Request.from_holder(request.to_holder()).introduction.permissions == file


def values(count, tag=0x31):
    """A SET, or what `tag` says, of that many NULL values (X.690 8.8, 8.11)."""
    return _value(tag, b"\5\0" * count)


def with_attributes(cms, count):
    (info,) = parse(cms).signer_infos.as_list()
    more = [attribute(f"1.2.3.{number}", b"\5\0") for number in range(count)]
    info.signed_attributes = [*info.signed_attributes, *more]
    return _canonical.cms_of(info, [], None)


SIGNED_DATA_OID = bytes.fromhex("06092a864886f70d010702")
CREDENTIALS_OF_MANY_VALUES = {
    "a certificate of none, and sets of NULL": lambda _: (
        b"\x30\0" + _value(0x30, SIGNED_DATA_OID + _value(0xA0, _value(0x30, values(4000) * 3)))
    ),
    "one set, one value too many": lambda _: b"\x30\0" + values(MAX_CARRIED_VALUES),
    "sequences where signers are": lambda _: (
        b"\x30\0" + _value(0x30, _value(0xA0, _value(0x30, _value(0x31, values(400, 0x30) * 9))))
    ),
    "attributes": lambda parts: parts[0] + with_attributes(parts[1], 200) + parts[2],
}


@pytest.mark.parametrize("kind", CREDENTIALS_OF_MANY_VALUES)
def test_few_octets_that_make_many_values_are_refused_before_these_are_parsed(
    now, kind, monkeypatch
):
    """396 octets without a certificate made 80 000 values, and one Python call for each."""
    request = tokens(meeting(now))["request"]
    found = dict(request.to_holder().binary_properties)
    whole = CREDENTIALS_OF_MANY_VALUES[kind](leading(inflated(found["id"]), 2, "credentials"))
    token = with_credentials(request, whole)
    monkeypatch.setattr(_ber, "_convert", None)
    with pytest.raises(VerificationError, match="more than 512 values") as refused:
        Request.from_holder(token)
    assert refused.value.codes == {Code.C27}


def with_credentials(request, whole):
    holder = request.to_holder()
    pairs = {**dict(holder.binary_properties), "id": deflated(whole)}
    return replace(holder, binary_properties=tuple(pairs.items()))


def test_a_large_cms_structure_is_not_parsed(now, monkeypatch):
    whole = b"\x30\0" + _value(0x04, bytes(MAX_CARRIED))
    token = with_credentials(tokens(meeting(now))["request"], whole)
    monkeypatch.setattr(_cms, "parse", None)
    with pytest.raises(VerificationError, match="CMS structure larger than") as refused:
        Request.from_holder(token)
    assert refused.value.codes == {Code.C27}


def test_two_signatures_by_the_largest_keys_are_well_within_the_limits(now):
    for kind in (*KINDS, ("ecdsa-p384", "ml-dsa-87")):
        cms, document = parts_of(signed(now, kind, "alice"))
        assert len(cms) < MAX_CARRIED / 2
        limit_values(cms, MAX_CARRIED_VALUES // 4)
        assert joined(cms, document)


def test_line_ends_of_an_unverified_document_are_not_searched_for_one_by_one(now, monkeypatch):
    cms, _ = parts_of(signed(now, "ecdsa-p256", "alice"))
    with monkeypatch.context() as patch:
        patch.delattr(_mime.re, "sub")
        file = joined(cms, b"\n\n")
    assert document_in(file) == b"\r\n\r\n"


def test_a_document_that_only_the_first_version_carries_is_found_before_a_peer_refuses_it(now):
    ca = authority("ml-dsa-65", now, "permissions")
    signer = Signer(ca.certificate, ca.key)
    for size, fits in ((compact.MAX_CREDENTIALS - 10_000, True), (compact.MAX_CREDENTIALS, False)):
        file = sign(b"<a>" + b"x" * size + b"</a>", signer, now=now)
        if fits:
            compact.check_carried(ca.certificate.pem, file)
        else:
            with pytest.raises(MalformedError, match="credentials larger than"):
                compact.check_carried(ca.certificate.pem, file)


def in_other_form(terms):
    """`terms` with another header in the signed part of our permissions, as others write it."""
    header = b"Content-Type: text/plain"
    assert header in terms.own.permissions
    changed = terms.own.permissions.replace(header, header + b"; charset=us-ascii")
    return replace(terms, own=replace(terms.own, permissions=changed))


@pytest.mark.parametrize("versions", [(SECOND,), (FIRST, SECOND)])
def test_own_documents_that_a_version_cannot_carry_are_refused_before_any_message(now, versions):
    terms = meeting(now).of_alice
    own = in_other_form(replace(terms, policy=replace(terms.policy, versions=(FIRST,)))).own
    policy = replace(terms.policy, versions=versions)
    with pytest.raises(MalformedError, match="version 2 of the messages cannot carry") as refused:
        Terms(own=own, policy=policy)
    assert refused.value.hint == "sign the document again with `pqsec`"


def test_own_documents_need_a_canonical_form_only_for_the_second_version(now):
    first = meeting(now, mine=(FIRST,)).of_alice
    assert in_other_form(first)
    classical = meeting(now, "ecdsa-p256", ECDH).of_alice
    assert classical.policy.versions == (SECOND,)
    assert in_other_form(replace(classical, policy=replace(classical.policy, agreements=(ECDH,))))


@pytest.mark.parametrize("value", [b"a", b"a\0b\0"])
def test_other_than_two_names_are_refused(now, value):
    with pytest.raises(VerificationError, match="names of algorithms, not two"):
        changed(tokens(meeting(now))["request"], "alg", lambda _: value)


@pytest.mark.parametrize("value", [b"", b"1", b"3", b"2\0"])
def test_an_unknown_version_is_refused(now, value):
    with pytest.raises(VerificationError, match="unknown version") as refused:
        changed(tokens(meeting(now))["final"], "ver", lambda _: value)
    assert refused.value.codes == {Code.C28}


def test_the_parts_of_a_signed_document_make_it_again(now):
    whole = signed(now, "ecdsa-p256", "alice")
    cms, document = parts_of(whole)
    file = joined(cms, document)
    assert is_canonical(file)
    assert parts_of(file) == (cms, document)
    assert len(file) < len(whole)  # without the certificate
    for parts in (
        (cms + b"\0", document),
        (cms, document + b"\r"),
        (cms, document + b"\0"),
        (b"", document),
    ):
        with pytest.raises(MalformedError):
            joined(*parts)


def test_a_document_that_is_not_signed_cannot_be_sent_in_the_second_version(now):
    terms = meeting(now).of_alice
    with pytest.raises(MalformedError, match="not an S/MIME"):
        replace(terms, own=replace(terms.own, permissions=b"<dds/>"))


def test_discovery_announces_the_versions_only_if_there_is_more_than_the_first(now):
    alice = Meeting(now).alice
    row = KEY_AGREEMENTS.named("mlkem768")
    plain = IdentityToken.announced(alice.certificate, alice.ca, [row])
    assert plain == IdentityToken.announced(alice.certificate, alice.ca, [row], (FIRST,))
    assert "pqsec.versions" not in dict(plain.to_holder().properties)
    assert (plain.reads(FIRST), plain.reads(SECOND)) == (True, False)
    for versions, text in (((SECOND, FIRST), "2,1"), ((SECOND,), "2")):
        token = IdentityToken.announced(alice.certificate, alice.ca, [row], versions)
        assert dict(token.to_holder().properties)["pqsec.versions"] == text
        assert [each for each in WireVersion if token.reads(each)] == sorted(versions)


def test_the_versions_of_a_policy_are_for_new_suites(now):
    del now
    policy = PeerRequirements(agreements=(HYBRID,), versions=(SECOND,))
    assert policy.versions_with(HYBRID) == (SECOND,)
    assert policy.versions_with(ECDH) == (FIRST,)
