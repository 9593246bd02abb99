"""The permissions document: what each participant may publish, subscribe to and relay."""

from collections.abc import Iterable
from dataclasses import field
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Self
from weakref import WeakValueDictionary

from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents import _plain, _reading, _schema, _writing
from pqsec_pki.documents._xml import with_line_feeds
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.subject import parse_subject, same_subject
from pqsec_pki.errors import UsageError
from pqsec_pki.problems import Problem

if TYPE_CHECKING:
    from lxml.etree import _Element


_SPACE = " \t\r\n"


class DefaultAction(StrEnum):
    """What applies if no rule of a grant matches."""

    ALLOW = "ALLOW"
    DENY = "DENY"


@dataclass(frozen=True, slots=True, kw_only=True)
class Criteria:
    """Topics (fnmatch patterns, at least one), restricted by partitions and data tags.

    A data tag is a (name, value) pair. No partitions means the default partition in an allow
    rule. All three must match (9.4.1.3.2.3).
    """

    topics: tuple[str, ...]
    partitions: tuple[str, ...] = ()
    data_tags: tuple[tuple[str, str], ...] = ()
    line: int | None = field(default=None, compare=False, repr=False)
    """Its line in the document; None if it was not read from one."""

    def __post_init__(self) -> None:
        if not self.topics:
            raise UsageError("criteria must name at least one topic")


@dataclass(frozen=True, slots=True, kw_only=True)
class PermissionRule:
    """What is allowed, or denied, on some domains; one matching criteria suffices."""

    allow: bool
    domains: DomainSet
    publish: tuple[Criteria, ...] = ()
    subscribe: tuple[Criteria, ...] = ()
    relay: tuple[Criteria, ...] = ()
    line: int | None = field(default=None, compare=False, repr=False)
    """Its line in the document; None if it was not read from one."""

    @classmethod
    def deny_all(cls, domains: DomainSet) -> Self:
        """A rule that denies to publish and to subscribe to any topic."""
        everything = (Criteria(topics=("*",)),)
        return cls(allow=False, domains=domains, publish=everything, subscribe=everything)


