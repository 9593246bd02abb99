"""What the room `credentials` refuses, as findings, so that the check misses none of it.

Rules of other families report most of these problems with more detail: where, why, and how to
fix it. Their findings then get the problem's code, and the rule here reports nothing.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from pqsec_pki.algorithms import is_encrypted
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    ALT_KEY,
    ENCLAVES,
    FILES,
    KEY,
    KEYS,
    PROOF,
    Credentials,
    alternative_spki,
    verify_credentials,
    verify_logged,
)
from pqsec_pki.errors import PqsecError, located, problems_of
from pqsec_pki.lint.document import Document
from pqsec_pki.lint.documents._extensions import all_but
from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Affected, Finding, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder, Inventory
from pqsec_pki.problems import Code, Problem
from pqsec_pki.transparency import LedgerProof

ID = "PQS319"
_REVOKED_IN_KEYSTORE = "PQS149"
"""About a revoked participant in the keystore that revoked it, which is intended."""
_LIST, _SIGNED = ("PQS145",), ("PQS330", "PQS331", "PQS332", "PQS333", "PQS334", "PQS335")
_XML = (*(f"PQS{number}" for number in (*range(201, 220), *range(231, 235), 262, 263, 264)),)
_REPORTED_BY: Mapping[Code, Iterable[str]] = {
    Code.FILE_MISSING: ("PQS301", "PQS302"),
    Code.FILE_MALFORMED: ("PQS130", "PQS140", "PQS305", "PQS318", "PQS343", *_SIGNED),
    Code.DOCUMENT_INVALID: ("PQS318", *_XML),
    Code.READERS_DISAGREE: ("PQS332", "PQS343"),
    Code.NOT_CA: ("PQS120",),
    Code.NOT_SELF_SIGNED: ("PQS132",),
    Code.KEY_USAGE: ("PQS122", "PQS123"),
    Code.CRITICAL_EXTENSION: ("PQS126",),
    Code.EXPIRED: ("PQS110",),
    Code.NOT_YET_VALID: ("PQS112",),
    Code.WRONG_ISSUER: ("PQS306", "PQS313", "PQS316", *_LIST),
    Code.BAD_SIGNATURE: ("PQS306",),
    Code.ALTERNATIVE_MISSING: ("PQS604",),
    Code.ALTERNATIVE_BAD: ("PQS603",),
    Code.KEY_MISMATCH: ("PQS304", "PQS608"),
    Code.WRONG_SUBJECT: ("PQS303",),
    Code.REVOKED: ("PQS146", _REVOKED_IN_KEYSTORE),
    Code.LIST_EXPIRED: ("PQS141",),
    Code.LIST_NOT_YET_VALID: ("PQS142",),
    Code.LIST_WRONG_ISSUER: _LIST,
    Code.LIST_BAD_SIGNATURE: _LIST,
    Code.LIST_SCOPE: _LIST,
    Code.ONE_KEY_TWO_ROLES: ("PQS312",),
    Code.COUNTERSIGNER_MISSING: ("PQS607",),
    Code.NOT_SIGNED: _SIGNED,
    Code.WRONG_SIGNER: ("PQS335", "PQS340"),
    Code.CONTENT_CHANGED: ("PQS341",),
    Code.SIGNATURE_BAD: ("PQS337", "PQS341"),
    Code.SIGNATURE_MISSING: ("PQS605", "PQS607"),
    Code.COUNTERSIGNATURE_BAD: ("PQS606",),
    Code.NO_GRANT: ("PQS308",),
    Code.GRANT_EXPIRED: ("PQS320",),
    Code.GRANT_NOT_YET_VALID: ("PQS322",),
}
"""The rules that report a problem as an error."""


@lint_rule(
    ID, Severity.ERROR, "the credentials of an enclave cannot be trusted",
    why="pqsec verifies a participant's credentials in one place, in the order of DDS-Security 1.1"
    " (9.3.3, 9.4.3). If they fail, `pqsec export`, `try`, `verify-handshake`, `bundle` and"
    " `install` refuse them. Stock stacks may be less strict.",
    fix="Restore the files that were issued; if only `ledger.proof` is missing or wrong, install a"
    " new bundle. Else run `pqsec issue` with --force and all rights of the participant.",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ cat k/public/identity_ca.cert.pem >> robot/identity_ca.cert.pem
    """,
    good="$ cp k/public/identity_ca.cert.pem robot",
)  # fmt: skip
def cannot_be_trusted(enclave: EnclaveFolder) -> Iterator[Violation]:
    for problem in _problems(enclave):
        files = (file for file in (*FILES, PROOF) if problem.subject == f"{enclave.name}: {file}")
        path = next((enclave.folder / file for file in files), None)
        text = str(replace(problem, subject="") if path else problem)
        yield Violation(text, path=path, code=problem.code, stacks=_stacks(enclave, path, problem))


