"""Chains and lists of other tools: each with the verdict that every stack gives.

The DER is put together here, for what no builder writes. tests/unit/test_chains.py asks pqsec, and
tests/interop/test_chains.py the OpenSSL that the stacks use.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from ipaddress import ip_address, ip_network

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from pqsec_pki._asn1 import Oid, encode, time_of
from pqsec_pki._der import sequence_of

GOOD, BAD = True, False
DAY = timedelta(days=1)
ECDSA = sequence_of([encode(Oid("1.2.840.10045.4.3.2"))])
CN, ORGANIZATION, MAIL = "2.5.4.3", "2.5.4.10", "1.2.840.113549.1.9.1"
UTF8, NUMERIC, PRINTABLE, T61, IA5, VISIBLE, BMP = 0x0C, 0x12, 0x13, 0x14, 0x16, 0x1A, 0x1E
ABSENT, FALSE, TRUE = b"", b"\x01\x01\x00", b"\x01\x01\xff"
OTHER = "1.2.3.4.5"


@cache
def key(name):
    return ec.generate_private_key(ec.SECP256R1())


def tlv(tag, octets):
    return sequence_of([octets], tag)


def name(*parts):
    """A name of parts (OID, text or octets, tag), each an RDN of its own."""
    found = []
    for oid, value, tag in parts:
        octets = value if isinstance(value, bytes) else value.encode()
        found.append(tlv(0x31, sequence_of([encode(Oid(oid)), tlv(tag, octets)])))
    return sequence_of(found)


def common(value, tag=UTF8):
    return name((CN, value, tag))


def extension(value, critical=ABSENT, oid=None):
    """An x509 extension value, or octets with `oid`."""
    octets = value if isinstance(value, bytes) else value.public_bytes()
    named = Oid(oid) if oid else value.oid
    return sequence_of([encode(named), critical, tlv(4, octets)])


def signed(tbs, by):
    signature = key(by).sign(tbs, ec.ECDSA(hashes.SHA256()))
    return sequence_of([tbs, ECDSA, tlv(3, b"\0" + signature)])


CA_NAME, LEAF_NAME = common("Identity CA"), common("/lab/alice")
IS_CA = extension(x509.BasicConstraints(ca=True, path_length=None), TRUE)
START = datetime.now(UTC).replace(microsecond=0) - DAY


def certificate(  # noqa: PLR0913 -- the fields
    subject, issuer, holder, extensions, *, serial=7, version=b"\xa0\x03\x02\x01\x02"
):
    spki = key(holder).public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    number = serial.to_bytes(serial.bit_length() // 8 + 1, signed=True)
    times = sequence_of([encode(time_of(START)), encode(time_of(START + 30 * DAY))])
    last = [sequence_of([sequence_of(extensions)], 0xA3)] if extensions else []
    parts = [version, tlv(2, number), ECDSA, issuer, times, subject, spki, *last]
    return signed(sequence_of(parts), "ca")


def ca(*extensions, subject=CA_NAME, **options):
    return certificate(subject, subject, "ca", [IS_CA, *extensions], **options)


def leaf(*extensions, subject=LEAF_NAME, issuer=CA_NAME, **options):
    return certificate(subject, issuer, "leaf", extensions, **options)


def entry(*extensions, serial=7):
    parts = [tlv(2, bytes([serial])), encode(time_of(START))]
    return sequence_of([*parts, *([sequence_of(extensions)] if extensions else [])])


def crl(*extensions, entries=(), issuer=CA_NAME):
    number = extension(x509.CRLNumber(1))
    times = [encode(time_of(START)), encode(time_of(START + 30 * DAY))]
    revoked = [sequence_of(entries)] if entries else []
    last = sequence_of([sequence_of([number, *extensions])], 0xA0)
    return signed(sequence_of([b"\x02\x01\x01", ECDSA, issuer, *times, *revoked, last]), "ca")


@dataclass(frozen=True)
class Case:
    """A CA, a participant, maybe a list, and whether stacks accept the participant."""

    words: str
    accepted: bool
    ca: bytes
    leaf: bytes
    crl: bytes | None = None
    older: bool = False
    """Whether OpenSSL 3.0 accepts it, and 3.5 does not."""

    def __str__(self):
        return self.words


def x509_name(der):
    return x509.DirectoryName(x509.Name.from_bytes(der))


def directory(der):
    """A directoryName of a name that cryptography does not write."""
    return tlv(0xA4, der)


def _identified(by_key=None, issuer=None, serial=None):
    names = None if issuer is None else [x509_name(issuer)]
    return x509.AuthorityKeyIdentifier(by_key, names, serial)


def constraints(*, permitted=None, excluded=None):
    return x509.NameConstraints(permitted, excluded)


def _key_identifiers():
    own = extension(x509.SubjectKeyIdentifier(b"ca" * 10))
    with_key = ca(own)
    named = {
        "its key": (GOOD, _identified(b"ca" * 10)),
        "another key": (BAD, _identified(b"no" * 10)),
        "its serial number": (GOOD, _identified(issuer=CA_NAME, serial=7)),
        "another serial number": (BAD, _identified(issuer=CA_NAME, serial=99)),
        "another issuer": (BAD, _identified(issuer=LEAF_NAME, serial=7)),
        "the issuer in capitals": (GOOD, _identified(issuer=common("IDENTITY CA"), serial=7)),
        "its key, and another serial number": (BAD, _identified(b"ca" * 10, CA_NAME, 99)),
    }
    for words, (accepted, value) in named.items():
        yield Case(f"leaf identifies {words}", accepted, with_key, leaf(extension(value)))
        yield Case(f"list identifies {words}", accepted, with_key, leaf(), crl(extension(value)))
        if "issuer in" not in words:
            yield Case(f"CA identifies {words}", accepted, ca(own, extension(value)), leaf())
    for words, accepted, issuer in (("its issuer", GOOD, CA_NAME), ("another", BAD, LEAF_NAME)):
        several = [x509.DNSName("ca.example"), x509_name(issuer)]
        value = x509.AuthorityKeyIdentifier(None, several, 7)
        yield Case(f"leaf names {words} behind a host", accepted, with_key, leaf(extension(value)))
    critical = crl(extension(_identified(b"ca" * 10), TRUE))
    yield Case("a critical identifier of a list", GOOD, with_key, leaf(), critical)


def _names():
    for text, tag, accepted in (
        ("Identity CA", PRINTABLE, True),
        ("identity ca", UTF8, True),
        ("  Identity   CA ", UTF8, True),
        ("Identity CA".encode("utf-16-be"), BMP, True),
        ("IDENTITY CA", T61, True),
        ("IdentityCA", UTF8, False),
        ("Identity CB", PRINTABLE, False),
    ):
        issuer = common(text, tag)
        words = f"issuer {text!r} of type {tag}"
        yield Case(words, accepted, ca(), leaf(issuer=issuer))
        yield Case(f"{words} of a list", accepted, ca(), leaf(), crl(issuer=issuer))
        revoking = crl(issuer=issuer, entries=[entry()])
        yield Case(f"{words} of a list that revokes", BAD, ca(), leaf(), revoking)
    other = certificate(CA_NAME, LEAF_NAME, "ca", [IS_CA])
    yield Case("a CA that names another as its issuer", BAD, other, leaf())
    yield Case("the CA's own name", BAD, ca(), leaf(subject=CA_NAME))
    yield Case("the CA's own name, capitals", BAD, ca(), leaf(subject=common("IDENTITY CA")))
    for text in ("identity_ca", "*.lab", "ca@lab"):
        subject = common(text, PRINTABLE)
        yield Case(f"a printable {text}", GOOD, ca(subject=subject), leaf(issuer=subject))
        with_list = crl(issuer=subject)
        yield Case(f"a list of {text}", GOOD, ca(subject=subject), leaf(issuer=subject), with_list)
    for text, tag, accepted in (
        ("alice", VISIBLE, False),
        ("alice", 0x04, False),
        ("alice", 0x1B, False),
        ("𐀀".encode("utf-16-be"), BMP, False),
        ("é".encode("latin-1"), T61, True),
        (b"\xc3\xa9", T61, True),
        (b"\xe9", UTF8, False),
        ("12", NUMERIC, True),
    ):
        yield Case(
            f"a subject {text!r} of type {tag}", accepted, ca(), leaf(subject=common(text, tag))
        )


def _forms():
    for text in ("alice", "*.lab"):
        first = leaf(subject=common(text, PRINTABLE), version=b"")
        yield Case(f"a printable {text} of version 1", GOOD, ca(), first)
    false = extension(b"\x30\x03" + FALSE, oid="2.5.29.19")
    yield Case("cA FALSE", GOOD, ca(), leaf(false))
    critical = extension(b"\x30\x03" + FALSE, TRUE, oid="2.5.29.19")
    yield Case("critical cA FALSE", GOOD, ca(), leaf(critical))
    san = x509.SubjectAlternativeName([x509.DNSName("x.example")])
    yield Case("critical FALSE", GOOD, ca(), leaf(extension(san, FALSE)))
    yield Case("critical FALSE of a list", GOOD, ca(), leaf(), crl(extension(b"", FALSE, OTHER)))
    for serial in (0, -1, -300):
        yield Case(f"serial number {serial}", GOOD, ca(), leaf(serial=serial))
        yield Case(f"CA with serial number {serial}", GOOD, ca(serial=serial), leaf())
    policy = x509.PolicyInformation(Oid("1.2.3"), None)
    values = {
        "subjectAltName": san,
        "certificatePolicies": x509.CertificatePolicies([policy]),
        "policyConstraints": x509.PolicyConstraints(0, None),
        "inhibitAnyPolicy": x509.InhibitAnyPolicy(0),
        "crlDistributionPoints": points("http://a.example"),
    }
    for words, value in values.items():
        yield Case(f"critical {words}", GOOD, ca(), leaf(extension(value, TRUE)))
        yield Case(f"critical {words} of a CA", GOOD, ca(extension(value, TRUE)), leaf())
    netscape = extension(b"\x03\x02\x05\xa0", TRUE, "2.16.840.1.113730.1.1")
    yield Case("critical nsCertType", GOOD, ca(), leaf(netscape))
    for oid in ("2.5.29.9", OTHER):
        yield Case(f"critical {oid}", BAD, ca(), leaf(extension(b"\x30\x00", TRUE, oid)))
    proxy = bytes.fromhex("300c300a06082b06010505071501")
    addresses = bytes.fromhex("300c300a0402000130040302000a")
    systems = bytes.fromhex("3007a0053003020105")
    for critical in (ABSENT, TRUE):
        value = extension(proxy, critical, "1.3.6.1.5.5.7.1.14")
        yield Case(f"a proxy certificate {critical.hex()}", BAD, ca(), leaf(value))
        for oid, octets in (("1.3.6.1.5.5.7.1.7", addresses), ("1.3.6.1.5.5.7.1.8", systems)):
            value = extension(octets, critical, oid)
            yield Case(f"resources {oid} {critical.hex()}", BAD, ca(), leaf(value))
            yield Case(f"resources {oid} of a CA {critical.hex()}", GOOD, ca(value), leaf())


def points(*addresses, reasons=None, issuer=None):
    names = [x509.UniformResourceIdentifier(each) for each in addresses] or None
    by = None if issuer is None else [x509_name(issuer)]
    return x509.CRLDistributionPoints([x509.DistributionPoint(names, None, reasons, by)])


def issuing(*addresses, **options):
    given = {
        "full_name": [x509.UniformResourceIdentifier(each) for each in addresses] or None,
        "relative_name": None,
        "only_contains_user_certs": False,
        "only_contains_ca_certs": False,
        "only_some_reasons": None,
        "indirect_crl": False,
        "only_contains_attribute_certs": False,
    }
    return x509.IssuingDistributionPoint(**given | options)


def _partitions(a, b, some):
    """Distribution points of certificates, and that of a list."""
    of_a, every = issuing(a), frozenset(x509.ReasonFlags) - {
        x509.ReasonFlags.unspecified, x509.ReasonFlags.remove_from_crl
    }  # fmt: skip
    host, ours, other = x509.DNSName("ca.example"), x509_name(CA_NAME), x509_name(LEAF_NAME)
    url = [x509.UniformResourceIdentifier(a)]

    def by(*issuers):
        return x509.CRLDistributionPoints([x509.DistributionPoint(url, None, None, issuers)])

    yield "for all reasons, one by one", GOOD, points(a, reasons=every), of_a
    yield "of its partition among others", GOOD, points("ldap://x", a), issuing(b, a)
    yield "of any partition of this CA", GOOD, points(issuer=CA_NAME), of_a
    yield "of any partition of another CA", BAD, points(issuer=LEAF_NAME), of_a
    yield "of its partition, of several CAs", GOOD, by(other, ours), of_a
    yield "of its partition, of a host and this CA", GOOD, by(host, ours), of_a
    yield "of its partition, of a host", BAD, by(host), of_a
    users = issuing(only_contains_user_certs=True)
    yield "of user certificates, which names a partition", GOOD, points(a), users
    yield "of all, beside a partition of another CA", GOOD, points(a, issuer=LEAF_NAME), None
    part = x509.RelativeDistinguishedName([x509.NameAttribute(Oid(CN), "x")])
    relative = x509.DistributionPoint(None, part, None, [ours])
    yield "of a relative partition", BAD, x509.CRLDistributionPoints([relative]), of_a
    twice = [x509.DistributionPoint(url, None, each, None) for each in (some, None)]
    yield "of its partition, twice, first for some", BAD, x509.CRLDistributionPoints(twice), of_a
    yield "of it, last for some", GOOD, x509.CRLDistributionPoints(twice[::-1]), of_a
    mixed = [*url, ours]
    for words, of_leaf, of_list in (("first", mixed, [ours]), ("last", [ours], mixed)):
        named = x509.CRLDistributionPoints([x509.DistributionPoint(of_leaf, None, None, None)])
        yield f"of a directory and an address, {words}", GOOD, named, issuing(full_name=of_list)
    for text, accepted in (("IDENTITY ca", GOOD), ("other", BAD)):
        named = x509.DistributionPoint([x509_name(common(text))], None, None, None)
        point = issuing(full_name=[ours])
        yield f"of the partition {text}", accepted, x509.CRLDistributionPoints([named]), point


def _scopes():
    a, b = "http://a.example/crl", "http://b.example/crl"
    some = frozenset({x509.ReasonFlags.key_compromise})
    lists = {
        "user certificates": (GOOD, issuing(only_contains_user_certs=True)),
        "CA certificates": (BAD, issuing(only_contains_ca_certs=True)),
        "attribute certificates": (BAD, issuing(only_contains_attribute_certs=True)),
        "other issuers": (BAD, issuing(indirect_crl=True)),
        "some reasons": (BAD, issuing(only_some_reasons=some)),
        "one partition": (BAD, issuing(a)),
        "changes": (BAD, x509.DeltaCRLIndicator(1)),
    }
    for words, (accepted, value) in lists.items():
        for critical in (ABSENT, FALSE, TRUE):
            made = crl(extension(value, critical))
            older = words == "changes"
            yield Case(
                f"list of {words} {critical.hex()}", accepted, ca(), leaf(), made, older=older
            )
    user = issuing(only_contains_user_certs=True).public_bytes()
    explicit = sequence_of([user[2:], b"\x82\x01\x00"])
    made = crl(extension(explicit, TRUE, "2.5.29.28"))
    yield Case("list of user certificates, CA FALSE", GOOD, ca(), leaf(), made)
    for words, accepted, value, point in (
        *_partitions(a, b, some),
        ("of its partition", GOOD, points(a), issuing(a)),
        ("of one of its partitions", GOOD, points(b, a), issuing(a)),
        ("of another partition", BAD, points(b), issuing(a)),
        ("of all, which names a partition", GOOD, points(a), None),
        ("for some reasons of its partition", BAD, points(a, reasons=some), issuing(a)),
        ("for some reasons of it", BAD, points(a, reasons=some), None),
        ("of its partition, of this CA", GOOD, points(a, issuer=CA_NAME), issuing(a)),
        ("of its partition, of another CA", BAD, points(a, issuer=LEAF_NAME), issuing(a)),
    ):
        made = crl(*([] if point is None else [extension(point, TRUE)]))
        yield Case(f"list {words}", accepted, ca(), leaf(extension(value)), made)
    reason = x509.CRLReason(x509.ReasonFlags.key_compromise)
    removed = x509.CRLReason(x509.ReasonFlags.remove_from_crl)
    other = x509.CertificateIssuer([x509_name(LEAF_NAME)])
    entries = {
        "an entry": (GOOD, entry(serial=8)),
        "its entry": (BAD, entry(serial=7)),
        "its entry, with a reason": (BAD, entry(extension(reason))),
        "its entry, removed": (GOOD, entry(extension(removed))),
        "a critical reason": (BAD, entry(extension(reason, TRUE), serial=8)),
        "a critical date": (
            False,
            entry(extension(x509.InvalidityDate(START.replace(tzinfo=None)), TRUE), serial=8),
        ),
    }
    for words, (accepted, value) in entries.items():
        yield Case(f"list with {words}", accepted, ca(), leaf(), crl(entries=[value]))
    ours = entry(extension(other, TRUE), serial=8)
    made = crl(extension(issuing(indirect_crl=True), TRUE), entries=[ours])
    yield Case("indirect list with an entry of another CA", BAD, ca(), leaf(), made)


def _several(lab, acme, alice, dns):
    """Of one form and of several."""
    both, number = [x509_name(acme), x509_name(lab)], x509.RegisteredID(Oid(OTHER))
    host = x509.DNSName("a.lab.example")
    yield "one of two directories", GOOD, constraints(permitted=both), alice, ()
    yield "one of two excluded directories", BAD, constraints(excluded=both), alice, ()
    yield "a form without constraints", GOOD, constraints(permitted=dns), LEAF_NAME, (number,)
    yield "a form that nobody compares", BAD, constraints(permitted=[number]), LEAF_NAME, (number,)
    yield "it excluded", BAD, constraints(excluded=[number]), LEAF_NAME, (number,)
    yield "no name of its form", GOOD, constraints(permitted=[number]), LEAF_NAME, (host,)
    within = constraints(permitted=dns, excluded=[host])
    yield "excluded within a permitted", BAD, within, LEAF_NAME, (host,)
    yield "beside an excluded", GOOD, within, LEAF_NAME, (x509.DNSName("b.lab.example"),)


def _hosts(limits):
    inside, outside = x509.DNSName("a.lab.example"), "a.other.example"
    yield "DNS, CN beside a SAN", GOOD, limits, common(outside), (inside,)
    yield "DNS, two SANs", BAD, limits, LEAF_NAME, (inside, x509.DNSName(outside))
    yield "DNS, NUL in CN", BAD, limits, common(f"{outside}\0.lab.example"), ()
    yield "DNS, NUL after CN", GOOD, limits, common("a.lab.example\0"), ()
    yield "DNS, CN of one label", GOOD, limits, common("other"), ()
    for text in ("a..example", "a-.example", "a.-example", "a example.com", ".other.example"):
        yield f"DNS, CN {text}", GOOD, limits, common(text), ()
    dotted = constraints(permitted=[x509.DNSName(".lab.example")])
    yield "DNS with a dot, SAN below", GOOD, dotted, LEAF_NAME, (x509.DNSName("A.Lab.example"),)
    yield "DNS with a dot, SAN", BAD, dotted, LEAF_NAME, (x509.DNSName("lab.example"),)
    yield "DNS, the domain", GOOD, limits, LEAF_NAME, (x509.DNSName("LAB.example"),)
    every = constraints(permitted=[x509.DNSName("")])
    yield "DNS, all", GOOD, every, LEAF_NAME, (inside,)


def _mails(limits):
    one = constraints(permitted=[x509.RFC822Name("a@lab.example")])
    dotted = constraints(permitted=[x509.RFC822Name(".a@lab.example")])
    below = constraints(permitted=[x509.RFC822Name(".example")])
    mail = x509.RFC822Name
    yield "mail, its user", GOOD, one, LEAF_NAME, (mail("a@LAB.example"),)
    yield "mail, another user", BAD, one, LEAF_NAME, (mail("b@lab.example"),)
    yield "mail, its user in capitals", BAD, one, LEAF_NAME, (mail("A@lab.example"),)
    yield "mail, its user elsewhere", BAD, one, LEAF_NAME, (mail("a@x.example"),)
    yield "mail, a user with a dot", GOOD, dotted, LEAF_NAME, (mail(".a@lab.example"),)
    yield "mail, a host below", GOOD, below, LEAF_NAME, (mail("a@lab.example"),)
    yield "mail, no host below", BAD, below, LEAF_NAME, (mail("a@lab.other"),)
    yield "mail, SAN", GOOD, limits, LEAF_NAME, (mail("a@lab.example"),)
    yield "mail without a host", BAD, limits, name((CN, "x", UTF8), (MAIL, "lab", IA5)), ()
    other = x509.OtherName(Oid(OTHER), b"\x0c\x01x")
    yield "mail, another name", GOOD, limits, LEAF_NAME, (other,)


def _addresses():
    uri, ip = x509.UniformResourceIdentifier, x509.IPAddress
    lab, below = constraints(permitted=[uri("lab")]), constraints(permitted=[uri(".lab")])
    yield "URI, its host", GOOD, lab, LEAF_NAME, (uri("http://LAB/x"),)
    yield "URI, its host and a port", GOOD, lab, LEAF_NAME, (uri("http://lab:80/x"),)
    yield "URI, no host below", BAD, below, LEAF_NAME, (uri("http://lab/x"),)
    yield "URI, the dot alone", BAD, below, LEAF_NAME, (uri("http://.lab/x"),)
    yield "URI, a path that begins with its host", BAD, lab, LEAF_NAME, (uri("urn:lab/x"),)
    net = constraints(permitted=[ip(ip_network("10.0.0.0/8"))])
    yield "IP", GOOD, net, LEAF_NAME, (ip(ip_address("10.1.2.3")),)
    yield "IP of another", BAD, net, LEAF_NAME, (ip(ip_address("11.1.2.3")),)


def _constraints():
    lab, acme = name((ORGANIZATION, "Lab", UTF8)), name((ORGANIZATION, "acme", PRINTABLE))
    alice = name((ORGANIZATION, "LAB", PRINTABLE), (CN, "/lab/alice", UTF8))
    host = common("robot.lab.example")
    mail = name((CN, "x", UTF8), (MAIL, "a@lab.example", IA5))
    utf8_mail = name((CN, "x", UTF8), (MAIL, "a@lab.example", UTF8))
    directory = [x509_name(lab)]
    dns, mails = [x509.DNSName("lab.example")], [x509.RFC822Name("lab.example")]
    in_dns, in_mails = constraints(permitted=dns), constraints(permitted=mails)
    uri = x509.UniformResourceIdentifier
    cases = (
        ("permitted directory", GOOD, constraints(permitted=directory), alice, ()),
        ("another directory", BAD, constraints(permitted=[x509_name(acme)]), alice, ()),
        ("no directory", BAD, constraints(permitted=directory), LEAF_NAME, ()),
        ("excluded directory", BAD, constraints(excluded=directory), alice, ()),
        ("not the excluded one", GOOD, constraints(excluded=directory), LEAF_NAME, ()),
        ("DNS, no host", GOOD, in_dns, LEAF_NAME, ()),
        ("DNS, host as CN", GOOD, in_dns, host, ()),
        ("DNS, other host as CN", BAD, in_dns, common("a.b.example"), ()),
        ("DNS, excluded CN", BAD, constraints(excluded=dns), host, ()),
        ("DNS, SAN", GOOD, in_dns, LEAF_NAME, (x509.DNSName("a.lab.example"),)),
        ("DNS, other SAN", BAD, in_dns, LEAF_NAME, (x509.DNSName("x.example"),)),
        ("DNS, suffix", BAD, in_dns, LEAF_NAME, (x509.DNSName("xlab.example"),)),
        ("mail", GOOD, in_mails, mail, ()),
        ("mail in UTF-8", BAD, in_mails, utf8_mail, ()),
        ("excluded mail", BAD, constraints(excluded=mails), mail, ()),
        ("mail of another", BAD, in_mails, LEAF_NAME, (x509.RFC822Name("a@x.lab.example"),)),
        ("URI", GOOD, constraints(permitted=[uri(".lab")]), LEAF_NAME, (uri("http://a.lab/x"),)),
        ("URI of another", BAD, constraints(permitted=[uri("lab")]), LEAF_NAME, (uri("http://a.lab/x"),)),
        ("URI without a host", BAD, constraints(excluded=[uri("lab")]), LEAF_NAME, (uri("urn:x"),)),
        *_several(lab, acme, alice, dns),
        *_hosts(in_dns),
        *_mails(in_mails),
        *_addresses(),
    )  # fmt: skip
    for words, accepted, limits, subject, others in cases:
        san = [extension(x509.SubjectAlternativeName(others))] if others else []
        for critical in (ABSENT, TRUE):
            issuer = ca(extension(limits, critical))
            made = leaf(*san, subject=subject)
            yield Case(f"constraints, {words} {critical.hex()}", accepted, issuer, made)
    unrelated = ca(extension(constraints(permitted=[uri("lab")])))
    yield Case("constraints of URIs, mail in UTF-8", BAD, unrelated, leaf(subject=utf8_mail))
    nested = extension(x509.SubjectAlternativeName([uri("a:b://lab/")]))
    excluding = ca(extension(constraints(excluded=[uri("other")])))
    yield Case("constraints, URI in a URI", BAD, excluding, leaf(nested))
    tree = sequence_of([tlv(0x82, b"lab.example"), b"\x80\x01\x05"])
    limits = sequence_of([tlv(0xA0, tree)])
    bounded = ca(extension(limits, TRUE, "2.5.29.30"))
    yield Case("constraints, minimum", BAD, bounded, leaf(subject=host))
    plain = sequence_of([tlv(0x82, b"lab.example")])
    bounded = ca(extension(sequence_of([tlv(0xA0, plain + tree)]), TRUE, "2.5.29.30"))
    yield Case("constraints, minimum of the last", BAD, bounded, leaf(subject=host))
    in_directory = ca(extension(constraints(permitted=directory)))
    hostless = leaf(extension(x509.SubjectAlternativeName(dns)), subject=name())
    yield Case("constraints, no subject", GOOD, in_directory, hostless)


IDP = "2.5.29.28"
DNS = x509.SubjectAlternativeName([x509.DNSName("x.example")])
OTHER_NAME = encode(Oid(OTHER)) + tlv(0xA0, tlv(0xA4, b"\x04\x01a"))


def _encoded_defaults():
    other, reason = extension(b"", FALSE, OTHER), x509.CRLReason(x509.ReasonFlags.key_compromise)
    entries = {
        "another extension": (GOOD, entry(other, serial=8)),
        "two extensions": (GOOD, entry(other, extension(reason, FALSE), serial=8)),
        "a reason, of its certificate": (BAD, entry(extension(reason, FALSE))),
    }
    for words, (accepted, value) in entries.items():
        made = crl(entries=[entry(serial=5), value])
        yield Case(f"entry with {words}, critical FALSE", accepted, ca(), leaf(), made)
    not_critical = entry(extension(b"\x04\x03" + FALSE, oid=OTHER), serial=8)
    yield Case("entry with FALSE as a value", GOOD, ca(), leaf(), crl(entries=[not_critical]))
    for critical in (ABSENT, FALSE, TRUE):
        for words, scope, accepted in (
            ("all", b"", BAD),  # empty, which RFC 5280 5.2.5 forbids
            ("user certificates", b"\x81\x01\xff", GOOD),
            ("CA certificates", b"\x82\x01\xff", BAD),
            ("other issuers", b"\x84\x01\xff", BAD),
        ):
            flags = [bytes((tag, 1, 0)) for tag in (0x81, 0x82, 0x84, 0x85)]
            given = sequence_of([scope if each[:1] == scope[:1] else each for each in flags])
            made = crl(extension(given, critical, "2.5.29.28"))
            older = not scope
            who = f"list for {words}, others FALSE {critical.hex()}"
            yield Case(who, accepted, ca(), leaf(), made, older=older)
    host = common("robot.lab.example")
    for number, accepted in ((0, GOOD), (1, BAD)):
        for kind in (0xA0, 0xA1):
            tree = sequence_of([tlv(0x82, b"lab.example"), bytes((0x80, 1, number))])
            limits = sequence_of([tlv(kind, tree)])
            bounded = ca(extension(limits, TRUE, "2.5.29.30"))
            words = f"constraints {kind:x} with minimum {number}"
            yield Case(words, accepted and kind == 0xA0, bounded, leaf(subject=host))
            words += ", another name"
            yield Case(words, accepted and kind == 0xA1, bounded, leaf(extension(DNS)))
    for critical in (ABSENT, TRUE):
        value = extension(b"\x30\x00", critical, IDP)
        words = f"list of an empty scope {critical.hex()}"
        yield Case(words, BAD, ca(), leaf(), crl(value), older=True)
    # A dNSName of a NUL has the octets of onlyContainsCACerts FALSE
    for words, of_list, accepted in (("its", b"\x82\x01\0", GOOD), ("another", b"\x82\x01\1", BAD)):
        scope = sequence_of([tlv(0xA0, tlv(0xA0, of_list + tlv(0x86, b"http://b")))])
        made = crl(extension(scope, TRUE, IDP))
        point = extension(_point([b"\x82\x01\0"]), oid="2.5.29.31")
        yield Case(f"list of {words} partition, a NUL", accepted, ca(), leaf(point), made)


def _general_names():
    for text, tag in (("a_b*@c", PRINTABLE), ("é".encode("latin-1"), T61), (b"a", VISIBLE)):
        accepted = tag != VISIBLE
        own, other = common(text, tag), common("other_", PRINTABLE)
        for words, oid, value in (
            ("subjectAltName", "2.5.29.17", sequence_of([directory(own)])),
            ("subjectAltName of two", "2.5.29.17", sequence_of([directory(other), directory(own)])),
            ("distribution point", "2.5.29.31", _point([directory(own)])),
            ("issuer of a distribution point", "2.5.29.31", _point([], directory(own))),
        ):
            for critical in (ABSENT, TRUE):
                made = leaf(extension(value, critical, oid))
                yield Case(f"{words} with {text!r} {critical.hex()}", accepted, ca(), made)
        for words, name_of_issuer in (("its", own), ("another", other)):
            value = sequence_of([tlv(0xA1, directory(name_of_issuer)), tlv(0x82, b"\x07")])
            identifier = extension(value, oid="2.5.29.35")
            same = accepted and name_of_issuer == own
            issuer = ca(subject=own)
            who = f"{words} issuer {text!r} identified by"
            yield Case(f"{who} leaf", same, issuer, leaf(identifier, issuer=own))
            made = crl(identifier, issuer=own)
            yield Case(f"{who} list", same, issuer, leaf(issuer=own), made)
        for words, kind, subject in (
            ("permitted", 0xA0, own),
            ("not permitted", 0xA0, other),
            ("excluded", 0xA1, own),
            ("not excluded", 0xA1, other),
        ):
            limits = sequence_of([tlv(kind, sequence_of([directory(own)]))])
            issuer = ca(extension(limits, TRUE, "2.5.29.30"))
            allowed = accepted and words in ("permitted", "not excluded")
            who = f"constraints with {text!r}, {words}"
            yield Case(f"{who} subject", allowed, issuer, leaf(subject=subject))
            if kind == 0xA1:
                san = extension(sequence_of([directory(subject)]), oid="2.5.29.17")
                yield Case(f"{who} subjectAltName", allowed, issuer, leaf(san))
        for words, named in (("its", own), ("another", other)):
            point = extension(_point([directory(own)]), oid="2.5.29.31")
            scope = sequence_of([tlv(0xA0, tlv(0xA0, directory(named)))])
            made = crl(extension(scope, TRUE, "2.5.29.28"))
            same = accepted and named == own
            yield Case(f"list of {words} partition {text!r}", same, ca(), leaf(point), made)
    san = sequence_of([directory(common("a_b", PRINTABLE)), tlv(0xA0, OTHER_NAME)])
    yield Case("an otherName, and a_b", GOOD, ca(), leaf(extension(san, oid="2.5.29.17")))
    two = name((CN, "a_b", PRINTABLE), (ORGANIZATION, "c*", PRINTABLE), (CN, "12", NUMERIC))
    value = extension(sequence_of([directory(two)]), oid="2.5.29.17")
    yield Case("a directoryName of three parts", GOOD, ca(), leaf(value))


def _point(names, issuer=b""):
    full = tlv(0xA0, tlv(0xA0, b"".join(names))) if names else b""
    return sequence_of([sequence_of([full, tlv(0xA2, issuer) if issuer else b""])])


CASES = [
    *_key_identifiers(),
    *_names(),
    *_forms(),
    *_scopes(),
    *_constraints(),
    *_encoded_defaults(),
    *_general_names(),
]
