"""What is told of real documents: the rules each of them breaks, one by one.

After a change of the rules `PQSEC_GOLDEN=write` rewrites lint_corpus.json: read the
difference before it is kept.
"""

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.lint import check
from tests.vectors.test_corpus import CORPUS, ENTRIES

GOLDEN = Path(__file__).parent / "lint_corpus.json"
NOW = datetime(2026, 6, 1, tzinfo=UTC)
BROKEN = {"PQS201", "PQS202", "PQS203", "PQS208", "PQS209", "PQS211", "PQS219", "PQS264", "PQS331"}


def told(entry):
    return check([CORPUS / entry["file"]], now=NOW).findings


def ids(findings):
    return sorted({each.rule.id for each in findings})


def test_of_each_document_the_rules_are_told_that_it_breaks():
    found = {entry["file"]: ids(told(entry)) for entry in ENTRIES}
    if os.environ.get("PQSEC_GOLDEN") == "write":
        lines = (f"  {json.dumps(file)}: {json.dumps(rules)}" for file, rules in found.items())
        GOLDEN.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    assert json.loads(GOLDEN.read_text()) == found


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["file"])
def test_what_the_schema_refuses_is_told_and_what_it_takes_can_be_read(entry):
    broken = {each.rule.id for each in told(entry)} & BROKEN
    if entry["xsd_valid"]:
        assert not broken - {"PQS211"}  # 1 is a boolean of the schema, and a warning here
    else:
        assert broken
