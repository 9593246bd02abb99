"""What pqsec could not read again is not written: writers know the limits of readers.

The limits are lowered here; what is just below one is written, and read.
"""

import json
import os
import shutil
from dataclasses import replace
from datetime import timedelta
from itertools import product
from types import SimpleNamespace

import pytest

from pqsec_pki import _files
from pqsec_pki.algorithms import pem, profile_named
from pqsec_pki.approvals import SignedGrant, proposal, registration
from pqsec_pki.certificates import (
    CertificateRequest,
    revocation,
    revoking,
)
from pqsec_pki.certificates import request as request_module
from pqsec_pki.certificates.revocation import MAX_DER, MAX_LIST, RevocationList
from pqsec_pki.documents import _yaml
from pqsec_pki.domain._groups import MAX_GROUPED
from pqsec_pki.enrolment import (
    Bundle,
    BundleFile,
    SignRequest,
    offline,
    requests,
    sign,
    tarball,
    write_bundles,
)
from pqsec_pki.enrolment import archive as archive_module
from pqsec_pki.enrolment import bundle as bundle_module
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.errors import MalformedError, PqsecError, TooLargeError
from pqsec_pki.keystore import (
    Entry,
    Keystore,
    _file_comparison,
    _ledger_file,
    _moves,
    _store,
    audit,
    change,
    groups,
)
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew_list, revoke
from tests.running import run_here
from tests.unit.keystores import DAY, NOW, made
from tests.unit.killing import drafts


def content(root):
    """All files of a keystore."""
    return {each: each.read_bytes() for each in root.rglob("*") if each.is_file()}


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical")


def receipt(number, size=300):
    details = {"statement": "x" * size}
    return Entry.of("receipt", "/talker", f"{number:064x}", NOW, details=details)


# The ledger


def ledger_size(keystore):
    return (keystore.root / "private/ledger.sqlite3").stat().st_size


def fill(keystore, size=300, at_once=3, begin=0):
    """Add lines until one is refused; how many were added."""
    for number in range(begin, 100_000, at_once):
        before = content(keystore.root)
        try:
            with change(keystore.root) as transaction:
                transaction.record(*(receipt(number + each, size) for each in range(at_once)))
        except TooLargeError as error:
            hint = error.hint
            break
    assert content(keystore.root) == before
    assert drafts(keystore.root) == []
    assert "pqsec ledger move" in hint
    return number


@pytest.mark.parametrize("size", [10, 300, 6000])
def test_a_ledger_is_not_filled_past_what_is_read(keystore, monkeypatch, size):
    monkeypatch.setattr(_ledger_file, "MAX_SIZE", ledger_size(keystore) + 150_000)
    added = fill(keystore, size)
    assert added > 10
    assert _ledger_file.MAX_SIZE - 30_000 < ledger_size(keystore) <= _ledger_file.MAX_SIZE
    audit(keystore)
    assert len([each for each in keystore.ledger() if each.kind == "receipt"]) == added


def test_a_full_ledger_takes_a_revocation_and_nothing_else(keystore, monkeypatch):
    monkeypatch.setattr(_ledger_file, "MAX_SIZE", 1 << 20)
    monkeypatch.setattr(_ledger_file, "_RESERVED", 8)
    fill(keystore, 15_000, at_once=5)
    fill(keystore, begin=50_000)
    before = content(keystore.root)
    with pytest.raises(TooLargeError, match="the ledger would have"):
        renew(keystore)
    assert content(keystore.root) == before
    revoke(keystore, keystore.unlock(None), ["/talker"], now=NOW)
    assert [each.name for each in keystore.ledger() if each.kind == "revocation"] == ["/talker"]


def renew(keystore):
    specs = [
        ParticipantSpec(name=f"/n{each}", domains=keystore.domains, validity=DAY)
        for each in range(40)
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)


