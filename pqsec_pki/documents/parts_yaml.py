"""Parts of a policy in YAML, for a file of another room that holds some.

What parses YAML safely, and what reads a value and says with its line what is wrong with
it; above that whole parts: domains, a governance, the rules of a grant.
"""

from pqsec_pki.documents._domains_yaml import domains
from pqsec_pki.documents._rules_yaml import ALLOWED, Readers
from pqsec_pki.documents._yaml import Item, Items, Table, Text, refused
from pqsec_pki.documents._yaml_guesses import guess
from pqsec_pki.documents._yaml_reading import (
    all_of,
    boolean,
    build,
    chosen,
    each,
    fields,
    one_of,
    one_or_more,
    peeked,
    read,
    table,
    text,
    told,
)
from pqsec_pki.documents.governance_yaml import governance_in
from pqsec_pki.documents.permissions_yaml import duration, rules_in

__all__ = [  # what another room takes from here is defined elsewhere
    "ALLOWED",
    "Item",
    "Items",
    "Readers",
    "Table",
    "Text",
    "all_of",
    "boolean",
    "build",
    "chosen",
    "domains",
    "duration",
    "each",
    "fields",
    "governance_in",
    "guess",
    "one_of",
    "one_or_more",
    "peeked",
    "read",
    "refused",
    "rules_in",
    "table",
    "text",
    "told",
]
