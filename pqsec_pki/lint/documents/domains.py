"""Rules about domain IDs and ranges of domains."""

from collections.abc import Iterator

from pqsec_pki.documents import Node
from pqsec_pki.lint.document import Document
from pqsec_pki.lint.rule import CYCLONE, FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR = Severity.ERROR
MAX_DOMAIN = 230
_CYCLONE = Stack.CYCLONEDDS


def _number(node: Node | None) -> int | None:
    text = node.value.lstrip("+") if node else ""
    return (
        int(text) if text.isascii() and text.isdigit() and len(text) < len(f"{1 << 64}") else None
    )


@lint_rule(
    "PQS231", ERROR, "a range of domains without an end",
    why="Cyclone DDS and Fast DDS read <min>0</min> alone as domain 0 only, against the standard."
    " OpenDDS and Connext read it as all domains from 0 on.",
    fix=f"Add <max>, at most {MAX_DOMAIN}.",
    stacks={**CYCLONE, **FAST, Stack.ROS2: ""},
    rows=("id_range with only `<min>0` on domain 16",),
    bad="""
        <domains>
          <id_range><min>0</min></id_range>
        </domains>
    """,
    good="""
        <domains>
          <id_range><min>0</min><max>9</max></id_range>
        </domains>
    """,
)  # fmt: skip
def open_range(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        if node.child("min") and not node.child("max"):
            yield document.at(node, "the range has no <max>: these stacks read only its <min>")


@lint_rule(
    "PQS232", ERROR, "a range of domains without a start",
    why="Permissions with it crash Cyclone DDS, also that of peers. Cyclone DDS refuses governance"
    " with it.",
    fix="Add <min>0</min>.",
    stacks=CYCLONE, rows=("id_range with only `<max>`",),
    bad="""
        <domains>
          <id_range><max>9</max></id_range>
        </domains>
    """,
    good="""
        <domains>
          <id_range><min>0</min><max>9</max></id_range>
        </domains>
    """,
)  # fmt: skip
def range_without_start(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        if node.child("max") and not node.child("min"):
            yield document.at(node, "the range has no <min>, which crashes Cyclone DDS")


@lint_rule(
    "PQS233", ERROR, f"a domain above {MAX_DOMAIN}",
    why="Cyclone DDS refuses the whole document, because RTPS has no ports for such a domain.",
    fix=f"Use domains from 0 to {MAX_DOMAIN}.",
    stacks=CYCLONE, rows=("domain id/max 231, 232",),
    bad="<domains><id>231</id></domains>",
    good="<domains><id>230</id></domains>",
)  # fmt: skip
def domain_too_high(document: Document) -> Iterator[Violation]:
    for node in document.all("id", "min", "max"):
        number = _number(node)
        if number is None and node.value.isdigit():
            number = MAX_DOMAIN + 1
        if number is not None and number > MAX_DOMAIN:
            yield document.at(node, f"domain {node.value[:20]} is above {MAX_DOMAIN}")


@lint_rule(
    "PQS234", ERROR, "an empty range of domains",
    why="<min> is greater than <max>: the rule applies to no domain.",
    fix="Swap <min> and <max>.",
    bad="""
        <domains>
          <id_range><min>9</min><max>0</max></id_range>
        </domains>
    """,
    good="""
        <domains>
          <id_range><min>0</min><max>9</max></id_range>
        </domains>
    """,
)  # fmt: skip
def empty_range(document: Document) -> Iterator[Violation]:
    for node in document.all("id_range"):
        first, last = _number(node.child("min")), _number(node.child("max"))
        if first is not None and last is not None and first > last:
            yield document.at(node, f"no domain is between {first} and {last}")