def test_a_ledger_near_the_limit_is_measured_and_not_guessed(keystore, monkeypatch):
    """The quick bound is far above; the file just fits."""
    with change(keystore.root) as transaction:
        transaction.record(*(receipt(each) for each in range(50)))
    entries = [receipt(each) for each in range(50, 90)]
    monkeypatch.setattr(_ledger_file, "_RESERVED", 1 << 40)
    copy = keystore.root.with_name("copy")
    shutil.copytree(keystore.root, copy, symlinks=True)
    with change(copy) as transaction:
        transaction.record(*entries)
    monkeypatch.setattr(_ledger_file, "MAX_SIZE", ledger_size(replace(keystore, root=copy)))
    with change(keystore.root) as transaction:
        transaction.record(*entries)
    assert ledger_size(keystore) == _ledger_file.MAX_SIZE


def test_a_line_that_no_ledger_gives_back_is_not_begun(keystore):
    before = content(keystore.root)
    with pytest.raises(TooLargeError, match="a line of the ledger"), change(keystore.root) as it:
        it.record(receipt(1, _store.MAX_TEXT))
    assert content(keystore.root) == before
    with change(keystore.root) as transaction:
        transaction.record(receipt(1, _store.MAX_DETAILS - 1000))
    audit(keystore)


# Revocation lists


def test_a_list_that_is_read_as_der_is_read_as_pem_and_from_a_file():
    text = pem("X509 CRL", bytes(MAX_DER))
    assert MAX_LIST - 200 < len(text) <= MAX_LIST <= _files.MAX_FILE
    with pytest.raises(MalformedError, match="revocation list") as refused:
        RevocationList.from_pem(text)
    assert "larger than" not in str(refused.value)
    for read, data in (
        (RevocationList.from_der, bytes(MAX_DER + 1)),
        (RevocationList.from_pem, pem("X509 CRL", bytes(MAX_DER + 48))),
    ):
        with pytest.raises(MalformedError, match="larger than"):
            read(data)


def revoke_another(keystore, authorities):
    revoke(keystore, authorities, ["/listener"], now=NOW)


def issue_again(keystore, authorities):
    renew_list(keystore, authorities, now=NOW, validity=timedelta(days=3))


@pytest.mark.parametrize(("work", "revokes"), [(revoke_another, True), (issue_again, False)])
def test_a_list_that_nobody_reads_is_not_issued(keystore, monkeypatch, work, revokes):
    authorities = keystore.unlock(None)
    revoke(keystore, authorities, ["/talker"], now=NOW)
    size = len(keystore.revocation_list.der)
    for module in (revocation, revoking):
        monkeypatch.setattr(module, "MAX_DER", size + 10 if revokes else size - 10)
    before = content(keystore.root)
    with pytest.raises(TooLargeError, match="the revocation list would have") as refused:
        work(keystore, authorities)
    assert "pqsec ca rotate" in refused.value.hint
    assert content(keystore.root) == before
    assert drafts(keystore.root) == []


# Archives and other files


LIMITS = {
    "MAX_MEMBERS": (3, {f"n{each}": b"" for each in range(4)}),
    "MAX_CONTENT": (20_000, {"a": bytes(20_000)}),
    "MAX_ARCHIVE": (3000, {"a": bytes(range(256)) * 16}),
}


@pytest.mark.parametrize(("name", "case"), LIMITS.items(), ids=LIMITS)
def test_an_archive_that_nobody_unpacks_is_not_packed(monkeypatch, name, case):
    limit, files = case
    assert tarball.unpack(tarball.pack(files)) == files
    monkeypatch.setattr(tarball, name, limit)
    with pytest.raises(TooLargeError, match="the archive would have") as refused:
        tarball.pack(files)
    assert "fewer participants" in refused.value.hint


