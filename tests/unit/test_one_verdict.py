"""One verdict: all commands say the same about an enclave, and for the same reason.

Each row is the enclave of a participant with one thing about it; each reader is a part of pqsec
that trusts an enclave or does not. All of them must agree with the table.
"""

import base64
import re
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import timedelta

import pytest

from pqsec_pki.certificates import Authority, RevokedCertificate, revocation_list
from pqsec_pki.credentials import (
    ALT_KEY,
    CERTIFICATE,
    FILES,
    GOVERNANCE,
    IDENTITY_CA,
    KEY,
    NEEDED,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    REVOCATION_LIST,
)
from pqsec_pki.documents import Permissions
from pqsec_pki.enrolment import Bundle, install
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Authorities, Keystore, enclave_files
from pqsec_pki.lint import check
from pqsec_pki.lint.collect import take_inventory
from pqsec_pki.lint.enclaves.trust import cannot_be_trusted
from pqsec_pki.policy import policy_input_of
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.smime import Signer, document_in, sign
from pqsec_pki.stacks import stack_named
from pqsec_pki.trial import refuse_untrusted
from pqsec_pki.vendors import Options, export
from tests.unit.keystores import DAY, NOW, made
from tests.unit.plugin_wire import refusals
from tests.unit.signed_files import CONSTRUCTIONS

NAME, PEER = "/talker", "/listener"
DOCUMENTS = (GOVERNANCE, PERMISSIONS)


@dataclass(frozen=True)
class Lab:
    """A transition keystore, another that calls its CAs the same, and what their keys can do."""

    keystore: Keystore
    foreign: Keystore
    own: Authorities
    theirs: Authorities
    files: Mapping[str, bytes]
    peers: Mapping[str, bytes]
    """The enclave's files, and those of another participant."""
    strangers: Mapping[str, bytes]
    """Those of the participant of the same name in the other keystore."""

    def signed(self, text, authorities=None, *, ca=True, counter=True):
        """A document of our signers, or of `authorities`, with that one's key or not."""
        use = authorities or self.own
        ca_, second = use.permissions, use.countersigner
        names = self.own.permissions.certificate, self.own.countersigner.certificate
        return sign(
            text,
            Signer(ca_.certificate if ca else names[0], ca_.key),
            countersigner=Signer(second.certificate, second.key) if counter else None,
            now=NOW,
        )

    def list(self, authority=None, *, serials=(), now=NOW, validity=30 * DAY):
        """A revocation list in PEM."""
        revoked = [RevokedCertificate(serial, now, None) for serial in serials]
        return revocation_list(
            authority or self.own.identity, revoked, number=1, now=now, validity=validity
        ).pem


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    root = tmp_path_factory.mktemp("verdicts")
    ours, theirs = (made(root / each, "transition") for each in ("ours", "theirs"))
    return Lab(
        keystore=ours,
        foreign=theirs,
        own=ours.unlock(None),
        theirs=theirs.unlock(None),
        files=enclave_files(ours.root, NAME),
        peers=enclave_files(ours.root, PEER),
        strangers=enclave_files(theirs.root, NAME),
    )


# What is done to the enclave, and what must be said of it; None: it is good.

Change = Callable[[Lab], Mapping[str, bytes | None]]
ROWS: dict[str, tuple[Change, Code | None, timedelta]] = {}


def row(code, *, after=timedelta(0)):
    """Enter the function as a row, which is called as it is."""

    def enter(change):
        ROWS[change.__name__.replace("_", " ")] = (change, code, after)
        return change

    return enter


def rows(code, changes):
    """Enter several rows: changes by their names."""
    ROWS.update({name: (change, code, timedelta(0)) for name, change in changes.items()})


def text_of(lab, file):
    return document_in(lab.files[file])


def permissions_of(lab, **changes):
    """The participant's permissions with another grant."""
    [grant] = Permissions.from_xml(text_of(lab, PERMISSIONS)).grants
    return Permissions(grants=(replace(grant, **changes),)).to_xml()


@row(None)
def as_it_was_issued(_):
    return {}


@row(None)
def with_a_list_that_names_nobody(lab):
    return {REVOCATION_LIST: lab.list()}


@row(None)
def with_lines_that_end_in_cr_lf(lab):
    return {file: lab.files[file].replace(b"\n", b"\r\n") for file in DOCUMENTS}


@row(None)
def with_lines_that_end_in_cr_cr_lf(lab):
    return {PERMISSIONS: lab.files[PERMISSIONS].replace(b"\n", b"\r\r\n")}