@dataclass(frozen=True, slots=True)
class Spelling:
    """Values of a grant as a document may have them."""

    subject_name: str
    """With white space around it."""
    not_before: datetime
    """In a zone, as `not_after`."""
    not_after: datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class Grant:
    """What one subject may do, and when; the first rule that matches decides.

    Times are aware, and kept in UTC and whole seconds, as in a document; a fraction is dropped.
    White space around the subject name is dropped too: Fast DDS would not match it.
    UsageError for a time without a zone.
    """

    name: str
    subject_name: str
    not_before: datetime
    not_after: datetime
    rules: tuple[PermissionRule, ...] = ()
    default: DefaultAction = DefaultAction.DENY
    spelling: Spelling | None = field(default=None, compare=False, repr=False)
    """How its document has these values, if not as pqsec writes them: stacks differ then."""
    line: int | None = field(default=None, compare=False, repr=False)
    """Its line in the document; None if it was not read from one."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "subject_name", self.subject_name.strip(_SPACE))
        object.__setattr__(self, "not_before", _whole_seconds(self.not_before))
        object.__setattr__(self, "not_after", _whole_seconds(self.not_after))

    @property
    def written(self) -> Spelling:
        """Its values as its document has them; as they are, if they were changed since."""
        found, own = self.spelling, Spelling(self.subject_name, self.not_before, self.not_after)
        return found if found and _plainly(found) == own else own

    @classmethod
    def least(  # noqa: PLR0913 - one argument for each part of a grant, all by name
        cls,
        *,
        subject_name: str,
        not_before: datetime,
        not_after: datetime,
        domains: DomainSet,
        publish: Iterable[str] = (),
        subscribe: Iterable[str] = (),
        name: str | None = None,
    ) -> Self:
        """A grant that allows only to publish and subscribe to these topics on these domains.

        Without any topic the grant denies all topics, and the subject cannot join a domain
        with join access control. `name` is by default the subject name. For a second spelling
        of the subject: dataclasses.replace(grant, subject_name=...).
        UsageError for an empty subject, topic or time span.
        """
        if not subject_name.strip():
            raise UsageError("a grant needs the subject name of a certificate")
        grant = cls(
            name=subject_name.strip() if name is None else name,
            subject_name=subject_name,
            not_before=not_before,
            not_after=not_after,
            rules=(_least_rule(domains, _criteria_of(publish), _criteria_of(subscribe)),),
        )
        if grant.not_before >= grant.not_after:
            raise UsageError(f"a grant from {not_before} to {not_after} is never in force")
        return grant


@dataclass(frozen=True, slots=True, kw_only=True, weakref_slot=True)
class Permissions:
    """A permissions document (DDS-Security 1.1, 9.4.1.3)."""

    grants: tuple[Grant, ...]
    markup: tuple[Problem, ...] = ()
    """Values with markup in them, which readers read differently; each has its line."""
    is_plain: bool = field(default=False, init=False, compare=False, repr=False)
    """Whether it was read from a text in the form in which pqsec writes most of them."""

    def __post_init__(self) -> None:
        if not self.grants:
            raise UsageError("a permissions document must have at least one grant")

    def grants_for(self, subject_name: str) -> tuple[Grant, ...]:
        """The grants for the subject; MalformedError for a text that is not a subject name."""
        subject = parse_subject(subject_name)
        return tuple(
            each for each in self.grants if same_subject(parse_subject(each.subject_name), subject)
        )

    @classmethod
    def from_xml(cls, xml: bytes, *, any_markup: bool = False) -> "Permissions":
        """The permissions in the XML document.

        InvalidDocumentError if it is not XML, or breaks its schema, or has
        a year outside 1 to 9999, the hour 24 or a domain id of more than 31 bits, or, unless
        `any_markup`, markup in a value. The same XML,
        with LF or CRLF, gives the same value while one is in use: several questions about a fleet
        read it once.
        """
        xml = with_line_feeds(xml)
        found = _IN_USE.get(xml)
        if found is None:
            plain = _plain.read(xml)
            found = (
                _of_plain(plain) if plain else permissions_in_elements(xml, any_markup=any_markup)
            )
            if not found.markup:
                _IN_USE[xml] = found
        return found

    def to_xml(self) -> bytes:
        """The document in the form that every stack accepts, schema-valid UTF-8.

        UsageError for a time after the year 2261 and for a character that XML does not allow;
        InvalidDocumentError for what crashes a stack (`crashes`), and for `markup`.
        """
        return _writing.permissions_xml(self)


_IN_USE: WeakValueDictionary[bytes, Permissions] = WeakValueDictionary()
"""XML -> the permissions, of those that `from_xml` made."""


def _plainly(spelling: Spelling) -> Spelling:
    """The same, without white space and in UTC."""
    times = (each.astimezone(UTC) for each in (spelling.not_before, spelling.not_after))
    return Spelling(spelling.subject_name.strip(_SPACE), *times)


def _whole_seconds(time: datetime) -> datetime:
    if time.utcoffset() is None:
        raise UsageError(f"the time {time} has no time zone")
    try:
        return time.astimezone(UTC).replace(microsecond=0)
    except OverflowError:
        raise UsageError(f"the time {time} is outside the years 1 to 9999 in UTC") from None


def _criteria_of(topics: Iterable[str]) -> tuple[Criteria, ...]:
    each_once = tuple(dict.fromkeys(topics))
    if "" in each_once:
        raise UsageError("a topic name is empty, which crashes Cyclone DDS")
    return (Criteria(topics=each_once),) if each_once else ()


def _least_rule(
    domains: DomainSet, publish: tuple[Criteria, ...], subscribe: tuple[Criteria, ...]
) -> PermissionRule:
    if publish or subscribe:
        return PermissionRule(allow=True, domains=domains, publish=publish, subscribe=subscribe)
    return PermissionRule.deny_all(domains)


def _of_plain(text: _plain.PlainText) -> Permissions:
    actions = ((text.publish, text.publish_line), (text.subscribe, text.subscribe_line))
    publish, subscribe = (
        (Criteria(topics=topics, line=line),) if topics else () for topics, line in actions
    )
    rule = PermissionRule(
        allow=True,
        domains=DomainSet(parts=text.domains),
        publish=publish,
        subscribe=subscribe,
        line=_plain.RULE_LINE,
    )
    grant = Grant(
        name=text.name,
        subject_name=text.subject,
        not_before=text.not_before,
        not_after=text.not_after,
        rules=(rule,),
        line=_plain.GRANT_LINE,
    )
    found = Permissions(grants=(grant,))
    object.__setattr__(found, "is_plain", True)
    return found


def permissions_in_elements(xml: bytes, *, any_markup: bool = False) -> Permissions:
    """Like `Permissions.from_xml`, with the XML parser and the schema, for any form."""
    # The schema fixes the number and order of the children, so they are found by position.
    root, markup = _schema.read(xml, _schema.Kind.PERMISSIONS, any_markup=any_markup)
    return Permissions(grants=tuple(map(_grant, root[0])), markup=markup)


def _grant(element: "_Element") -> Grant:
    subject_name, validity, *rules, default = element
    written = Spelling(_reading.text(subject_name), *map(_reading.instant, validity))
    plain = _plainly(written)
    is_plain = (written, written.not_before.tzinfo, written.not_after.tzinfo) == (plain, UTC, UTC)
    return Grant(
        name=element.get("name", ""),
        subject_name=plain.subject_name,
        not_before=plain.not_before,
        not_after=plain.not_after,
        rules=tuple(map(_rule, rules)),
        default=DefaultAction(_reading.text(default)),
        spelling=None if is_plain else written,
        line=_reading.line(element),
    )


def _rule(element: "_Element") -> PermissionRule:
    domains, *actions = element

    def all_criteria(action: str) -> tuple[Criteria, ...]:
        return tuple(_criteria(child) for child in actions if child.tag == action)

    return PermissionRule(
        allow=element.tag == "allow_rule",
        domains=_reading.domains(domains),
        publish=all_criteria("publish"),
        subscribe=all_criteria("subscribe"),
        relay=all_criteria("relay"),
        line=_reading.line(element),
    )


def _criteria(element: "_Element") -> Criteria:
    parts = {child.tag: child for child in element}  # in any order, each at most once
    return Criteria(
        topics=_reading.texts(parts["topics"]),
        partitions=_reading.texts(parts["partitions"]) if "partitions" in parts else (),
        data_tags=_data_tags(parts["data_tags"]) if "data_tags" in parts else (),
        line=_reading.line(element),
    )


def _data_tags(element: "_Element") -> tuple[tuple[str, str], ...]:
    """Its (name, value) pairs; a tag with several pairs means the same as several tags."""
    pairs: list[tuple[str, str]] = []
    for tag in element:
        words = _reading.texts(tag)
        pairs.extend(zip(words[::2], words[1::2], strict=True))
    return tuple(pairs)
