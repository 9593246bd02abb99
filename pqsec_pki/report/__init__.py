"""The report of a keystore: who may do what, until when, by which cryptography, and what changed.

    values      the sections of a report, as values
    collecting  makes a report of a keystore
    rights      who may use which topic; participants with the same rights are one group
    _names      finds such groups, and topics that differ only in the name of a participant
    dates       what ends when
    quantum     what a quantum computer would break
    history     what the ledger has, command by command
    comparing   what changed since an earlier report
    page        the report as one HTML file
    picture     its matrix, and its picture of participants and topics
    signature   the signed statement beside a report
    rows        the report as CSV

Nothing is decided here: the rooms `policy`, `lint`, `keystore` and `migration` are asked.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.report.collecting import report_of
    from pqsec_pki.report.comparing import Changes, EarlierReport, changes_since, read_earlier
    from pqsec_pki.report.page import html_of
    from pqsec_pki.report.rows import csv_of
    from pqsec_pki.report.signature import (
        MAX_REPORT,
        refuse_changed,
        signature_path,
        statement_of,
    )
    from pqsec_pki.report.values import Report
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MAX_REPORT",
    "Changes",
    "EarlierReport",
    "Report",
    "changes_since",
    "csv_of",
    "html_of",
    "read_earlier",
    "refuse_changed",
    "report_of",
    "signature_path",
    "statement_of",
]