@row(None)
def with_text_before_a_certificate(lab):
    return {CERTIFICATE: b"Certificate:\n    of a talker\n" + lab.files[CERTIFICATE]}


@row(None)
def in_an_overlap_of_two_identity_cas(lab):
    return {IDENTITY_CA: lab.files[IDENTITY_CA] + lab.strangers[IDENTITY_CA]}


rows(Code.FILE_MISSING, {f"without {file}": lambda _, f=file: {f: None} for file in NEEDED})
rows(
    Code.FILE_MALFORMED,
    {
        f"with {file} twice": lambda lab, f=file: {f: lab.files[f] * 2}
        for file in (CERTIFICATE, PERMISSIONS_CA, PERMISSIONS_ALT_CA)
    },
)
rows(
    Code.FILE_MALFORMED,
    {
        f"with {what} as {file}": lambda _, f=file, d=data: {f: d}
        for file in (CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA, PERMISSIONS_ALT_CA, REVOCATION_LIST)
        for what, data in (("nothing", b""), ("rubbish", b"rubbish\n"))
    },
)
rows(
    Code.FILE_MALFORMED,
    {
        f"with letters before BEGIN in {file}": lambda lab, f=file: {f: b"x" + lab.files[f]}
        for file in (CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA)
    },
)


@row(Code.FILE_MALFORMED)
def with_a_list_twice(lab):
    return {REVOCATION_LIST: lab.list() * 2}


@row(Code.COUNTERSIGNER_MISSING)
def without_the_countersigner(_):
    return {PERMISSIONS_ALT_CA: None}


@row(Code.COUNTERSIGNER_MISSING)
def without_the_countersigner_and_its_signatures(lab):
    """Audit H4."""
    plain = {file: lab.signed(text_of(lab, file), counter=False) for file in DOCUMENTS}
    return {PERMISSIONS_ALT_CA: None, **plain}


@row(Code.CA_DOUBLED)
def with_the_identity_ca_twice(lab):
    """Audit H2."""
    return {IDENTITY_CA: lab.files[IDENTITY_CA] * 2}


@row(Code.ONE_KEY_TWO_ROLES)
def with_the_permissions_ca_behind_the_identity_ca(lab):
    """Audit M1."""
    return {IDENTITY_CA: lab.files[IDENTITY_CA] + lab.files[PERMISSIONS_CA]}


@row(Code.ONE_KEY_TWO_ROLES)
def with_the_identity_ca_as_permissions_ca(lab):
    return {PERMISSIONS_CA: lab.files[IDENTITY_CA]}


@row(Code.ONE_KEY_TWO_ROLES)
def with_the_permissions_ca_as_countersigner(lab):
    return {PERMISSIONS_ALT_CA: lab.files[PERMISSIONS_CA]}


@row(Code.WRONG_ISSUER)
def with_the_permissions_ca_as_identity_ca_and_the_other_way_round(lab):
    return {
        IDENTITY_CA: lab.files[PERMISSIONS_CA],
        PERMISSIONS_CA: lab.files[IDENTITY_CA],
    }


@row(Code.WRONG_SIGNER)
def with_permissions_ca_and_countersigner_exchanged(lab):
    return {
        PERMISSIONS_CA: lab.files[PERMISSIONS_ALT_CA],
        PERMISSIONS_ALT_CA: lab.files[PERMISSIONS_CA],
    }


@row(Code.NOT_CA)
def with_its_own_certificate_as_permissions_ca(lab):
    return {PERMISSIONS_CA: lab.files[CERTIFICATE]}


@row(Code.NOT_CA)
def with_a_participant_as_identity_ca(lab):
    return {IDENTITY_CA: lab.peers[CERTIFICATE]}


@row(Code.NOT_PARTICIPANT)
def with_its_identity_ca_as_certificate(lab):
    return {CERTIFICATE: lab.files[IDENTITY_CA]}


@row(Code.BAD_SIGNATURE)
def with_a_certificate_of_a_ca_of_the_same_name(lab):
    return {file: lab.strangers[file] for file in (CERTIFICATE, KEY, "alt.key.pem")}


@row(Code.BAD_SIGNATURE)
def with_an_identity_ca_of_the_same_name(lab):
    return {IDENTITY_CA: lab.strangers[IDENTITY_CA]}


@row(Code.WRONG_ISSUER)
def with_its_identity_ca_behind_the_other_of_an_overlap(lab):
    """No signature covers the order; stacks that read one certificate read the first."""
    return {IDENTITY_CA: lab.strangers[IDENTITY_CA] + lab.files[IDENTITY_CA]}


