"""What lint says of markup is what the stacks' own parsers do: each case is given to both.

Documents as other programs may sign them: well-formed, valid by the schema where that looks at
such things at all, with the same values. A case that a stack refuses is a finding for it, and a
case that it takes is none.
"""

import re
import shutil

import pytest

from pqsec_pki.access import Action, Question
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Grant, Permissions
from pqsec_pki.lint import Severity, check
from pqsec_pki.stacks import Stack
from tests.interop import cyclone_access, fastdds_access
from tests.interop.test_decisions import DAY, SUBJECT

pytestmark = pytest.mark.interop

ABOUT_MARKUP = {"PQS203", "PQS204", "PQS206", "PQS207", "PQS278", "PQS279"}
TAKEN = frozenset()
CYCLONE, OLD_CYCLONE, FAST = map(frozenset, (("0.10.2", "11.0.1"), ("0.10.2",), ("2.9.1",)))
"""The versions that refuse a case."""
DECLARATION = '<?xml version="1.0" encoding="UTF-8"?>'
ROOT = re.compile("<dds[^>]*>")
TOPICS, TOPIC = "<topics>", "<topic>a<"
RULE = "<topic_rule>"


def instead(old, new):
    """`new` for the first `old`, which must be there."""

    def change(text):
        assert old in text, old
        return text.replace(old, new, 1)

    return change


def root(old, new):
    """A change of the root's tag alone."""
    return lambda text: ROOT.sub(lambda tag: instead(old, new)(tag[0]), text, count=1)


def behind(change_of_tag):
    """Something after the tag of the root."""
    return lambda text: ROOT.sub(lambda tag: tag[0] + change_of_tag, text, count=1)


def before_root(what):
    """Something before the root element."""
    return lambda text: ROOT.sub(lambda tag: f"{what}{tag[0]}", text, count=1)


def at_end(what):
    """Something after the root element."""
    return lambda text: text + what


