"""Documents that break their schemas in a few places: what a stack's own reader may not expect."""

from tests.fuzz.documents import Element

_LONG = 5000
_TEXTS = (
    *("", " ", "\n", "x", "*", "[", "[a-", "[]", "\\", "*" * 9, "%s%n", "x" * _LONG, "é" * 300),
    *("-1", "+", "0x10", "010", "1e3", "231", "4294967296", "9" * 30, "TRUE", "yes", "2"),
    *("ENCRYPT", "encrypt", "SIGN_WITH_ORIGIN_AUTHENTICATION", "ALLOW", "deny"),
    *("2026-01-01", "2026-13-45T99:99:99Z", "2026-01-01T00:00:00." + "1" * 20 + "Z", "Z"),
    *("0000-00-00T00:00:00Z", "-2026-01-01T00:00:00Z", "2026-01-01T24:00:00Z", "99999-01-01"),
    *(
        "CN=",
        "=",
        ",",
        " ,",
        ", ",
        "CN=/talker,",
        "CN=/talker" + ",O=x" * 30,
        "/",
        "|",
        "a" + "/x" * 99,
    ),
)
_MARKUP = (
    *("<!-- x -->", "<![CDATA[x]]>", "<![CDATA[]]>", "<?x?>", "<x/>", "<x>", "</x>", "<", ">", "&"),
    *(
        "&amp;",
        "&#0;",
        "&#x1F916;",
        "&#55296;",
        "&x;",
        "&#;",
        "<!--",
        "<![CDATA[",
        "<?",
        "]]>",
        "\0",
    ),
    *(
        "<topic/>",
        "<id/>",
        "<dds>",
        "<!DOCTYPE dds>",
        '<!DOCTYPE dds [<!ENTITY x "y">]>',
        "\r",
        '"',
    ),
)
_TAGS = (
    *("id", "id_range", "min", "max", "domains", "topic", "topics", "partition", "partitions"),
    *("publish", "subscribe", "relay", "allow_rule", "deny_rule", "default", "validity", "grant"),
    *("tag", "data_tags", "name", "value", "topic_rule", "domain_rule", "topic_expression", "dds"),
    *("permissions", "domain_access_rules", "subject_name", "not_after", "x", "TOPIC"),
)
_CHANGES = (1, 1, 1, 2, 2, 3)


def spoil(rng, root):
    """Change a few elements of `root`."""
    for _ in range(rng.choice(_CHANGES)):
        rng.choice(_ELEMENT_CHANGES)(rng, *_place(rng, root))


def spoil_text(rng, data):
    """The document with a little markup put in, or a part left out or repeated."""
    for _ in range(rng.choice(_CHANGES)):
        at = rng.randrange(len(data) + 1)
        if rng.randrange(3):
            at = max(data.find(rng.choice([b"<", b">", b"</"]), at), 0)
        size = rng.choice([1, 3, 20, 200])
        change = rng.randrange(6)
        if change < 3:
            data = data[:at] + rng.choice(_MARKUP).encode() + data[at:]
        elif change == 3:
            data = data[:at] + data[at + size :]
        elif change == 4:
            data = data[: at + size] + data[at:]
        else:
            data = data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    return data


def _place(rng, root):
    """An element but the root, and its parent."""
    pairs = [(child, each) for each in root.walk() for child in each.children or ()]
    return rng.choice(pairs) if pairs else (Element("id", "0"), root)


def _empty(rng, element, parent):
    element.children, element.text = None, ""


def _drop(rng, element, parent):
    if element in (parent.children or ()):
        parent.children.remove(element)


def _repeat(rng, element, parent):
    parent.children = (parent.children or []) + [element] * rng.choice([1, 1, 1, 50])


def _insert(rng, element, parent):
    children = parent.children = parent.children or []
    children.insert(
        rng.randrange(len(children) + 1), Element(rng.choice(_TAGS), rng.choice(_TEXTS))
    )


def _fill(rng, element, parent):
    if element.children is None:
        element.text = rng.choice(_TEXTS)
    else:
        rng.shuffle(element.children)


def _rename(rng, element, parent):
    element.tag = rng.choice(_TAGS)


def _nest(rng, element, parent):
    inner = Element(element.tag, element.text, element.attributes)
    inner.children = element.children
    element.children = [inner]


def _attribute(rng, element, parent):
    if element.attributes and rng.randrange(2):
        element.attributes.clear()
    else:
        element.attributes[rng.choice(["name", "x", "xmlns", "xmlns:xsi"])] = rng.choice(_TEXTS)


def _end_alone(rng, element, parent):
    """A range without a start, wherever domains are."""
    for each in parent.walk():
        if each.tag == "domains":
            each.children = [Element("id_range", [Element("max", "9")])]


_ELEMENT_CHANGES = (
    *(_empty, _drop, _repeat, _insert, _fill, _fill, _fill, _rename, _nest, _attribute),
    _end_alone,
)
