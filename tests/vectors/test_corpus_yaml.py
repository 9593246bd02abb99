"""Real documents as YAML: no value is lost."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.documents import (
    Governance,
    Kind,
    Permissions,
    governance_from_yaml,
    governance_to_yaml,
    permissions_from_yaml,
    permissions_to_yaml,
)
from tests.vectors.test_corpus import written, xml_in

NOW = datetime(2026, 11, 21, tzinfo=UTC)
WAYS = {
    Kind.GOVERNANCE: (Governance, governance_to_yaml, governance_from_yaml),
    Kind.PERMISSIONS: (
        Permissions,
        permissions_to_yaml,
        lambda data: permissions_from_yaml(data, now=NOW),
    ),
}


@pytest.mark.parametrize("entry", written())
def test_a_valid_document_is_written_as_yaml_and_read_as_equal_values(entry):
    values, write, read = WAYS[entry["kind"]]
    value = values.from_xml(xml_in(entry["file"]))
    assert read(write(value)) == value
    assert values.from_xml(read(write(value)).to_xml()) == value