BOTH = {
    "as pqsec writes it": (TAKEN, lambda text: text),
    "without declaration": (TAKEN, instead(DECLARATION + "\n", "")),
    "declared in single quotes": (TAKEN, instead(DECLARATION, DECLARATION.replace('"', "'"))),
    "standalone": (TAKEN, instead("?>", " standalone='yes'?>")),
    "XML 1.1": (TAKEN, instead('"1.0"', '"1.1"')),
    "declared ISO-8859-1": (TAKEN, instead("UTF-8", "ISO-8859-1")),
    "a byte order mark": (CYCLONE, lambda text: "\ufeff" + text),
    "CR LF": (TAKEN, lambda text: text.replace("\n", "\r\n")),
    "one line": (TAKEN, lambda text: text.replace("\n", "")),
    "indented with tabs": (TAKEN, lambda text: text.replace("\n<", "\n\t\t<")),
    "a comment before the root": (TAKEN, before_root("<!-- a -->")),
    "a comment first in the root": (TAKEN, behind("<!-- a -> <b> -->")),
    "a comment after the root": (TAKEN, at_end("<!-- ñ -->\n")),
    "an instruction before the root": (TAKEN, before_root("<?a b>c?>\n")),
    "an instruction before a comment": (TAKEN, before_root("<?a?>\n<!-- b -->\n")),
    "an instruction after a comment": (FAST, before_root("<!-- a --><?b?>")),
    "an instruction first in the root": (FAST, behind("<?a?>")),
    "an instruction last in the root": (FAST, instead("</dds>", "<?a b?></dds>")),
    "an instruction after the root": (FAST, at_end("<?a b?>\n")),
    "a section first in the root": (CYCLONE, behind("<![CDATA[ ]]>")),
    "a reference first in the root": (CYCLONE, behind("&#10;")),
    "space in the root's end": (CYCLONE, instead("</dds>", "</dds\n>")),
    "space in the root's tag": (TAKEN, root(">", " >")),
    "lines in the root's tag": (TAKEN, root(" xsi", "\n\txsi")),
    "single quotes": (TAKEN, lambda text: ROOT.sub(lambda tag: tag[0].replace('"', "'"), text)),
    "spaces around =": (TAKEN, root("=", " = ")),
    "no attributes": (TAKEN, lambda text: ROOT.sub("<dds>", text)),
    "> in an attribute": (TAKEN, root("http://www.omg.org", "a>b")),
    "references in an attribute": (TAKEN, root("http://www.omg.org", "&amp;&#65;&#x41;")),
    "a long reference in an attribute": (CYCLONE, root("http://www.omg", "&#000000000000065;")),
    "another prefix": (CYCLONE, lambda text: ROOT.sub(lambda t: t[0].replace("xsi", "x"), text)),
    "a namespace declared": (CYCLONE, root(">", ' xmlns:a="urn:a">')),
    "no namespace declared": (CYCLONE, root(">", ' xmlns="">')),
    "xsi:schemaLocation": (CYCLONE, root(">", ' xsi:schemaLocation="a b">')),
    "xml:lang": (CYCLONE, root(">", ' xml:lang="en">')),
    "xml:space": (CYCLONE, root(">", ' xml:space="preserve">')),
    "an attribute in a namespace": (CYCLONE, root(">", ' xmlns:a="urn:a" a:b="c">')),
    "a plain attribute": (CYCLONE, root(">", ' version="1.1">')),
    "a default namespace": (CYCLONE, root(">", ' xmlns="urn:a">')),
}
IN_GOVERNANCE = {
    "a comment last in the root": (FAST, instead("</dds>", "<!-- a --></dds>")),
    "a section last in the root": (CYCLONE | FAST, instead("</dds>", "<![CDATA[ ]]></dds>")),
    "a reference last in the root": (CYCLONE | FAST, instead("</dds>", "&#10;</dds>")),
    "a comment last in a rule": (TAKEN, instead("</topic_rule>", "<!-- a --></topic_rule>")),
    "space in a container's tag": (TAKEN, instead(RULE, "<topic_rule\n>")),
    "space in a value's end": (CYCLONE, instead("</topic_expression>", "</topic_expression >")),
}
IN_PERMISSIONS = {
    "a comment last in the root": (TAKEN, instead("</dds>", "<!-- a --></dds>")),
    "a comment between values": (TAKEN, instead("</topic>", "</topic><!-- a --><!-- b -->")),
    "an instruction between values": (FAST, instead("</topic>", "</topic><?a b?>")),
    "a section between values": (CYCLONE, instead("</topic>", "</topic><![CDATA[]]>")),
    "a section last in a container": (CYCLONE, instead("</topics>", "<![CDATA[\n]]></topics>")),
    "a reference between values": (CYCLONE, instead("</topic>", "</topic>&#x20;")),
    "a reference last in a container": (CYCLONE, instead("</topics>", "&#9;</topics>")),
    "space in a value's tag": (TAKEN, instead("<topic>", "<topic\t>")),
    "space in a value's end": (CYCLONE, instead("</topic>", "</topic >")),
    "space in a container's end": (CYCLONE, instead("</topics>", "</topics\n>")),
    "space in an empty tag": (
        TAKEN,
        instead("</publish>", "<partitions><partition\n/><partition></partition></partitions>"
                "</publish>"),
    ),
    "a namespace in a container": (CYCLONE, instead(TOPICS, '<topics xmlns:a="urn:a">')),
    "a namespace in a value": (CYCLONE, instead("<topic>", '<topic xmlns:a="urn:a">')),
    "no namespace in a container": (CYCLONE, instead(TOPICS, '<topics xmlns="">')),
    "xsi again": (
        TAKEN,
        instead(TOPICS, '<topics xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">'),
    ),
    "the schema again": (TAKEN, instead(TOPICS, "<topics xsi:noNamespaceSchemaLocation='a.xsd'>")),
    "a name in single quotes": (TAKEN, instead('name="CN=/lab/alice"', "name='a\"b>c'")),
    "a reference for a letter": (TAKEN, instead(TOPIC, "<topic>&#97;<")),
    "the longest reference": (TAKEN, instead(TOPIC, "<topic>&#00000000000097;<")),
    "a longer reference": (CYCLONE, instead(TOPIC, "<topic>&#000000000000097;<")),
    "a longer hexadecimal one": (CYCLONE, instead(TOPIC, "<topic>&#x00000000000061;<")),
    "entities": (TAKEN, instead(TOPIC, "<topic>&lt;&gt;&amp;&quot;&apos;</topic><topic>a<")),
    "> in a value": (TAKEN, instead(TOPIC, "<topic>b>c</topic><topic>a<")),
    "no ASCII": (TAKEN, instead(TOPIC, "<topic>ñ\U0001f916</topic><topic>a<")),
    "a long value": (TAKEN, instead(TOPIC, f"<topic>{'b' * 5000}</topic><topic>a<")),
    "a quote": (CYCLONE, instead(TOPIC, '<topic>"b</topic><topic>a<')),
    "an apostrophe after space": (CYCLONE, instead(TOPIC, "<topic> 'b</topic><topic>a<")),
    "a typographic quote": (OLD_CYCLONE, instead(TOPIC, "<topic>\u201cb</topic><topic>a<")),
    "a typographic quote by reference": (TAKEN, instead(TOPIC, "<topic>&#8220;b</topic><topic>a<")),
    "a typographic apostrophe": (OLD_CYCLONE, instead(TOPIC, "<topic>\u2018b</topic><topic>a<")),
    "another typographic quote": (TAKEN, instead(TOPIC, "<topic>\u201eb\u201d</topic><topic>a<")),
    "a quote that ends": (TAKEN, instead(TOPIC, '<topic>"b"c</topic><topic>a<')),
    "a quote that ends elsewhere": (
        TAKEN,
        instead(TOPIC, '<topic>"b</topic><topic>a"</topic><topic>a<'),
    ),
    "an & before the end of a quote": (
        CYCLONE,
        instead(TOPIC, '<topic>"b</topic><!-- & --><topic>a"</topic><topic>a<'),
    ),
    "a quote inside": (TAKEN, instead(TOPIC, "<topic>b\"c'd</topic><topic>a<")),
    "a quote written &quot;": (TAKEN, instead(TOPIC, "<topic>&quot;b</topic><topic>a<")),
    "100,000 spaces": (TAKEN, instead(TOPICS, TOPICS + " " * 100_000)),
    "a long comment": (TAKEN, instead(TOPICS, f"{TOPICS}<!--{'x' * 100_000}-->")),
}  # fmt: skip
CASES = [
    *(("governance", name, *case) for name, case in (BOTH | IN_GOVERNANCE).items()),
    *(("permissions", name, *case) for name, case in (BOTH | IN_PERMISSIONS).items()),
]
WITNESSES = {
    "cyclonedds 0.10": (Stack.CYCLONEDDS, "0.10.2", "plugins", cyclone_access),
    "cyclonedds 11": (Stack.CYCLONEDDS, "11.0.1", "plugins_11", cyclone_access),
    "fastdds 2.9": (Stack.FASTDDS, "2.9.1", "fastdds", fastdds_access),
}

