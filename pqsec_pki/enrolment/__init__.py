"""Enrolment: a robot generates its keys, requests a certificate, and installs the answer.

For the commands on the robot (request, install, rollback) and on the CA machine
(issue --csr, bundle, sign-request). A bundle is the one file that goes to a robot.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.enrolment.bundle import Bundle, bundle_path, flat_name, save
    from pqsec_pki.enrolment.bundle_file import BundleFile, write_bundles
    from pqsec_pki.enrolment.credential_store import (
        CredentialStore,
        InstalledCredentials,
        changing,
        is_credential_store,
        one_command,
    )
    from pqsec_pki.enrolment.csr_validation import NAMELESS, name_asked_for, validate_csrs
    from pqsec_pki.enrolment.installed_enclaves import problems_where_installed
    from pqsec_pki.enrolment.installing import Installed, install, removed_alone, require_trust
    from pqsec_pki.enrolment.issuing import IssuedBundle, bundle_paths, issue_with_bundles
    from pqsec_pki.enrolment.offline import (
        Accepted,
        SignRequest,
        accept,
        answered,
        ordered,
        refuse_large_answer,
        same_answers,
        sign,
    )
    from pqsec_pki.enrolment.outbox import refresh
    from pqsec_pki.enrolment.pins import Pins, pin_texts, pins_in_use, pins_of
    from pqsec_pki.enrolment.receipt import SignedReceipt, read_receipts
    from pqsec_pki.enrolment.receipt_import import (
        ImportedReceipt,
        import_receipts,
        record_receipts,
    )
    from pqsec_pki.enrolment.requesting import (
        REQUEST,
        Requested,
        key_places,
        make_sealing_key,
        request,
        requests,
    )
    from pqsec_pki.enrolment.robot_clock import begin_problems
    from pqsec_pki.enrolment.rolling_back import rollback
    from pqsec_pki.enrolment.sealed import fingerprint, is_sealed, open_sealed, seal
    from pqsec_pki.enrolment.tarball import MAX_ARCHIVE
    from pqsec_pki.enrolment.verification import VerifiedBundle, verify_bundle
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MAX_ARCHIVE",
    "NAMELESS",
    "REQUEST",
    "Accepted",
    "Bundle",
    "BundleFile",
    "CredentialStore",
    "ImportedReceipt",
    "Installed",
    "InstalledCredentials",
    "IssuedBundle",
    "Pins",
    "Requested",
    "SignRequest",
    "SignedReceipt",
    "VerifiedBundle",
    "accept",
    "answered",
    "begin_problems",
    "bundle_path",
    "bundle_paths",
    "changing",
    "fingerprint",
    "flat_name",
    "import_receipts",
    "install",
    "is_credential_store",
    "is_sealed",
    "issue_with_bundles",
    "key_places",
    "make_sealing_key",
    "name_asked_for",
    "one_command",
    "open_sealed",
    "ordered",
    "pin_texts",
    "pins_in_use",
    "pins_of",
    "problems_where_installed",
    "read_receipts",
    "record_receipts",
    "refresh",
    "refuse_large_answer",
    "removed_alone",
    "request",
    "requests",
    "require_trust",
    "rollback",
    "same_answers",
    "save",
    "seal",
    "sign",
    "validate_csrs",
    "verify_bundle",
    "write_bundles",
]
