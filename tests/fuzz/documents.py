"""Governance and permissions by chance, in the forms that XML and the schemas allow, and others.

`valid` makes a pair that its schemas allow, `spoilt` one with a few changes that mostly break it;
names are few and alike, as in tests/interop/policies.py. `Spelling` writes it as other tools and
people do: each document has a few of the ODDITIES.
"""

import re
from datetime import UTC, datetime, timedelta

from pqsec_pki.documents import ProtectionKind
from tests.interop.policies import (
    DOMAINS,
    PARTITION_PATTERNS,
    PARTITIONS,
    TOPIC_PATTERNS,
    TOPICS,
)

SUBJECT = "CN=/talker"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_LETTERS = ("é", "[!é]", "?", "漢*", "\U0001f916")
_SPACES = (" ", "\n", "\t", "  ", "\n      ", " \n")
_COLLAPSED = ("enable_", "allow_", "id", "min", "max", "not_")
"""Elements around whose values the schemas allow spaces begin so."""
_HOUR, _DAY = timedelta(hours=1), timedelta(days=1)
_ALWAYS = 5
"""Of so many choices, the usual one is taken each time but one."""

ODDITIES = (
    *("spaces", "padded names", "inner spaces", "references", "zones", "fractions", "numbers"),
    *("booleans", "comments", "instructions", "tags", "attributes", "namespaces"),
    *("prolog", "mark", "encoding", "trailer", "letters", "carriage returns", "empty elements"),
)


class Element:
    """An element, to be changed: it has elements or a text."""

    def __init__(self, tag, content="", attributes=()):
        self.tag, self.attributes = tag, dict(attributes)
        self.children = None if isinstance(content, str) else list(content)
        self.text = content if isinstance(content, str) else ""

    def walk(self):
        yield self
        for child in self.children or ():
            yield from child.walk()