ALL = [version for _, version, *_ in WITNESSES.values()]


@pytest.fixture(scope="module")
def documents(now):
    """Both documents, in which alice may publish `a` and nothing else."""
    everywhere = DomainSet.of(DomainRange(first=0, last=10))
    grant = Grant.least(
        subject_name=SUBJECT,
        not_before=now - DAY,
        not_after=now + DAY,
        domains=everywhere,
        publish=["a"],
    )
    return {
        "governance": Governance.protected(everywhere).to_xml().decode(),
        "permissions": Permissions(grants=(grant,)).to_xml().decode(),
    }


@pytest.fixture(params=WITNESSES.values(), ids=WITNESSES)
def witness(request, labs, tmp_path, now):
    """The stack, and witness(documents): why its plugin takes no such documents; else empty."""
    stack, version, installed, module = request.param
    library, lab = request.getfixturevalue(installed), labs("classical")
    folder = shutil.copytree(lab.alice, tmp_path / "alice")

    def witness(given):
        for kind, text in given.items():
            (folder / f"{kind}.p7s").write_bytes(lab.sign(text.encode()))
        with module.access_control(library, folder, 0) as plugin:
            question = Question(
                subject=SUBJECT, domain=0, action=Action.PUBLISH, topic="a", now=now
            )
            return plugin.own(question) or plugin.peer(question)

    witness.stack, witness.version = stack, version
    return witness


def found_for(witness, kind, text, folder, now):
    """The errors of lint about markup in that document, for that stack and version."""
    path = folder / f"{kind}.xml"
    path.write_bytes(text.encode())
    report = check([path], now=now, targets=[witness.stack])
    errors = [each for each in report.findings if each.severity is Severity.ERROR]
    found = [each for each in errors if each.rule.id in ABOUT_MARKUP]
    assert all(each.line for each in found)
    return [each for each in found if witness.version in (each.stacks[witness.stack] or ALL)]


def test_a_stack_reads_what_lint_says_that_it_reads(witness, documents, tmp_path, now):
    wrong = []
    for kind, name, refusing, change in CASES:
        text, refuses = change(documents[kind]), witness.version in refusing
        refusal = witness(documents | {kind: text})
        found = found_for(witness, kind, text, tmp_path, now)
        if (bool(refusal), bool(found)) != (refuses, refuses):
            wrong.append(f"{kind}: {name}: {refusal or 'taken'}; {[*map(str, found)]}")
    assert not wrong, "\n".join(wrong)