@pytest.mark.parametrize("name", ["MAX_ARCHIVE", "MAX_UNPACKED"])
def test_what_cannot_be_answered_is_not_issued(tmp_path, keystore, monkeypatch, name):
    profile = profile_named("classical")
    made = requests(["/a", "/b", "/c"], profile, tmp_path / "robot")
    specs = [
        ParticipantSpec(name=each.name, domains=keystore.domains, validity=DAY) for each in made
    ]
    data = SignRequest(tuple(each.request for each in made), tuple(specs)).to_bytes(now=NOW)
    asked, authorities = SignRequest.from_bytes(data), keystore.unlock(None)
    before = content(keystore.root)
    monkeypatch.setattr(offline, name, 8000)
    with pytest.raises(TooLargeError, match=r"in the answer|the answer would have") as refused:
        sign(asked, keystore, authorities, now=NOW)
    assert "fewer participants" in refused.value.hint
    assert content(keystore.root) == before
    monkeypatch.setattr(offline, name, 1 << 20)
    answer = sign(asked, keystore, authorities, now=NOW)
    estimated = 0
    for size in range(8000, 64_000, 250):
        monkeypatch.setattr(offline, "MAX_ARCHIVE", size)
        try:
            offline.refuse_large_answer(asked, keystore)
        except TooLargeError:
            estimated = size
    assert len(answer) < estimated < 2 * len(answer)


@pytest.mark.parametrize(
    ("files", "limits"),
    [
        ({"cert.pem": b"x" * 100_000}, {"MAX_ARCHIVE": 20_000, "MAX_CONTENT": 60_000}),
        ({f"{number}.pem": b"" for number in range(100)}, {"MAX_MEMBERS": 50}),
    ],
    ids=["octets", "files"],
)
def test_no_bundle_is_written_if_one_of_them_could_not_be_read(
    tmp_path, keystore, monkeypatch, files, limits
):
    bundles = [Bundle.of(keystore, [each], now=NOW) for each in ("/talker", "/listener")]
    large = replace(bundles[1], enclaves={"/listener": files})
    both = [
        BundleFile(each, tmp_path / f"{number}.bundle", plain_key=True)
        for number, each in enumerate((bundles[0], large))
    ]
    for module, (limit, value) in product((tarball, bundle_module), limits.items()):
        monkeypatch.setattr(module, limit, value, raising=limit != "MAX_CONTENT")
    with pytest.raises(TooLargeError):
        write_bundles(both)
    assert not list(tmp_path.glob("*.bundle"))


def test_a_report_that_compare_does_not_read_is_not_written(tmp_path, keystore, monkeypatch):
    monkeypatch.setattr("pqsec_pki.cli.report.MAX_REPORT", 1000)
    line = ["-k", str(keystore.root), "report", "-o", "r.json"]
    code, out, err = run_here(line, cwd=tmp_path, env=os.environ)
    assert (code, out) == (3, "")
    assert "the report would have" in err
    assert "without -o" in err
    assert not (tmp_path / "r.json").exists()
    assert run_here([*line[:3], "--json"], cwd=tmp_path, env=os.environ)[0] == 0


def test_a_grant_that_nobody_reads_is_not_given(monkeypatch):
    grant = SignedGrant.__new__(SignedGrant)
    object.__setattr__(grant, "grant", SimpleNamespace(to_json=lambda: {"names": ["/a"] * 50}))
    object.__setattr__(grant, "signatures", (b"signature",))
    assert grant.to_file()
    monkeypatch.setattr(registration, "MAX_GRANT", 100)
    with pytest.raises(TooLargeError, match="the grant would have"):
        grant.to_file()


def test_a_plan_that_nobody_reads_is_not_proposed(monkeypatch):
    plan = SimpleNamespace(to_json=lambda: {"steps": ["/a"] * 50})
    assert proposal.proposal_file(plan, plan)
    monkeypatch.setattr(proposal, "MAX_PROPOSAL", 100)
    with pytest.raises(TooLargeError, match="the plan would have"):
        proposal.proposal_file(plan, plan)


def test_a_manifest_that_nobody_reads_is_not_written(monkeypatch):
    one = Archive("bundle", {}, {f"n{each}": b"" for each in range(20)})
    assert Archive.unpack(one.pack(), "bundle").files == one.files
    monkeypatch.setattr(archive_module, "MAX_MANIFEST", 1000)
    with pytest.raises(TooLargeError, match="the manifest would have"):
        one.pack()