@row(Code.BAD_SIGNATURE)
def with_a_list_of_the_other_of_two_identity_cas(lab):
    """It says nothing of what our CA issued, which so could not be revoked."""
    both = lab.strangers[IDENTITY_CA] + lab.files[IDENTITY_CA]
    return {IDENTITY_CA: both, REVOCATION_LIST: lab.list(lab.theirs.identity)}


@row(Code.ALTERNATIVE_MISSING)
def with_a_certificate_that_is_signed_once(lab):
    identity = lab.own.identity
    known = lab.keystore.participant(NAME).certificate
    made = Authority(identity.certificate, identity.key, None).issue(
        NAME, known.public_key, alternative=known.alternative_key, now=NOW, validity=90 * DAY
    )
    return {CERTIFICATE: made.pem}


@row(Code.WRONG_SUBJECT)
def with_certificate_and_keys_of_another_participant(lab):
    return {file: lab.peers[file] for file in (CERTIFICATE, KEY, "alt.key.pem", PERMISSIONS)}


@row(Code.KEY_MISMATCH)
def with_the_key_of_another_participant(lab):
    return {KEY: lab.peers[KEY]}


rows(
    Code.WRONG_SIGNER,
    {
        f"with {file} of a CA of the same name": lambda lab, f=file: {
            f: lab.signed(text_of(lab, f), lab.theirs)
        }
        for file in DOCUMENTS
    },
)
rows(
    Code.SIGNATURE_BAD,
    {
        f"with {file} that only names our CA": lambda lab, f=file: {
            f: lab.signed(text_of(lab, f), lab.theirs, ca=False)
        }
        for file in DOCUMENTS
    },
)
rows(
    Code.SIGNATURE_MISSING,
    {
        f"with {file} signed once": lambda lab, f=file: {
            f: lab.signed(text_of(lab, f), counter=False)
        }
        for file in DOCUMENTS
    },
)
rows(
    Code.CONTENT_CHANGED,
    {
        f"with {file} altered": lambda lab, f=file: {f: lab.files[f].replace(b"<dds", b"<dds ", 1)}
        for file in DOCUMENTS
    },
)
rows(
    Code.NOT_SIGNED,
    {f"with {file} unsigned": lambda lab, f=file: {f: text_of(lab, f)} for file in DOCUMENTS},
)
rows(
    Code.READERS_DISAGREE,
    {
        f"with two documents in {file}: {each.__name__}": lambda lab, f=file, e=each: {
            f: e(lab.files[f], lab.signed(text_of(lab, f).replace(b"\r\n", b"\n\n")))
        }
        for file in DOCUMENTS
        for each in CONSTRUCTIONS
    },
)


@row(Code.DOCUMENT_INVALID)
def with_governance_as_permissions(lab):
    return {PERMISSIONS: lab.files[GOVERNANCE]}


@row(Code.DOCUMENT_INVALID)
def with_permissions_as_governance(lab):
    return {GOVERNANCE: lab.files[PERMISSIONS]}


@row(Code.COUNTERSIGNATURE_BAD)
def with_a_countersignature_of_permissions_altered(lab):
    head, mark, tail = lab.files[PERMISSIONS].rpartition(b'filename="smime.p7s"\n\n')
    body, end, rest = tail.partition(b"\n\n--")
    octets = bytearray(base64.b64decode(body))
    octets[-1] ^= 1  # of the countersignature, which stands last
    return {PERMISSIONS: head + mark + base64.encodebytes(bytes(octets)).strip() + end + rest}


@row(Code.NO_GRANT)
def with_permissions_of_another_participant(lab):
    return {PERMISSIONS: lab.peers[PERMISSIONS]}


@row(Code.GRANT_EXPIRED)
def with_a_grant_that_has_ended(lab):
    xml = permissions_of(lab, not_before=NOW - 9 * DAY, not_after=NOW - DAY)
    return {PERMISSIONS: lab.signed(xml)}


@row(Code.GRANT_NOT_YET_VALID)
def with_a_grant_that_has_not_begun(lab):
    xml = permissions_of(lab, not_before=NOW + DAY, not_after=NOW + 9 * DAY)
    return {PERMISSIONS: lab.signed(xml)}


@row(Code.REVOKED)
def with_a_list_that_names_it(lab):
    return {REVOCATION_LIST: lab.list(serials=[certificate_of(lab).serial_number])}


@row(Code.LIST_EXPIRED)
def with_a_list_that_has_ended(lab):
    return {REVOCATION_LIST: lab.list(now=NOW - DAY / 2, validity=DAY / 4)}