class Maker:
    """Makes documents by chance."""

    def __init__(self, rng, odd=()):
        self._rng, self._odd = rng, odd
        self._now = datetime.now(UTC).replace(microsecond=0)

    def _one(self, *choices):
        return self._rng.choice(choices)

    def _mostly(self):
        return self._rng.randrange(_ALWAYS) > 0

    def _evenly(self):
        return self._rng.random() < 0.5

    def _some(self, make, least, most):
        return [make() for _ in range(self._rng.randint(least, most))]

    def _boolean(self, tag, usual="true"):
        other = {"true": "false", "false": "true"}[usual]
        value = usual if self._mostly() else other
        if "booleans" in self._odd and self._evenly():
            value = {"true": "1", "false": "0"}[value]
        return Element(tag, value)

    def _number(self, tag, value):
        text = str(value)
        if "numbers" in self._odd:
            text = self._one("", "+", "0", "000", "-" if value == 0 else "") + text
        return Element(tag, text)

    def _domains(self):
        if self._mostly():
            ends = self._number("min", 0), self._number("max", 230)
            return Element("domains", [Element("id_range", ends)])
        return Element("domains", self._some(self._domain, 1, 3))

    def _domain(self):
        first, last = (self._one(*DOMAINS, 2, 4, 5, 230) for _ in range(2))
        match self._one(*["id"] * 4, "both", "both", "min", "empty", "high"):
            case "id":
                return self._number("id", first)
            case "both":
                ends = sorted((first, last))
            case "min":
                return Element("id_range", [self._number("min", first)])
            case "empty":
                ends = sorted((first, last), reverse=True)
            case _:
                ends = first, self._one(231, 232, 65535, (1 << 31) - 1)
        return Element(
            "id_range", [self._number(*each) for each in zip(("min", "max"), ends, strict=True)]
        )

    def _kind(self, tag, *kinds):
        return Element(tag, self._one(*(kinds or tuple(ProtectionKind))))

    def _topic(self):
        letters = _LETTERS if "letters" in self._odd else ()
        return self._one(*TOPIC_PATTERNS, *letters)

    def governance(self):
        """Mostly one rule for all domains, with access control and join access control."""
        rules = self._some(self._domain_rule, 1, 2)
        return _document(Element("domain_access_rules", rules), "governance")

    def _domain_rule(self):
        return Element(
            "domain_rule",
            [
                self._domains(),
                self._boolean("allow_unauthenticated_participants", "false"),
                self._boolean("enable_join_access_control"),
                self._kind("discovery_protection_kind"),
                self._kind("liveliness_protection_kind"),
                self._kind("rtps_protection_kind"),
                Element(
                    "topic_access_rules",
                    [*self._some(self._topic_rule, 0, 2), self._topic_rule("*")],
                ),
            ],
        )

    def _topic_rule(self, expression=""):
        usual = expression and self._mostly()
        return Element(
            "topic_rule",
            [
                Element("topic_expression", expression if usual else self._topic()),
                self._boolean("enable_discovery_protection"),
                self._boolean("enable_liveliness_protection"),
                self._boolean("enable_read_access_control"),
                self._boolean("enable_write_access_control"),
                self._kind("metadata_protection_kind"),
                self._kind("data_protection_kind", "NONE", "SIGN", "ENCRYPT"),
            ],
        )

    def permissions(self):
        """One grant or a few, mostly for the subject and in force."""
        grants = self._some(self._grant, 1, 3)
        return _document(Element("permissions", grants), "permissions")

    def _grant(self):
        subject = SUBJECT if self._mostly() else self._one("CN=/other", "CN=/talker,O=x", "CN=/t")
        content = [
            Element("subject_name", subject),
            Element("validity", self._validity()),
            *self._some(self._rule, 0, 4),
            Element("default", self._one("ALLOW", "DENY")),
        ]
        return Element("grant", content, {"name": self._one("g", "/talker", "a & b", "é")})

    def _validity(self):
        begin, end = self._now - 2 * _DAY, self._now + 2 * _DAY
        match self._one(*["usual"] * 10, "late", "early", "begin", "end", "hours"):
            case "late":
                begin = self._now + _DAY
            case "early":
                end = self._now - _DAY
            case "begin":
                begin = self._year(1, 1900, 1969, 1970, 1971)
            case "end":
                end = self._year(1999, 2261, 2262, 2263, 9998)
            case "hours":
                begin, end = self._now - 4 * _HOUR, self._now + 4 * _HOUR
        return [Element("not_before", self._time(begin)), Element("not_after", self._time(end))]

    def _year(self, *years):
        return datetime(self._one(*years), 2, 28, 12, tzinfo=UTC)

    def _time(self, time):
        fraction = self._one("", ".5", ".000000001") if "fractions" in self._odd else ""
        if "zones" not in self._odd:
            return f"{time:%Y}".zfill(4) + f"{time:-%m-%dT%H:%M:%S}{fraction}Z"
        zone = self._one("", "Z", "+00:00", "-00:00", "+02:00", "-05:30", "+14:00", "-09:00")
        sign = {"+": 1, "-": -1}.get(zone[:1], 0)
        hours, minutes = zone[1:].split(":") if sign else (0, 0)
        shown = time + sign * timedelta(hours=int(hours), minutes=int(minutes))
        return f"{shown:%Y}".zfill(4) + f"{shown:-%m-%dT%H:%M:%S}{fraction}{zone}"

    def _rule(self):
        content = [self._domains()]
        for tag, most in (("publish", 2), ("subscribe", 2), ("relay", 1)):
            content += self._some(lambda tag=tag: self._criteria(tag), 0, most)
        return Element(self._one("allow_rule", "allow_rule", "deny_rule"), content)

    def _criteria(self, tag):
        parts = [Element("topics", self._some(lambda: Element("topic", self._topic()), 1, 3))]
        if not self._mostly() or self._evenly():
            names = self._some(lambda: Element("partition", self._one(*PARTITION_PATTERNS)), 1, 2)
            parts.append(Element("partitions", names))
        if not self._mostly():
            parts.append(Element("data_tags", self._some(self._tag, 1, 2)))
        if not self._mostly():
            self._rng.shuffle(parts)
        return Element(tag, parts)

    def _tag(self):
        pairs = self._rng.randint(1, 2)
        return Element("tag", [Element("name", "kind"), Element("value", "test")] * pairs)


def _document(content, kind):
    place = f"http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{kind}.xsd"
    named = {"xmlns:xsi": _XSI, "xsi:noNamespaceSchemaLocation": place}
    return Element("dds", [content], named)


