"""Valid documents that end the process of a stack: signing refuses them, and questions say so.

`tests/interop/test_crashes.py` asks the stacks themselves.
"""

from dataclasses import replace

import pytest

from pqsec_pki.access import INTERPRETATIONS
from pqsec_pki.documents import CRASH_SHAPES, DomainRange, Governance, Permissions
from pqsec_pki.errors import InvalidDocumentError
from tests.crashing import CRASHING, GOVERNANCE, PERMISSIONS, spoiled


@pytest.mark.parametrize("case", CRASHING)
def test_what_crashes_a_stack_is_not_written(case):
    """Whatever signs a document writes it with `to_xml`."""
    kind, line = CRASHING[case].kind, CRASHING[case].line
    with pytest.raises(InvalidDocumentError, match="crashes Cyclone DDS") as refused:
        kind.from_xml(CRASHING[case].xml).to_xml()
    [problem] = refused.value.problems
    assert problem.line == line


def test_the_same_documents_without_it_are_written():
    assert Permissions.from_xml(PERMISSIONS).to_xml()
    assert Governance.from_xml(GOVERNANCE).to_xml()


def test_an_empty_topic_to_relay_crashes_no_stack_that_was_run():
    empty = spoiled(PERMISSIONS, b"<relay><topics><topic>rt/r</topic>", b"rt/r", b"")
    assert Permissions.from_xml(empty).to_xml()


def test_governance_with_a_range_without_min_is_written_with_it():
    """Cyclone DDS refuses it, and does not crash."""
    xml = GOVERNANCE.replace(b"<min>0</min>", b"")
    governance = Governance.from_xml(xml)
    assert b"<min>0</min>" in governance.to_xml()
    [part] = governance.domain_rules[0].domains.parts
    assert part == replace(DomainRange(first=0, last=9), no_min=True)


def test_every_shape_names_versions_that_an_interpretation_is_for():
    for shape in CRASH_SHAPES:
        rows = [row.name for row in INTERPRETATIONS if shape.crashes(row.stack, row.version)]
        assert {"cyclonedds@0.10", "cyclonedds@11.0"} <= {*rows}
        assert not shape.crashes("cyclonedds", "1")
        assert not shape.crashes("opendds")
