"""Issuing to robots in one call: a robot can install its bundle, and a mistake issues nothing."""

from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    Bundle,
    install,
    issue_with_bundles,
    request,
    validate_csrs,
)
from pqsec_pki.errors import ExistsError, FileError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec

PROFILE, YEAR, DOMAINS = profile_named("classical"), timedelta(days=365), DomainSet.of(0)
NAME = "/fleet/robot1"


@pytest.fixture
def keystore(tmp_path, now) -> Keystore:
    return Keystore.create(
        tmp_path / "k",
        PROFILE,
        name="Robots",
        domains=DOMAINS,
        validity=10 * YEAR,
        passphrase=None,
        now=now,
    )


@pytest.fixture
def spec(keystore, tmp_path) -> ParticipantSpec:
    """What the robot in `robot` requested."""
    requested = request(NAME, PROFILE, tmp_path / "robot")
    keys = validate_csrs([requested.request], [PROFILE], names=[NAME])
    spec = ParticipantSpec(name=NAME, domains=DOMAINS, publish=("t",), validity=YEAR)
    return replace(spec, keys=keys[NAME])


def made(keystore, spec, folder, now, **choices):
    return issue_with_bundles(keystore, keystore.unlock(None), [spec], folder, now=now, **choices)


def test_the_robot_installs_the_bundle(keystore, spec, tmp_path, now):
    (each,) = made(keystore, spec, tmp_path / "out", now)
    assert (each.issued.name, each.path) == (NAME, tmp_path / "out/fleet+robot1.bundle")
    assert not Bundle.from_bytes(each.path.read_bytes()).has_keys
    done = install(each.path, tmp_path / "robot", None, now=now, trust_first=True)
    assert done.names == (NAME,)


def test_nothing_is_issued_over_a_file(keystore, spec, tmp_path, now):
    goal = tmp_path / "fleet+robot1.bundle"
    goal.write_text("something else")
    with pytest.raises(ExistsError):
        made(keystore, spec, tmp_path, now)
    assert keystore.names() == []
    made(keystore, spec, tmp_path, now, force=True)
    assert Bundle.from_bytes(goal.read_bytes()).names == (NAME,)


def test_keys_that_were_generated_here_need_a_recipient(keystore, spec, tmp_path, now):
    with pytest.raises(UsageError, match="needs the key of its robot"):
        made(keystore, replace(spec, keys=None), tmp_path, now)
    assert keystore.names() == []


def test_a_bundle_that_cannot_be_written_says_that_the_participant_is_issued(
    keystore, spec, tmp_path, now
):
    (tmp_path / "file").touch()
    with pytest.raises(FileError) as error:
        made(keystore, spec, tmp_path / "file", now)
    assert error.value.hint == f"{NAME} is issued: write its bundle with `pqsec bundle {NAME}`"
    assert keystore.names() == [NAME]
