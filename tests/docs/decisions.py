"""How the standard and the stacks decide: the rows of docs/reference/decisions.md.

tests/docs/test_questions.py asks each a question on which they differ.
"""

from collections.abc import Iterator

from pqsec_pki.access import INTERPRETATIONS
from tests.docs.rows import table

ABOUT = """By the standard (DDS-Security 1.1, 9.4) and by the interpretation of each stack. Cyclone
DDS and Fast DDS were measured through their own access control; of OpenDDS, the source was read.
Cyclone DDS 11.0.1 is upstream's tag of that name (`e54e991f7`), run on 2026-11-28; 11.0.0 has the
same access control. In 11.0 the check of the topic changed (`5ac329b05`), and spaces in subject
names are ignored (`5e0dfea02`). 11.0.1 gave all 6,096 answers as in its column; 132 of them, all
yes, are no in 0.10.2. On 2026-11-28, generated documents were given to the three plugins (7,296
pairs, in many spellings): all 1,788,784 answers were those of the interpretation, or are explained
below. `python -m tests.fuzz.differential policies` repeats it.
The columns are as in the locale C. In C.UTF-8, `?` and `[!a]` of the standard and of Fast DDS also
cover a character of several octets, such as é
([ADR 46](../explanation/adr/0046-the-locale-of-matching.md)).
[Querying a policy](../how-to/questions.md) shows the commands that use these interpretations."""
WRITTEN = """## How a document is written

What pqsec signs is in a form that every stack reads. Of other documents that match their schemas,
these are refused as a whole by a stack, and `pqsec check` names them. The interpretations above do
not say so: they answer by what the document means.

- Cyclone DDS: a byte order mark; an attribute other than `name` of a grant, `xmlns:xsi` and
  `xsi:noNamespaceSchemaLocation`; white space in an end tag, such as `</topic >`.
- Fast DDS: a processing instruction; a comment directly before `</dds>`; white space around a
  boolean.

pqsec refuses what readers read differently: markup in a value, and a domain id with leading zeros,
which Cyclone DDS reads as octal (`010` is 8)."""
ROWS = (
    (
        "The grant is for",
        "the whole name, in any spelling and either order",
        "every name whose parts are all in it: `CN=/robot` may use a grant for `CN=/robot/admin`",
        "as before, also with other spaces around `,` and `=`",
        "the same parts, last one of the certificate first",
        "the same parts, first one of the certificate first",
    ),
    (
        "Of several grants",
        "the first",
        "the first",
        "the first",
        "the first in force",
        "the first",
    ),
    (
        "A grant is in force",
        "between its times",
        "between its times, if they are in 1970 to 2262",
        "between its times, if they are in 1970 to 2262",
        "as local time",
        "only for endpoints of topics that governance does not open; joining ignores the times",
    ),
    (
        "A range of domains without an end",
        "has no end",
        "is its first domain",
        "is its first domain",
        "is its first domain",
        "has no end",
    ),
    (
        "A domain above 230",
        "is a domain",
        "the documents are refused",
        "the documents are refused",
        "is a domain",
        "is a domain",
    ),
    (
        "Joining requires",
        "an allow rule for the domain, or the default `ALLOW`",
        "an allow rule for the domain, or the default `ALLOW`",
        "an allow rule for the domain, or the default `ALLOW`",
        "of the own stack any allow rule, of peers one for the domain; never the default",
        "of the own stack that something is open; of peers as the standard",
    ),
    (
        "A domain that no governance rule names",
        "cannot be joined",
        "cannot be joined",
        "cannot be joined",
        "can be joined, but no topic used",
        "cannot be joined",
    ),
    (
        "A time in a zone",
        "is that instant",
        "is that instant; beyond 12:00 from UTC it is long past",
        "is that instant; beyond 12:00 from UTC it is long past",
        "is read as if it had no zone",
        "is that instant",
    ),
    (
        "White space around a topic or partition",
        "belongs to it",
        "is removed",
        "is removed",
        "belongs to it",
        "belongs to it (not measured)",
    ),
    (
        "A line end around a subject_name",
        "is removed",
        "is removed",
        "is removed",
        "belongs to it: no participant has that name",
        "is removed (not measured)",
    ),
    (
        "An unclosed bracket",
        "is a `[`",
        "covers nothing",
        "covers nothing",
        "is a `[`",
        "is read past its end: the result is undefined, here it is no",
    ),
    (
        "The topic itself",
        "is not checked",
        "is checked first, for any action and partition: a deny_rule for a partition denies it",
        "is checked first; denied if the first rules for publishing and for subscribing deny it",
        "is not checked",
        "is checked first; denied if publishing and subscribing both are",
    ),
    (
        "Default of a grant",
        "applies",
        "applies",
        "applies",
        "is ignored",
        "applies",
    ),
    (
        "Criteria of a rule",
        "are separate",
        "are separate",
        "are separate",
        "the topic of one and the partition of another match together",
        "are separate",
    ),
    (
        "A deny rule with partitions",
        "denies in these",
        "see above",
        "see above",
        "denies in all",
        "denies in these",
    ),
    (
        "A deny rule without partitions",
        "denies in all",
        "denies in the default one, but see above",
        "denies in the default one, but see above",
        "denies in all",
        "denies in all",
    ),
    (
        "Partitions of an endpoint",
        "are expressions, like those of a rule",
        "are compared literally, including wildcards",
        "are compared literally, including wildcards",
        "are compared literally, including wildcards",
        "are compared literally, including wildcards",
    ),
    (
        "An allow rule with partitions, an endpoint without",
        "no",
        "no",
        "no",
        "no",
        "yes",
    ),
    (
        "Data tags",
        "are checked",
        "are ignored",
        "are ignored",
        "are ignored",
        "are ignored",
    ),
    (
        "Relaying",
        "is an action",
        "is never allowed by a rule",
        "is never allowed by a rule",
        "is like subscribing, for peers",
        "is never allowed by a rule",
    ),
    (
        "`\\*` in a pattern",
        "is a `*`",
        "is a `\\` and any text",
        "is a `\\` and any text",
        "is a `\\` and any text",
        "is a `*`",
    ),
    (
        "`[^a]` in a pattern",
        "is all but `a`",
        "is `^` or `a`",
        "is `^` or `a`",
        "is all but `a`",
        "is `^` or `a`",
    ),
    (
        "`*ab` and the topic `aab`",
        "covered",
        "covered",
        "covered",
        "covered",
        "not covered",
    ),
    (
        "`topic_expression` of governance",
        "covers topics",
        "covers topics",
        "covers topics",
        "covers topics, and is covered by a topic that is a pattern",
        "covers topics",
    ),
    (
        "A topic with a builtin name, `DCPSTopic`",
        "is a topic",
        "is open to all members",
        "is open to all members",
        "is a topic",
        "is a topic",
    ),
)
"""Of what, and how it is with each of INTERPRETATIONS."""


def parts() -> Iterator[str]:
    """The title, and what follows it."""
    heads = ("", "Standard", *(each.title for each in INTERPRETATIONS[1:]))
    yield from ("# Access decisions: how stacks differ", ABOUT, table(heads, ROWS), WRITTEN)
