"""Parts of a policy in YAML, for another room's file that contains some.

Functions that parse YAML safely, that read a value and report errors with its line, and that
read and write whole parts: domains, a governance, the rules of a grant.
"""

from pqsec_pki.documents._domains_yaml import domains, domains_as_yaml, domains_read_alike
from pqsec_pki.documents._node_words import node_as_yaml
from pqsec_pki.documents._rules_yaml import ALLOWED, Readers, rules_as_yaml
from pqsec_pki.documents._yaml import (
    Item,
    Items,
    Text,
    YamlMapping,
    dump,
    refuse_unseen_ends,
    refused,
)
from pqsec_pki.documents._yaml_guesses import guess
from pqsec_pki.documents._yaml_reading import (
    all_of,
    boolean,
    build,
    chosen,
    each,
    fields,
    number,
    one_of,
    one_or_more,
    peeked,
    read,
    readable_problems,
    table,
    text,
)
from pqsec_pki.documents.governance_yaml import governance_as_yaml, governance_in
from pqsec_pki.documents.permissions_yaml import duration, rules_in

__all__ = [  # defined in other modules, for other rooms
    "ALLOWED",
    "Item",
    "Items",
    "Readers",
    "Text",
    "YamlMapping",
    "all_of",
    "boolean",
    "build",
    "chosen",
    "domains",
    "domains_as_yaml",
    "domains_read_alike",
    "dump",
    "duration",
    "each",
    "fields",
    "governance_as_yaml",
    "governance_in",
    "guess",
    "node_as_yaml",
    "number",
    "one_of",
    "one_or_more",
    "peeked",
    "read",
    "readable_problems",
    "refuse_unseen_ends",
    "refused",
    "rules_as_yaml",
    "rules_in",
    "table",
    "text",
]
