"""Rights changed in a keystore: all or none, and never over another command's change."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.access import TopicRights, add_rights
from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet, Kind
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore, audit
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    changed_permissions,
    issue,
    sign_changed,
    sign_document,
)

NOW = datetime(2026, 1, 1, tzinfo=UTC)
ZERO = DomainSet.of(0)
YEAR = timedelta(days=365)


@pytest.fixture
def keystore(tmp_path):
    keystore = Keystore.create(
        tmp_path / "k",
        profile_named("classical"),
        name="lab",
        domains=ZERO,
        validity=YEAR,
        passphrase=None,
        now=NOW,
    )
    specs = [
        ParticipantSpec(name=name, domains=ZERO, publish=("x",), validity=YEAR)
        for name in ("/a", "/b")
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    return keystore


def changes(keystore, topic, *names):
    def edit(_, grant):
        return add_rights(grant, TopicRights(publish=(topic,)), ZERO)

    return changed_permissions(keystore, names, edit, now=NOW)


def published(keystore, name):
    [grant] = keystore.verified(name, now=NOW).permissions.value.grants
    return [topic for rule in grant.rules for each in rule.publish for topic in each.topics]


def test_a_change_is_signed_for_all(keystore):
    found = changes(keystore, "y", "/a", "/b")
    assert published(keystore, "/a") == ["x"]
    sign_changed(keystore, keystore.unlock(None), found, now=NOW)
    assert [published(keystore, name) for name in ("/a", "/b")] == [["x", "y"], ["x", "y"]]
    audit(keystore)


def test_a_change_of_permissions_that_were_changed_since_is_refused(keystore):
    """The user has seen the change to other permissions than these."""
    authorities = keystore.unlock(None)
    seen = changes(keystore, "y", "/b", "/a")
    sign_changed(keystore, authorities, changes(keystore, "z", "/a"), now=NOW)
    with pytest.raises(KeystoreError, match="permissions of /a were changed by another command"):
        sign_changed(keystore, authorities, seen, now=NOW)
    assert [published(keystore, name) for name in ("/a", "/b")] == [["x", "z"], ["x"]]


def test_a_document_without_a_grant_for_the_participant_is_not_changed(keystore):
    document = (
        (keystore.root / "enclaves/a/permissions.xml").read_text().replace("CN=/a", "CN=/other")
    )
    sign_document(
        keystore,
        Kind.PERMISSIONS,
        document.encode(),
        keystore.root / "enclaves/a/permissions.p7s",
        keystore.unlock(None),
        now=NOW,
        force=True,
    )
    with pytest.raises(KeystoreError, match="there is no grant for CN=/a"):
        changes(keystore, "y", "/a")
