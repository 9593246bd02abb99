"""Revocation lists as they are made, and what a list does to who is on it."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import pytest
from cryptography import x509

from pqsec_pki._asn1 import Signed, TBSCertList, decode, encode, raw
from pqsec_pki.algorithms import PROFILES, SIGNATURES, profile_named
from pqsec_pki.certificates import (
    Authority,
    Certificate,
    Reason,
    RevocationList,
    RevokedCertificate,
    revocation_list,
    verify_not_revoked,
)
from pqsec_pki.errors import MalformedError, PqsecError, UsageError, VerificationError

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
DAY = timedelta(days=1)
REASONS = [*Reason, None]


def authority(profile="transition", name="CA"):
    return _authority(profile, name)


@cache
def _authority(profile, name):
    row = profile_named(profile)
    return Authority.create(
        name, row.identity_key, alternative=row.alternative_key, now=NOW, validity=3650 * DAY
    )


def participant(profile="transition"):
    return _participant(profile)


@cache
def _participant(profile):
    row = profile_named(profile)
    second = row.alternative_key.generate().public_key if row.alternative_key else None
    key = row.participant_key.generate().public_key
    return authority(profile).issue("/talker", key, alternative=second, now=NOW, validity=90 * DAY)


def entry(serial=1, reason=None, at=NOW):
    return RevokedCertificate(serial, at, reason)


def made(*entries, profile="transition", **options):
    given = {"number": 7, "now": NOW, "validity": 30 * DAY}
    return revocation_list(authority(profile), entries, **(given | options))


@pytest.mark.parametrize("profile", [row.name for row in PROFILES])
def test_a_list_of_any_profile_takes_back_what_it_names_and_nothing_else(profile):
    ca, victim = authority(profile).certificate, participant(profile)
    twice = profile_named(profile).alternative_key is not None
    options = {"now": NOW, "require_alternative": twice}
    verify_not_revoked(victim, made(entry(1), profile=profile), ca, **options)
    named = made(entry(1), entry(victim.serial_number, "keyCompromise"), profile=profile)
    with pytest.raises(VerificationError) as refusal:
        verify_not_revoked(victim, named, ca, **options)
    words = "the certificate of CN=/talker was revoked on 2026-06-01 12:00 UTC (keyCompromise)"
    assert refusal.value.lines == (words,)


@pytest.mark.parametrize("reason", REASONS)
def test_a_reason_is_said_but_for_no_reason(reason):
    # RFC 5280 5.3.1: unspecified should be said by leaving the extension out
    [found] = made(entry(5, reason)).revoked
    assert found == entry(5, None if reason in (None, Reason.UNSPECIFIED) else reason.value)


def test_the_entries_stand_in_the_order_of_their_numbers():
    serials = [each.serial_number for each in made(*map(entry, [9, 2**158, 1, 300])).revoked]
    assert serials == [1, 9, 300, 2**158]


def test_a_list_has_what_rfc_5280_demands():
    crl, ca = made(entry()), authority().certificate
    tbs = decode(TBSCertList, encode(decode(Signed, crl.der, "").tbs), "")
    assert tbs.version == 1  # v2, 5.1.2.1
    assert crl.number == 7
    assert crl.issuer_der == ca.subject_der
    assert crl.this_update == NOW - DAY  # a robot's clock may be slow
    assert crl.next_update == NOW + 30 * DAY
    named = crl.extensions.get_extension_for_class(x509.AuthorityKeyIdentifier)
    assert named.value.key_identifier == ca.subject_key_identifier
    assert not any(extension.critical for extension in crl.extensions)


def test_an_empty_list_has_no_sequence_of_entries():
    # 5.1.2.6: it must be absent then
    tbs = decode(TBSCertList, encode(decode(Signed, made().der, "").tbs), "")
    assert tbs.revoked_certificates is None


def test_a_list_does_not_outlive_its_ca_nor_begin_before_it():
    crl = made(validity=5000 * DAY)
    assert crl.next_update == authority().certificate.not_after
    early = made(now=NOW - timedelta(hours=5))
    assert early.this_update == authority().certificate.not_before


@pytest.mark.parametrize("validity", [timedelta(), -DAY, timedelta(days=100_000)])
def test_a_validity_that_cannot_be_is_refused(validity):
    with pytest.raises(UsageError, match="the validity"):
        made(validity=validity)


@pytest.mark.parametrize(
    ("now", "words"),
    [
        (NOW + 4000 * DAY, "the identity CA expired on 2036-05-29"),
        (datetime(1970, 1, 2, tzinfo=UTC), "the identity CA begins on 2026-05-31"),
        (datetime(2100, 1, 1, tzinfo=UTC), "the identity CA expired on 2036-05-29"),
    ],
    ids=["later", "1970", "2100"],
)
def test_a_ca_that_is_not_in_its_time_makes_no_list(now, words):
    with pytest.raises(PqsecError, match=words) as caught:
        made(now=now)
    assert "set the clock to the correct time" in caught.value.hint


def test_a_ca_that_may_not_sign_lists_makes_none():
    plain = authority("classical")
    leaf = participant("classical")  # its keyUsage has no cRLSign
    with pytest.raises(VerificationError, match="may not sign revocation lists"):
        revocation_list(replace(plain, certificate=leaf), [], number=1, now=NOW, validity=30 * DAY)


@pytest.mark.parametrize(
    ("when", "words"),
    [
        (NOW - 2 * DAY, "the revocation list is not in force before 2026-05-31 12:00 UTC"),
        (NOW + 31 * DAY, "the revocation list ended on 2026-07-01 12:00 UTC"),
    ],
    ids=["early", "ended"],
)
def test_with_a_list_that_is_not_in_force_nobody_is_good(when, words):
    with pytest.raises(VerificationError) as refusal:
        verify_not_revoked(participant(), made(), authority().certificate, now=when)
    assert refusal.value.lines == (words,)


def test_a_list_is_in_force_to_the_second_that_it_names():
    crl = made()
    late = crl.next_update + timedelta(seconds=1)
    verify_not_revoked(participant(), crl, authority().certificate, now=crl.next_update)
    with pytest.raises(VerificationError, match="the revocation list ended on"):
        verify_not_revoked(participant(), crl, authority().certificate, now=late)


def test_a_list_with_an_extension_twice_is_refused():
    signed = decode(Signed, made().der, "")
    tbs = decode(TBSCertList, encode(signed.tbs), "")
    doubled = replace(tbs, crl_extensions=[*tbs.crl_extensions, tbs.crl_extensions[0]])
    with pytest.raises(MalformedError, match="not a revocation list"):
        RevocationList.from_der(encode(replace(signed, tbs=raw(encode(doubled)))))


def test_a_list_with_an_alternative_key_alone_counts_as_one_without_its_signature():
    crl = made()
    half = replace(crl, alternative=replace(crl.alternative, identifier=None, signature=None))
    verify_not_revoked(participant(), half, authority().certificate, now=NOW)
    with pytest.raises(VerificationError) as refusal:
        verify_not_revoked(
            participant(), half, authority().certificate, now=NOW, require_alternative=True
        )
    assert refusal.value.lines == ("the revocation list has no alternative signature",)


def test_the_list_of_another_ca_of_the_same_name_makes_nobody_good():
    other = Authority.create("CA", SIGNATURES.named("p256"), now=NOW, validity=3650 * DAY)
    crl = revocation_list(other, [], number=1, now=NOW, validity=30 * DAY)
    with pytest.raises(VerificationError, match="same name, another key, or altered"):
        verify_not_revoked(participant(), crl, authority().certificate, now=NOW)


def test_a_list_whose_second_signature_was_stripped_is_refused_where_both_are_asked_for():
    ca = authority()
    stripped = revocation_list(
        replace(ca, alternative_key=None), [], number=1, now=NOW, validity=30 * DAY
    )
    verify_not_revoked(participant(), stripped, ca.certificate, now=NOW)
    with pytest.raises(VerificationError, match="has no alternative signature"):
        verify_not_revoked(
            participant(), stripped, ca.certificate, now=NOW, require_alternative=True
        )


def test_everything_that_is_wrong_is_said():
    crl = made(entry(participant().serial_number), number=1)
    foreign = authority("classical", "Other").certificate
    with pytest.raises(VerificationError) as refusal:
        verify_not_revoked(participant(), crl, foreign, now=NOW + 99 * DAY)
    assert len(refusal.value.lines) == 3


def test_a_long_list_is_made_and_asked_in_a_moment():
    crl = made(*(entry(serial) for serial in range(1, 20_001)))
    assert len(RevocationList.from_der(crl.der).revoked) == 20_000
    certificate = Certificate.from_der(participant().der)
    assert all(crl.revocation_of(certificate) is None for _ in range(20_000))


def test_a_list_tells_nothing_of_certificates_of_another_authority():
    crl = RevocationList.from_der(made(entry(participant().serial_number)).der)
    assert crl.revocation_of(participant())
    other = replace(participant(), issuer_der=authority(name="Other CA").certificate.subject_der)
    assert crl.revocation_of(other) is None