def _stacks(enclave: EnclaveFolder, path: Path | None, problem: Problem) -> Affected:
    """The stacks for which it holds: all, unless one takes a document that pqsec cannot read."""
    found = enclave.subjects.get(path.name) if path else None
    if problem.code is Code.DOCUMENT_INVALID and isinstance(found, Document):
        return all_but(found.taken_by)
    return {}


def without_repetitions(findings: Iterable[Finding], inventory: Inventory) -> Iterator[Finding]:
    """The findings with codes, without those that another rule reports for the same enclave."""
    known = list(findings)
    enclaves = {each.folder: each for each in inventory.enclaves}
    by_path: dict[Path, list[int]] = {}
    for number, finding in enumerate(known):
        by_path.setdefault(finding.path, []).append(number)
    silent = set()
    for number, finding in enumerate(known):
        if finding.rule.id != ID or finding.code is None:
            continue
        enclave = enclaves.get(finding.path) or enclaves[finding.path.parent]
        near = (each for path in _places(enclave) for each in by_path.get(path, ()))
        reports = [each for each in near if _reports(known[each], finding.code)]
        for each in reports:
            known[each] = replace(known[each], code=finding.code)
        if reports:
            silent.add(number)
    return (finding for number, finding in enumerate(known) if number not in silent)


def _reports(finding: Finding, code: Code) -> bool:
    bad = finding.severity is Severity.ERROR or finding.rule.id == _REVOKED_IN_KEYSTORE
    return bad and finding.rule.id in _REPORTED_BY.get(code, ()) and finding.code in {None, code}


def _places(enclave: EnclaveFolder) -> frozenset[Path]:
    """Paths of findings about it: its folder, its files, and XML files next to signed ones."""
    own = {enclave.folder / name for name in (*enclave.files, *enclave.broken_links)}
    own |= {file.path for file in enclave.files.values()}
    return frozenset({enclave.folder, *own, *(path.with_suffix(".xml") for path in own)})


def _problems(enclave: EnclaveFolder) -> Iterator[Problem]:
    if any(enclave.files[name].unreadable for name in _open_to_all(enclave.files)):
        return  # unknown: the check is incomplete, as PQS001 reports
    for name in sorted(set(enclave.broken_links) & set(FILES)):
        yield Problem("the link is broken", Code.FILE_MISSING, name).of(enclave.name)
    try:
        credentials = Credentials.of(enclave.name, _files(enclave), anchors=enclave.anchors)
        verified = verify_credentials(credentials, now=enclave.now)
        file = enclave.files.get(PROOF)
        if file and file.unreadable:
            return
        with located(PROOF):
            proof = LedgerProof.from_bytes(file.data) if file else None
        if proof or enclave.proof_demanded:
            anchors, files = verified.anchors, verified.files
            verify_logged(enclave.name, anchors, files, proof, demanded=enclave.proof_demanded)
        if enclave.compare:
            head = proof.checkpoint.head if proof else None
            yield from enclave.compare(enclave.folder, credentials, head)
    except PqsecError as error:
        named = ENCLAVES in enclave.folder.parts  # elsewhere the folder's name means nothing
        for each in problems_of(error):
            if named or each.code is not Code.WRONG_SUBJECT:
                yield each


def _files(enclave: EnclaveFolder) -> dict[str, bytes]:
    """File name -> data, without unreadable or encrypted keys: no key is decrypted here.

    Also without keys that were read before, and are those of the certificate.
    """
    files = {name: each for name, each in enclave.files.items() if name in FILES}
    keys = {name: each for name, each in files.items() if name in KEYS}
    closed = any(each.unreadable or is_encrypted(each.data) for each in keys.values())
    if closed or _are_of(enclave.certificate(), keys):
        files = {name: files[name] for name in _open_to_all(files)}
    return {name: each.data for name, each in files.items()}


def _are_of(certificate: Certificate | None, keys: Mapping[str, File]) -> bool:
    """Whether these are both keys of the certificate, or its only one."""
    if certificate is None:
        return False
    wanted = {KEY: certificate.spki, ALT_KEY: alternative_spki(certificate)}
    found = {name: file.private_key.spki for name, file in keys.items()}
    return found == {name: spki for name, spki in wanted.items() if spki is not None}


def _open_to_all(files: Mapping[str, File]) -> Iterator[str]:
    return (name for name in files if name in FILES and name not in KEYS)
