"""Every profile with every key agreement, measured, and nothing left behind."""

import re
import tempfile
from contextlib import nullcontext

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, profile_named
from pqsec_pki.errors import FileError, UsageError, VerificationError
from pqsec_pki.selfcheck import matrix
from pqsec_pki.selfcheck.matrix import MessageSize, suites
from tests.unit.keystores import DAY, NOW

AROUND = 124
"""Bytes of the sample before the token, as tests/unit/test_handshake_wire.py has it."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where temporary files go."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture(scope="module")
def measured():
    return {(each.profile.name, each.agreement.name): each for each in suites(NOW, 1)}


def test_all_profiles_and_key_agreements_are_there(measured):
    assert list(measured) == [
        (profile.name, row.name) for profile in PROFILES for row in KEY_AGREEMENTS
    ]
    assert all(each.milliseconds > 0 for each in measured.values())


def test_messages_grow_by_what_the_key_agreement_adds(measured):
    """dh1 once in the request, dh1 and dh2 in reply and final; its name in request and reply."""
    ecdh, kem = KEY_AGREEMENTS.named("ecdh-p256"), KEY_AGREEMENTS.named("mlkem1024")
    for profile in PROFILES:
        one, other = (measured[profile.name, row.name].sizes for row in (ecdh, kem))
        more = {name: other[name].token - one[name].token for name in one}
        public = kem.public_size - ecdh.public_size
        both = public + kem.ciphertext_size - ecdh.ciphertext_size
        slack = 24 + 16  # the name, alignment, and DER signatures
        assert abs(more["request"] - public) <= slack
        assert abs(more["reply"] - both) <= slack
        assert abs(more["final"] - both) <= slack


def test_signatures_are_those_of_the_profile(measured):
    for (profile, _), suite in measured.items():
        row = profile_named(profile)
        names = [row.participant_key.wire_name]
        if row.alternative_key:
            names.append(row.alternative_key.wire_name)
        assert suite.signature == "+".join(names)


def test_what_breaks_a_promise_is_what_the_profile_refuses(measured):
    for (profile, agreement), suite in measured.items():
        refusal = nullcontext()
        if suite.breaks:
            words = re.escape("; ".join(suite.breaks))
            refusal = pytest.raises(UsageError, match=f"promises: {words}$")
        with refusal:
            changed = profile_named(profile).changed({"key_agreement": agreement})
            assert changed.key_agreement is suite.agreement


def test_shares_are_of_the_largest_message(measured):
    for suite in measured.values():
        sizes = suite.sizes
        assert all(size.sample == size.token + AROUND for size in sizes.values())
        assert sizes["reply"].sample == max(size.sample for size in sizes.values())
        assert suite.share == sizes["reply"].sample / 65507
        told = suite.to_json()
        assert told["is_default"] == (suite.profile.key_agreement is suite.agreement)
        assert told["share_of_datagram"] == round(suite.share, 4)
        assert [*told["messages"]] == ["request", "reply", "final"]


@pytest.mark.parametrize(("sample", "count"), [(1, 1), (1344, 1), (1345, 2), (2688, 2), (2689, 3)])
def test_a_message_takes_as_many_fragments_as_it_fills(sample, count):
    assert MessageSize(token=0, sample=sample).fragments == count


def test_the_median_is_of_all_rounds(folder, monkeypatch):
    seen = []
    meet_really = matrix.run_handshake

    def watched(*arguments):
        seen.append(meet_really(*arguments))
        return seen[-1]

    monkeypatch.setattr(matrix, "run_handshake", watched)
    first = next(suites(NOW, 3))
    assert first.milliseconds == sorted(report.milliseconds for report in seen)[1]
    assert first.sizes["final"].token == max(report.token_bytes["final"] for report in seen)


def test_the_temporary_folder_is_there_while_it_is_needed_and_then_removed(folder):
    running = suites(NOW, 1)
    next(running)
    [made] = folder.iterdir()
    assert made.stat().st_mode & 0o777 == 0o700
    running.close()
    assert list(folder.iterdir()) == []


def test_the_temporary_folder_is_removed_when_it_fails(folder, monkeypatch):
    """The participants of a keystore made for another time have expired."""
    real = matrix._keystore
    monkeypatch.setattr(matrix, "_keystore", lambda *a: real(*a[:2], NOW - 900 * DAY))
    with pytest.raises(VerificationError, match=r"profile transition with .*: identity of /talker"):
        next(suites(NOW, 1))
    assert list(folder.iterdir()) == []


def test_no_place_for_temporary_files_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "no"))
    with pytest.raises(FileError, match="no temporary folder can be created"):
        next(suites(NOW, 1))