@row(Code.LIST_NOT_YET_VALID)
def with_a_list_of_tomorrow(lab):
    return {REVOCATION_LIST: lab.list(now=NOW + 3 * DAY)}


@row(Code.LIST_BAD_SIGNATURE)
def with_a_list_of_a_ca_of_the_same_name(lab):
    return {REVOCATION_LIST: lab.list(lab.theirs.identity)}


@row(Code.LIST_WRONG_ISSUER)
def with_a_list_of_the_permissions_ca(lab):
    return {REVOCATION_LIST: lab.list(lab.own.permissions)}


@row(Code.ALTERNATIVE_MISSING)
def with_a_list_that_is_signed_once(lab):
    identity = lab.own.identity
    return {REVOCATION_LIST: lab.list(Authority(identity.certificate, identity.key, None))}


@row(Code.EXPIRED, after=366 * DAY)
def when_its_certificate_has_expired(_):
    return {}


@row(Code.NOT_YET_VALID, after=-9 * DAY)
def when_its_certificate_is_not_valid_yet(_):
    return {}


def certificate_of(lab):
    return lab.keystore.participant(NAME).certificate


# Who is asked. Each gives the codes of what it refuses; none if it trusts the enclave.

READERS: dict[str, Callable] = {}


def reader(function):
    """Enter the function as a reader: of the enclave's files, a keystore with it, and the time."""
    READERS[function.__name__.replace("_", " ")] = function
    return function


def codes_of(ask):
    try:
        ask()
    except PqsecError as error:
        return set(error.codes)
    return set()


@reader
def installing(files, keystore, now):
    """On a robot that trusts just these CAs: what is refused is refused for what it is."""
    folder = keystore.root.parent
    bundle = Bundle(now, {NAME: files}, profile=keystore.profile.name)

    def ask():
        (folder / "bundle").write_bytes(bundle.to_bytes())
        install(folder / "bundle", folder / "robot", now=now, trust_first=True)

    return codes_of(ask)


@reader
def the_self_check(_, keystore, now):
    setup = HandshakeSetup(keystore=keystore, domain=0, now=now)
    found = set()

    def ask():
        report = run_handshake(setup, HandshakeParty(name=NAME), HandshakeParty(name=PEER))
        found.update(report.failed.codes if report.failed else ())

    return codes_of(ask) | found


@reader
def the_plugin(_, keystore, now):
    """As Cyclone DDS hands it over: file by file, and not by the participant's name."""
    found = refusals(keystore.root / f"enclaves{NAME}", now)
    return {code for refusal in found for code in refusal.codes}


@reader
def checking(_, keystore, now):
    report = check([keystore.root / f"enclaves{NAME}"], now=now)
    return {each.code for each in report.findings if each.code and each.rule.severity == "error"}


@reader
def exporting(_, keystore, now):
    stack = stack_named("cyclonedds")
    return codes_of(lambda: export(stack, keystore, NAME, Options(), now=now))


@reader
def trying(_, keystore, now):
    """Before a real stack starts."""
    return codes_of(lambda: refuse_untrusted(keystore, [NAME], now=now))


@reader
def the_questions(_, keystore, now):
    """explain, and what asks like it; a file that is not there is the reader's own error."""
    return codes_of(lambda: policy_input_of(keystore, NAME, now))


def placed(lab, files, folder):
    """A copy of the keystore in which the enclave has these files."""
    root = folder / "keystore"
    shutil.copytree(lab.keystore.root, root, symlinks=True)
    enclave = root / f"enclaves{NAME}"
    for file in FILES:
        (enclave / file).unlink(missing_ok=True)
        if file in files:
            (enclave / file).write_bytes(files[file])
            (enclave / file).chmod(0o600 if file.endswith("key.pem") else 0o644)
    return Keystore.open(root)