def test_a_journal_that_nobody_reads_is_not_committed(keystore, monkeypatch):
    before = content(keystore.root)
    monkeypatch.setattr(_moves, "_MAX_SIZE", 2000)
    with pytest.raises(TooLargeError, match="the list of what to do"):
        renew(keystore)
    assert content(keystore.root) == before
    assert drafts(keystore.root) == []
    assert Keystore.open(keystore.root).names() == ["/listener", "/talker"]


def test_groups_that_nobody_reads_are_not_written(monkeypatch):
    names = {"hall": tuple(f"/r{each}" for each in range(30))}
    assert json.loads(groups.groups_file(names))["groups"] == {"hall": list(names["hall"])}
    monkeypatch.setattr(groups, "_LIMIT", 100)
    with pytest.raises(TooLargeError, match=r"groups\.json would have"):
        groups.groups_file(names)


def test_as_many_groups_as_a_domain_file_has_fit_into_their_file():
    line = len(f'  "/{"x" * 63}",\n') + 1
    assert line * MAX_GROUPED <= groups._LIMIT


def test_a_memory_of_files_that_nobody_reads_is_not_written(keystore, monkeypatch):
    comparison = _file_comparison.FileComparison.of(keystore)
    comparison._seen, comparison._changed = {"/a": "x" * 100}, True
    monkeypatch.setattr(_file_comparison, "_MAX_SEEN", 50)
    comparison.save()
    assert not (keystore.root / "private/seen.json").exists()


@pytest.mark.parametrize(("module", "name", "limit"), [
    (request_module, "MAX_REQUESTS", 2), (request_module, "MAX_FILE", 1000),
])  # fmt: skip
def test_requests_that_fit_into_no_file_are_not_made(tmp_path, monkeypatch, module, name, limit):
    monkeypatch.setattr(module, name, limit)
    profile, robot = profile_named("classical"), tmp_path / "robot"
    names = ["/a", "/b", "/c"]
    with pytest.raises(TooLargeError, match="the file would have") as refused:
        requests(names, profile, robot, together=True)
    assert "several files" in refused.value.hint
    assert not list(tmp_path.rglob("*.pem"))
    assert len(requests(names, profile, robot)) == 3


def test_as_many_requests_as_are_written_are_read(tmp_path, monkeypatch):
    made = [each.request for each in requests(["/a", "/b"], profile_named("classical"), tmp_path)]
    monkeypatch.setattr(request_module, "MAX_REQUESTS", 2)
    data = CertificateRequest.all_to_pem(made)
    assert [each.der for each in CertificateRequest.all_from_pem(data)] == [
        each.der for each in made
    ]


@pytest.mark.parametrize(("name", "limit"), [("MAX_DOCUMENT", 60), ("MAX_ITEMS", 12)])
def test_yaml_that_nobody_reads_is_not_written(monkeypatch, name, limit):
    value = {"roles": {"a": ["x", "yy"], "b": ["x" * 9, True, 5]}, "participants": ["/a", "/b"]}
    data = _yaml.dump(value)
    _yaml.parse(data)
    monkeypatch.setattr(_yaml, name, limit)
    with pytest.raises(TooLargeError, match="the YAML would have"):
        _yaml.dump(value)


def test_yaml_is_counted_as_it_is_read(monkeypatch):
    value = {"roles": {"a": ["x", "yy"], "b": []}, "participants": [{"name": "/a", "domains": 0}]}
    data = _yaml.dump(value)
    count = _yaml._values_in(value)
    monkeypatch.setattr(_yaml, "MAX_ITEMS", count)
    _yaml.parse(data)
    monkeypatch.setattr(_yaml, "MAX_ITEMS", count - 1)
    with pytest.raises(PqsecError, match="values"):
        _yaml.parse(data)
