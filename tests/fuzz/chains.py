"""Random chains and revocation lists, for tests.fuzz.differential."""

from cryptography import x509

from pqsec_pki._asn1 import Oid
from tests.fuzz import libcrypto
from tests.unit import chains as made

A, B = "http://a.example/crl", "http://b.example/crl"
SOME = frozenset({x509.ReasonFlags.key_compromise})
TEXTS = ("Identity CA", "identity  ca", "/lab/alice", "robot.lab.example", "Lab", "a_b*", "", "é")
TAGS = (0x0C, 0x0C, 0x0C, 0x13, 0x14, 0x16, 0x12, 0x1A, 0x04)
READABLE = (0x0C, 0x0C, 0x0C, 0x13, 0x14, 0x16)
"""OpenSSL ignores an extension of a list if it cannot read a name in it; pqsec refuses the list."""
ATTRIBUTES = (made.CN, made.CN, made.ORGANIZATION, made.MAIL, "1.2.3.4")
CRITICAL = (made.ABSENT, made.ABSENT, made.FALSE, made.TRUE)
OTHER = Oid("1.2.3.4.5")
HOSTS = ("lab.example", ".lab.example", "robot.lab.example", "example", "x.example", "")


def make(rng):
    """A CA, a participant and, mostly, a list, packed."""
    subject = rng.choice([made.CA_NAME, made.CA_NAME, a_name(rng)])
    issuer = rng.choice([subject, subject, subject, made.CA_NAME])
    identifier = x509.SubjectKeyIdentifier(b"ca" * 10)
    own = [made.extension(identifier)] if rng.random() < 0.5 else []
    ca = made.ca(*own, *some(rng, ca_extensions), subject=subject, serial=rng.choice([7, 7, 0, -5]))
    leaf = made.leaf(
        *some(rng, leaf_extensions),
        subject=rng.choice([made.LEAF_NAME, a_name(rng)]),
        issuer=issuer,
        serial=rng.choice([7, 7, 7, 1, 0, -1]),
    )
    parts = [ca, leaf]
    if rng.random() < 0.7:
        entries = [an_entry(rng, each) for each in rng.sample([1, 2, 7], rng.randrange(3))]
        parts.append(made.crl(*some(rng, list_extensions), entries=entries, issuer=issuer))
    return libcrypto.pack(parts)


def a_name(rng, tags=TAGS):
    parts = []
    for _ in range(rng.choice([1, 1, 2, 3])):
        text, tag = rng.choice(TEXTS), rng.choice(tags)
        octets = text.encode() if tag == made.UTF8 else text.encode("latin-1")
        parts.append((rng.choice(ATTRIBUTES), octets, tag))
    return made.name(*parts)


def some(rng, pool):
    """Up to three extensions; none twice, which is refused by both."""
    found = {}
    for _ in range(rng.choice([0, 0, 1, 1, 2, 3])):
        value = rng.choice(pool(rng))
        found[value.oid] = made.extension(value, rng.choice(CRITICAL))
    return found.values()


def identifier(rng):
    key = rng.choice([None, b"ca" * 10, b"ca" * 10, b"no" * 10])
    if rng.random() < 0.5:
        return x509.AuthorityKeyIdentifier(key, None, None)
    name = made.x509_name(rng.choice([made.CA_NAME, made.LEAF_NAME, made.common("IDENTITY CA")]))
    return x509.AuthorityKeyIdentifier(key, [name], rng.choice([7, 7, 8]))


def general_names(rng):
    host = rng.choice(HOSTS)
    return [
        x509.DNSName(host),
        x509.RFC822Name(rng.choice(["a@lab.example", "lab.example", "b@x.example"])),
        x509.UniformResourceIdentifier(rng.choice(["http://robot.lab.example/a:b", "urn:x", A])),
        made.x509_name(rng.choice([made.LEAF_NAME, made.CA_NAME, made.common("lab")])),
    ]


def constraints(rng):
    bases = [
        *general_names(rng)[:2],
        x509.UniformResourceIdentifier(rng.choice(HOSTS)),
        general_names(rng)[3],
    ]
    permitted, excluded = (rng.sample(bases, rng.randrange(3)) or None for _ in range(2))
    return x509.NameConstraints(permitted, excluded if permitted or excluded else [bases[0]])


def raw(oid, *values):
    """An extension with a SEQUENCE of values that no builder of cryptography writes."""
    return x509.UnrecognizedExtension(Oid(oid), made.sequence_of(values))


def names(rng):
    return [made.directory(a_name(rng, READABLE)) for _ in range(rng.choice([1, 1, 2]))]


def raw_constraints(rng):
    minimum = rng.choice([b"", b"\x80\x01\0"])
    trees = [made.sequence_of([each, minimum]) for each in names(rng)]
    return raw("2.5.29.30", made.tlv(rng.choice([0xA0, 0xA1]), b"".join(trees)))


def raw_identifier(rng):
    issuer = made.directory(rng.choice([made.CA_NAME, a_name(rng, READABLE)]))
    return raw("2.5.29.35", made.tlv(0xA1, issuer), made.tlv(0x82, rng.choice([b"\7", b"\x08"])))


def raw_scope(rng):
    point = made.tlv(0xA0, made.tlv(0xA0, b"".join(names(rng))))
    flags = [bytes((tag, 1, rng.choice([0, 0, 255]))) for tag in (0x81, 0x82)]
    return raw("2.5.29.28", rng.choice([b"", point]), *flags)


def ca_extensions(rng):
    return [
        raw_constraints(rng),
        raw_identifier(rng),
        identifier(rng),
        constraints(rng),
        constraints(rng),
        x509.PolicyConstraints(rng.randrange(2), None),
        x509.InhibitAnyPolicy(rng.randrange(2)),
    ]


def leaf_extensions(rng):
    point = rng.choice([A, B])
    full = made.tlv(0xA0, made.tlv(0xA0, b"".join(names(rng))))
    return [
        raw("2.5.29.17", *names(rng)),
        raw("2.5.29.31", made.sequence_of([full])),
        raw_identifier(rng),
        identifier(rng),
        x509.SubjectAlternativeName(rng.sample(general_names(rng), rng.randrange(1, 4))),
        x509.CertificatePolicies([x509.PolicyInformation(Oid("1.2.3"), None)]),
        made.points(point, reasons=rng.choice([None, None, SOME])),
        made.points(point, issuer=rng.choice([made.CA_NAME, made.LEAF_NAME])),
        x509.UnrecognizedExtension(OTHER, b"\x05\x00"),
    ]


def list_extensions(rng):
    limits = ("only_contains_user_certs", "only_contains_ca_certs", "indirect_crl")
    point = rng.choice([(), (A,), (B,), (A, B)])
    return [
        raw_identifier(rng),
        raw_scope(rng),
        identifier(rng),
        made.issuing(*point, **{rng.choice(limits): True}),
        made.issuing(*(point or (A,))),
        made.issuing(*point, only_some_reasons=SOME),
        x509.DeltaCRLIndicator(1),
        x509.UnrecognizedExtension(OTHER, b"\x05\x00"),
    ]


def an_entry(rng, serial):
    reasons = (x509.ReasonFlags.key_compromise, x509.ReasonFlags.remove_from_crl)
    reason, other = x509.CRLReason(rng.choice(reasons)), x509.UnrecognizedExtension(OTHER, b"\5\0")
    found = [made.extension(each, rng.choice(CRITICAL)) for each in (reason, other)]
    return made.entry(*rng.choice([[], found[:1], found[1:], found]), serial=serial)
