"""Rules about keystores with several sets of credentials."""

from collections.abc import Iterator

from pqsec_pki.keystore import faults_of_sets
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory


@lint_rule(
    "PQS010", Severity.ERROR, "the sets of credentials of a keystore differ",
    why="A participant has the same rights in every set. Where one lacks it, or has others,"
    " it depends on the peer what it may do, or whether it is met at all.",
    fix="Issue the participant again, in all sets: `pqsec issue NAME --force` with all its rights."
    " `pqsec sign-governance` signs the governance in all sets, `pqsec ca crl` issues all lists.",
    bad="""
        $ pqsec -k k ca add-set hybrid
        $ mv k/sets/hybrid/enclaves/talker elsewhere/
    """,
    good="$ pqsec -k k issue /talker --publish chatter --force",
)  # fmt: skip
def different_sets(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore:
        for path, words in faults_of_sets(inventory.keystore):
            yield Violation(words, path=path)
