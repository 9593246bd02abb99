"""Rules that find nothing in permissions in the form in which pqsec writes most of them.

`Permissions.is_plain` recognises them. `tests/property/test_lint_plain.py` makes documents of that
form and runs the rules on them.
"""

NEVER_IN_PLAIN = frozenset(
    f"PQS{number}"
    for numbers in (
        range(201, 207),  # how the XML is written
        range(208, 214),
        range(215, 221),
        range(231, 240),  # domains and patterns
        range(241, 244),
        range(251, 262),  # deny_rules, partitions, a second grant, a default ALLOW
        range(263, 267),  # how times are written
        range(269, 278),
        range(411, 426),  # how the subject is written
    )
    for number in numbers
)
"""The rules about permissions that find nothing in such a document."""