NAMELESS = "with certificate and keys of another participant"
CANNOT_TELL = {
    # No stack tells its plugin an enclave's name.
    "the plugin": {NAMELESS},
    # Whether a grant covers it is what they answer; and no question needs a private key.
    "the questions": {
        "with permissions of another participant",
        "with a grant that has ended",
        "with a grant that has not begun",
        "with the key of another participant",
    },
}
"""By reader, the rows that it has no way to judge."""
OTHERWISE = {
    # The keystore has the countersigner, and so misses its signature.
    ("the questions", "without the countersigner and its signatures"): Code.SIGNATURE_MISSING,
    # A clock from before the CAs is wrong, as on a robot without a battery.
    ("installing", "when its certificate is not valid yet"): None,
    # It is good, but not what the ledger has: another file than it has does not leave the keystore.
    ("exporting", "with lines that end in cr lf"): Code.OTHER,
    ("exporting", "with lines that end in cr cr lf"): Code.CONTENT_CHANGED,
    ("exporting", "in an overlap of two identity cas"): Code.OTHER,
}
"""Where a reader refuses for another reason, and why."""


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", READERS)
def test_every_reader_gives_the_verdict_of_the_table(lab, tmp_path, name):
    wrong = []
    for number, (what, (change, code, after)) in enumerate(ROWS.items()):
        if what in CANNOT_TELL.get(name, ()):
            continue
        changed = {**lab.files, **change(lab)}
        files = {file: data for file, data in changed.items() if data is not None}
        folder = tmp_path / str(number)
        folder.mkdir()
        found = READERS[name](files, placed(lab, files, folder), NOW + after)
        code = OTHERWISE.get((name, what), code)  # noqa: PLW2901 -- of this reader
        if (code is None and found) or (code is not None and code not in found):
            told = ", ".join(sorted(found)) or "trusts it"
            wrong.append(f"{what}: {told}, and not {code or 'that it is good'}")
        shutil.rmtree(folder)
    assert not wrong, "\n".join(wrong)


def test_a_bundle_has_what_the_ledger_has_or_is_refused(lab, tmp_path):
    """Other files in its folder do not get into it: neither wrong ones, nor good ones."""
    made = {}
    for number, (what, (change, _, after)) in enumerate(ROWS.items()):
        files = {
            file: data for file, data in {**lab.files, **change(lab)}.items() if data is not None
        }
        folder = tmp_path / str(number)
        folder.mkdir()
        keystore = placed(lab, files, folder)
        with suppress(PqsecError):
            made[what] = Bundle.of(keystore, [NAME], now=NOW + after).enclaves[NAME]
        shutil.rmtree(folder)
    assert [what for what, files in made.items() if files != lab.files or ROWS[what][2]] == []
    assert {
        "as it was issued",
        "with a list that names it",
        "without the countersigner",
    } <= made.keys()


def test_the_table_has_every_code_of_an_enclave():
    """At least 40 rows, and one for each way in which credentials can be wrong."""
    elsewhere = {
        Code.OTHER,
        Code.ELEMENT_MISPLACED,
        Code.KEY_USAGE,
        Code.CRITICAL_EXTENSION,
        Code.NAME_CONSTRAINTS,  # test_chains.py, as the next
        Code.LIST_SCOPE,
        Code.NOT_SELF_SIGNED,
        Code.ALTERNATIVE_BAD,
        Code.LIST_MISSING,
        Code.CA_UNKNOWN,
        Code.CA_MISSING,
        Code.OLDER,
        Code.PROFILE_MISMATCH,
        Code.NO_DOMAIN_RULE,
        Code.DOMAIN_DENIED,
        Code.NOT_ISSUED,  # of receipts
        Code.PROOF_MISSING,  # where one is demanded
        Code.PROOF_BAD,  # test_bundle_proofs.py
        Code.APPROVAL_WAITING,  # of requests: test_est_robot.py
    }
    checks = {code for code in Code if re.fullmatch(r"C\d+", code.name)}
    assert len(ROWS) >= 40
    assert {code for _, code, _ in ROWS.values() if code} == set(Code) - elsewhere - checks


@pytest.mark.parametrize(
    "change",
    [
        lambda folder, peer: shutil.copy(peer / KEY, folder / KEY),
        lambda folder, peer: shutil.copy(peer / ALT_KEY, folder / ALT_KEY),
        lambda folder, _: (folder / ALT_KEY).unlink(),
        lambda folder, _: shutil.copy(folder / ALT_KEY, folder / KEY),
    ],
    ids=["another key", "another second key", "no second key", "the second key as the first"],
)
def test_keys_of_others_are_refused_by_the_rule_itself(tmp_path, change):
    """It leaves out keys that were compared before: only those that are the certificate's."""
    root = made(tmp_path / "k", "transition").root
    folder, peer = root / "enclaves/talker", root / "enclaves/listener"
    assert [*_problems_of(folder)] == []
    change(folder, peer)
    assert Code.KEY_MISMATCH in _problems_of(folder)
    if not (folder / ALT_KEY).exists():
        (folder / KEY).unlink()  # both are on the robot
        assert [*_problems_of(folder)] == []


def _problems_of(folder):
    [enclave] = take_inventory([folder], now=NOW).enclaves
    return [each.code for each in cannot_be_trusted(enclave)]