class Spelling:
    """Writes an element as XML, with these oddities in some of their places."""

    def __init__(self, rng, odd):
        self._rng, self._odd = rng, odd
        self._indented = rng.random() < 0.5

    def _now(self, oddity):
        return oddity in self._odd and self._rng.randrange(4) == 0

    def document(self, root):
        """The octets of the document."""
        text = self._prolog() + "\n".join(self._lines(root, 0)) + self._trailer()
        if "carriage returns" in self._odd:
            text = text.replace("\n", self._rng.choice(["\r\n", "\r"]))
        if "encoding" in self._odd:
            encoding = self._rng.choice(["ISO-8859-1", "UTF-16", "US-ASCII", "utf-8"])
            text = re.sub(r"\A<\?xml[^>]*\?>", "", text).lstrip()
            head = f'<?xml version="1.0" encoding="{encoding}"?>'
            return (head + text).encode(encoding, "xmlcharrefreplace")
        mark = b"\xef\xbb\xbf" if "mark" in self._odd else b""
        return mark + text.encode()

    def _prolog(self):
        if "prolog" not in self._odd:
            return '<?xml version="1.0" encoding="UTF-8"?>\n'
        return self._rng.choice(
            [
                "",
                "<?xml version='1.0'?>",
                '<?xml version="1.0" encoding="utf-8" standalone="yes"?>\n',
                '<?xml version="1.0"?>\n<!-- before -->\n',
                '<?xml version="1.1"?>\n',
                "<!-- before -->",
                '<?xml version="1.0"?>\n<?before it?>\n',
                "\n \n",
            ]
        )

    def _trailer(self):
        endings = ["", "\n\n", "\n<!-- after -->\n", "\n<?after it?>", "<!---->", "\n \t"]
        return self._rng.choice(endings) if "trailer" in self._odd else "\n"

    def _lines(self, element, depth):
        indent = "  " * depth if self._indented else ""
        start, end = self._tags(element)
        if element.children is None:
            text = self._value(element)
            if not text and self._now("empty elements"):
                yield f"{indent}{start[:-1]}/>"
            else:
                yield f"{indent}{start}{text}{end}"
            return
        yield indent + start
        for child in element.children:
            yield from self._between()
            yield from self._lines(child, depth + 1)
        yield from self._between()
        yield indent + end

    def _between(self):
        if self._now("comments"):
            yield self._rng.choice(["<!-- a comment -->", "<!---->", "<!-- <topic>x</topic> -->"])
        if self._now("instructions"):
            yield self._rng.choice(["<?an instruction?>", "<?x?>"])

    def _tags(self, element):
        words, tag = [], element.tag
        if self._now("namespaces"):
            words.append('xmlns:foo="urn:foo"')
        if self._now("attributes"):
            words.append('xsi:schemaLocation="urn:a b"')
        words += [f"{name}={self._quoted(value)}" for name, value in element.attributes.items()]
        space = self._rng.choice([" ", "\n", "  "]) if self._now("tags") else ""
        end = f"</{tag}{space}>"
        return f"<{' '.join([tag, *words])}{space}>", end

    def _quoted(self, value):
        mark = "'" if self._now("attributes") else '"'
        return mark + _escaped(value) + mark

    def _value(self, element):
        text = element.text
        if element.tag in {"topic", "topic_expression", "partition", "subject_name"}:
            if text and self._now("inner spaces"):
                text = text[:1] + self._rng.choice(_SPACES) + text[1:]
            padded = self._now("padded names")
        else:
            padded = element.tag.startswith(_COLLAPSED) and self._now("spaces")
        parts = [_escaped(each) for each in text]
        if self._now("references"):
            forms = [lambda each: f"&#{ord(each)};", lambda each: f"&#x{ord(each):x};"]
            every = self._rng.random() < 0.3
            for at, each in enumerate(text):
                if every or self._rng.random() < 0.3:
                    parts[at] = self._rng.choice(forms)(each)
        words = "".join(parts)
        if padded:
            either = (*_SPACES, "")
            return self._rng.choice(either) + words + self._rng.choice(either)
        return words


_ESCAPES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"}


def _escaped(text):
    return "".join(_ESCAPES.get(each, each) for each in text)


def questions(rng, count):
    """Questions as `stacks` takes them: an action, a topic and partitions, each after a zero."""
    asked = [("join",)]
    for _ in range(count - 1):
        action = rng.choice(["publish", "publish", "subscribe", "subscribe", "relay"])
        asked.append((action, rng.choice((*TOPICS, "é", " a")), *rng.choice(PARTITIONS)))
    return ["\0".join(each).encode() for each in asked]


def oddities(rng):
    """None in a third of the documents, else a few."""
    return tuple(rng.sample(ODDITIES, rng.choice([0, 1, 1, 1, 2, 3])))
