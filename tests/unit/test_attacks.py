"""Every attack is refused: where the table below says, by the victim, in these words."""

import json
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, profile_named
from pqsec_pki.attacks._context import AttackContext, Attempt, with_identity
from pqsec_pki.attacks.attack import Attack, Attacker
from pqsec_pki.attacks.run import attempted, run_attacks
from pqsec_pki.attacks.table import ATTACKS, attack_named
from pqsec_pki.documents import DomainSet, Permissions
from pqsec_pki.errors import UnknownAlgorithmError, UsageError
from pqsec_pki.handshake import StockPeers
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, stack_named
from pqsec_pki.selfcheck.handshake_check import HandshakeCheck
from pqsec_pki.smime import Signer, sign
from tests.longer import LONG

# cryptography warns of what it will refuse some day, and a spoilt certificate may have that.
pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
HOUR = timedelta(hours=1)
DOMAIN = DomainSet.of(0)
GATE = {"classical", "transition", "pq"}
SETS = "classical,hybrid"
"""Two sets of credentials, and a policy that names nobody."""
NAMES = [*(each.name for each in PROFILES if LONG or each.name in GATE), SETS]
ALL = [row.name for row in ATTACKS]
FOR_TWO_KEYS = {
    "plain-signature",
    "half-signature",
    "stripped-certificate",
    "broken-ca",
    "stripped-permissions",
}
OF_SETS = {"weaker-set", "forged-weaker-set", "other-name", "mixed-sets", "replay-weaker-set"}
OF_VERSIONS = {"convert-version", "strip-version", "spoil-credentials"}
each_profile = pytest.mark.parametrize("profile", NAMES)

BAD_SIGNATURE = "^bad .* signature$"
OTHER_KEYS = "different keys"
INTRODUCED = "introduction: |was issued by|not signed by this CA"
NOT_NAMED = "^the peer's certificate is of the set classical, and stock does not name it$"
OTHER_SET = "was issued by CN=Lab Identity CA, not by CN=Lab hybrid Identity CA"
UNSIZED = "^not a .* (public key|ciphertext): [0-9]+ bytes$"
MISLABELLED = "(?i)(expected a 'dds.*', got a '.*'|a message for another participant)$"

EXPECTED = {
    # attack: (what is tried, the step that refuses it, the cause); the first that fits counts
    "change-request": [
        ("^c.id, last", "reply", "^hash_c1 is not as expected$"),
        ("^c.id", "reply", INTRODUCED),
        ("^c.pdata, first", "reply", "no participant GUID"),
        ("^c.pdata, middle", "reply", "not the one that was discovered"),
        ("^c.dsign_algo", "reply", "does not match the certificate's key"),
        ("^c.kagree_algo", "reply", "^the peer asks for"),
        ("^c.p|^hash_c1", "reply", "^hash_c1 is not as expected$"),
        ("^challenge1", "reply", "^challenge1 is not the one that the peer announced$"),
        ("^dh1", "reply", "^bad .* public key$"),
        ("^dh1", "final", "^dh1 is not as expected$"),
    ],
    "change-reply": [
        ("^c.id, last", "final", "^hash_c2 is not as expected$"),
        ("^c.id", "final", INTRODUCED),
        ("^c.pdata, first", "final", "no participant GUID"),
        ("^c.pdata, middle", "final", "not the one that was discovered"),
        ("^c.dsign_algo", "final", "does not match the certificate's key"),
        ("^c.kagree_algo", "final", "^c.kagree_algo is not what was asked for"),
        ("^c.p|^hash_c2", "final", "^hash_c2 is not as expected$"),
        ("^challenge2", "final", "^challenge2 is not the one that the peer announced$"),
        (
            "^(hash_c1|challenge1|dh1)",
            "final",
            "^(hash_c1|challenge1|dh1) is not as expected$",
        ),
        ("^(dh2|signature)", "final", BAD_SIGNATURE),
    ],
    "change-final": [
        ("^signature", "authenticated", BAD_SIGNATURE),
        ("", "authenticated", "^[a-z]+(_c)?[12] is not as expected$"),
    ],
    "change-message": [
        ("^(kind|key id)", "message", "protected in another way, or with a key of another name"),
        ("^length", "message", "runs past the end"),
        ("^number", "message", "a crypto footer of 20 bytes for 1 receivers"),
        ("^unprotected", "message", "not one protected submessage"),
        ("", "message", OTHER_KEYS),
    ],
    "drop-field": [
        ("request$", "reply", "^[a-z._0-9]+ is missing$"),
        ("reply$", "final", "^[a-z._0-9]+ is missing$"),
        ("final$", "authenticated", "^[a-z._0-9]+ is missing$"),
    ],
    "double-field": [
        ("request$", "reply", "' is there 2 times"),
        ("reply$", "final", "' is there 2 times"),
        ("final$", "authenticated", "' is there 2 times"),
    ],
    "smuggle-field": [
        ("request$", "reply", "^'c.extra' is not covered by every stack's hash$"),
        ("reply$", "final", "^'c.extra' is not covered by every stack's hash$"),
        ("final$", "authenticated", "^'c.extra' is not covered by every stack's hash$"),
    ],
    "mislabel": [
        ("^the auth request twice", "auth", "expected one token, got 2"),
        (
            "^the auth request",
            "auth",
            MISLABELLED,
        ),
        ("^the request twice", "reply", "expected one token, got 2"),
        (
            "^the request",
            "reply",
            MISLABELLED,
        ),
        ("^the reply twice", "final", "expected one token, got 2"),
        ("^the reply", "final", MISLABELLED),
        ("^the final twice", "authenticated", "expected one token, got 2"),
        (
            "^the final",
            "authenticated",
            MISLABELLED,
        ),
    ],
    "reorder": [
        ("instead of a request$", "reply", r"expected a 'DDS:Auth:PKI-DH:1.0\+Req'"),
        ("instead of a reply$", "final", r"expected a 'DDS:Auth:PKI-DH:1.0\+Reply'"),
        ("instead of a final$", "authenticated", r"expected a 'DDS:Auth:PKI-DH:1.0\+Final'"),
    ],
    "truncate": [
        ("of the auth request$", "auth", "runs past the end"),
        ("of the request$", "reply", "runs past the end"),
        ("of the reply$", "final", "runs past the end"),
        ("of the final$", "authenticated", "runs past the end"),
    ],
    "oversize": [
        ("1 MiB in the request", "reply", "larger than [0-9]+ bytes"),
        ("1 MiB in the reply", "final", "larger than [0-9]+ bytes"),
        ("1 MiB in the final", "authenticated", "larger than [0-9]+ bytes"),
        ("fields in the request", "reply", "^100[0-9]+ elements, more than allowed"),
        ("fields in the reply", "final", "^100[0-9]+ elements, more than allowed"),
        ("fields in the final", "authenticated", "^100[0-9]+ elements, more than allowed"),
        ("4 GiB in the request", "reply", "a length runs past the end"),
        ("4 GiB in the reply", "final", "a length runs past the end"),
        ("4 GiB in the final", "authenticated", "a length runs past the end"),
    ],
    "swap-challenge": [
        ("^the initiator's, as announced$", "reply", "^challenge1 is not the one that the peer"),
        ("^the replier's, as announced$", "final", "^challenge2 is not the one that the peer"),
        (
            "^the initiator's, announced and sent$",
            "final",
            "^challenge1 is not as expected$",
        ),
        ("", "final", BAD_SIGNATURE),
    ],
    "strip-hash": [("", "final", BAD_SIGNATURE)],
    "key-in-the-middle": [("", "final", BAD_SIGNATURE)],
    "downgrade": [
        ("request$", "reply", "^the peer asks for '.*'; allowed here: [^,]*$"),
        ("reply$", "final", "^c.kagree_algo is not what was asked for$"),
    ],
    "name-other-signature": [
        ("request$", "reply", "does not match the certificate's key$"),
        ("reply$", "final", "does not match the certificate's key$"),
    ],
    "name-unknown-algorithm": [
        ("request: 1000 bytes", "reply", "has 1000 bytes, which names no algorithm$"),
        ("reply: 1000 bytes", "final", "has 1000 bytes, which names no algorithm$"),
        (
            "dsign_algo of the request",
            "reply",
            "does not match the certificate's key$",
        ),
        ("dsign_algo of the reply", "final", "does not match the certificate's key$"),
        ("kagree_algo of the request", "reply", "^the peer asks for"),
        ("kagree_algo of the reply", "final", "^c.kagree_algo is not what was asked for$"),
    ],
    "reflect": [
        ("request$", "reply", "is our own: the message was reflected$"),
        ("reply$", "final", "is our own: the message was reflected$"),
    ],
    "reflect-message": [("", "message", "is for another participant$")],
    "replay": [
        ("^the request$", "reply", "^challenge1 is not the one that the peer announced$"),
        ("^the reply$", "final", "^challenge1 is not as expected"),
        ("^the final$", "authenticated", "^challenge1 is not as expected"),
        ("initiator sent$", "authenticated", "^challenge2 is not as expected; dh2 is not"),
        (
            "replier sent$",
            "final",
            "^challenge1 is not as expected; dh1 is not as expected$",
        ),
        ("under the earlier keys$", "message", OTHER_KEYS),
    ],
    "copied-certificate": [
        ("as initiator$", "authenticated", BAD_SIGNATURE),
        ("as replier$", "final", BAD_SIGNATURE),
    ],
    "own-ca": [
        ("same name, as initiator$", "reply", "not signed by this CA"),
        ("same name, as replier$", "final", "not signed by this CA"),
        ("another name, as initiator$", "reply", "was issued by CN=Another CA, not by"),
        ("another name, as replier$", "final", "was issued by CN=Another CA, not by"),
    ],
    "self-signed": [
        ("as initiator$", "reply", "was issued by .*; .* is a CA's, not a participant's"),
        ("as replier$", "final", "was issued by .*; .* is a CA's, not a participant's"),
    ],
    "expired": [
        ("as initiator$", "reply", "^the certificate of CN=/[a-z]+ expired on 2026-11-21 11:59:59"),
        ("as replier$", "final", "^the certificate of CN=/[a-z]+ expired on 2026-11-21 11:59:59"),
    ],
    "not-yet-valid": [
        ("as initiator$", "reply", "^the .* is not valid before 2026-11-21 12:00:01 UTC$"),
        ("as replier$", "final", "^the .* is not valid before 2026-11-21 12:00:01 UTC$"),
    ],
    "revoked": [
        ("as initiator$", "reply", "^the certificate of .* was revoked on 2026-11-21 .*keyComp"),
        ("as replier$", "final", "^the certificate of .* was revoked on 2026-11-21 .*keyComp"),
    ],
    "plain-signature": [
        ("as initiator$", "reply", "^c.dsign_algo 'ECDSA-SHA256' does not match"),
        ("as replier$", "final", "^c.dsign_algo 'ECDSA-SHA256' does not match"),
    ],
    "half-signature": [
        ("as initiator$|in the final$", "authenticated", BAD_SIGNATURE),
        ("as replier$|in the reply$", "final", BAD_SIGNATURE),
    ],
    "stripped-certificate": [
        ("as initiator$", "reply", "^the certificate of CN=/[a-z]+ has no alternative signature$"),
        ("as replier$", "final", "^the certificate of CN=/[a-z]+ has no alternative signature$"),
    ],
    "broken-ca": [
        ("^no .*as initiator$", "reply", "^the certificate of .* has no alternative signature$"),
        ("^no .*as replier$", "final", "^the certificate of .* has no alternative signature$"),
        ("as initiator$", "reply", "^the alternative signature of .*: bad ml-dsa-65 signature$"),
        ("as replier$", "final", "^the alternative signature of .*: bad ml-dsa-65 signature$"),
    ],
    "participant-as-ca": [
        (
            "as initiator$",
            "reply",
            "CN=/[a-z]+ was issued by CN=/[a-z]+, not by CN=Lab (hybrid )?Identity",
        ),
        (
            "as replier$",
            "final",
            "CN=/[a-z]+ was issued by CN=/[a-z]+, not by CN=Lab (hybrid )?Identity",
        ),
    ],
    "claimed-guid": [
        ("as initiator$", "reply", "^the GUID in c.pdata does not belong to the certificate's"),
        ("as replier$", "final", "^the GUID in c.pdata does not belong to the certificate's"),
    ],
    "borrowed-permissions": [("", "admits", "may not join domain 0: no grant is for CN=/")],
    "forged-permissions": [
        (
            "^by ",
            "admits",
            "not signed by CN=Lab (hybrid )?Permissions CA but by another certificate",
        ),
        ("with its own name", "admits", "the content was changed after signing"),
        ("^not signed", "admits", "not an S/MIME signed document"),
        ("^none", "admits", "the file is empty"),
    ],
    "stripped-permissions": [("", "admits", "there is no post-quantum signature")],
    "bad-public-key": [
        ("^(a byte short|a byte long|empty|a zero byte)", "reply", UNSIZED),
        ("^all 0xff", "reply", "^bad .* public key$"),
        ("", "reply", "^bad .* public key$"),
        ("", "message", OTHER_KEYS),
    ],
    "bad-ciphertext": [
        ("^(a byte short|a byte long|empty|a zero byte)", "final", UNSIZED),
        ("", "final", "^bad .* ciphertext$"),
        ("", "message", OTHER_KEYS),
    ],
    "insider-in-the-middle": [
        ("^dh1 and dh2 forwarded$", "message", "is for another participant$|" + OTHER_KEYS)
    ],
    "convert-version": [
        ("back$", "final", BAD_SIGNATURE),
        ("^the request", "final", "^a message of version 1; allowed here: 2$"),
        ("^the final", "authenticated", "^a message of version [12]; allowed here: [12]$"),
    ],
    "strip-version": [
        ("request$", "reply", "^c.id is missing"),
        ("reply$", "final", "^c.id is missing"),
        ("final$", "authenticated", "^challenge1 is missing"),
    ],
    "spoil-credentials": [
        ("^a bomb", "reply", "^credentials larger than 163840 bytes$"),
        ("end", "reply", "^the deflated credentials end too soon, or bytes follow them$"),
        ("^another form", "reply", "^the credentials are not deflated with pqsec's dictionary$"),
        ("^a certificate alone", "reply", "CMS|ends too soon|DER"),
        # Which structure breaks depends on the signature's bytes; that C27 refuses is checked.
        ("^a certificate cut short", "reply", ""),
    ],
    "weaker-set": [
        ("as initiator$", "reply", NOT_NAMED),
        ("as replier$", "final", OTHER_SET),
    ],
    "forged-weaker-set": [
        ("as initiator$", "reply", NOT_NAMED),
        ("as replier$", "final", OTHER_SET),
    ],
    "other-name": [
        ("as initiator$", "reply", "^the certificate's subject is not the one that was announced$"),
        ("as replier$", "final", "the certificate's subject is not the one that was announced"),
    ],
    "mixed-sets": [("", "admits", "not signed by CN=Lab hybrid Permissions CA but by another")],
    "replay-weaker-set": [
        ("^the request", "reply", NOT_NAMED),
        ("^the reply", "final", OTHER_SET),
        ("^the final", "authenticated", "^hash_c1 is not as expected"),
    ],
}


def made(root, profile):
    options = {"name": "Lab", "domains": DOMAIN, "validity": 10 * YEAR, "passphrase": None}
    keystore = Keystore.create(root, *map(profile_named, profile.split(",")), now=NOW, **options)
    unlocked = keystore.unlock(None)
    # The listener's certificate begins later and ends earlier.
    for name, now, validity in (("/talker", NOW, YEAR), ("/listener", NOW + HOUR, YEAR / 2)):
        spec = ParticipantSpec(
            name=name, domains=DOMAIN, publish=("rt/chatter",), validity=validity
        )
        issue(keystore, unlocked, [spec], now=now)
    return keystore


def content(root):
    return {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    """occasion("pq"): two of that profile would meet. The CA's keys are not there."""

    @cache
    def make(profile):
        keystore = made(tmp_path_factory.mktemp(profile) / "k", profile)
        for each in keystore.sets:
            shutil.rmtree(each.folder / "private")
        stock = StockPeers() if len(keystore.profiles) > 1 else None
        return HandshakeSetup(keystore=keystore, domain=0, now=NOW, stock=stock)

    return make


GUESTS = HandshakeParty(name="/talker"), HandshakeParty(name="/listener")


@pytest.fixture(scope="module")
def attack_report(setup):
    """siege("pq"): all attacks on two of that profile, which change nothing in the keystore."""

    @cache
    def make(profile):
        found = setup(profile)
        before = content(found.keystore.root)
        report = run_attacks(found, *GUESTS, ATTACKS)
        assert content(found.keystore.root) == before
        return report

    return make


@pytest.fixture
def context(setup):
    """scene("pq"): what an attacker of two of that profile finds."""

    def find(profile):
        meeting = HandshakeCheck(setup(profile))
        session = meeting.prepare(*GUESTS)
        meeting.perform(session)
        return AttackContext(session=session, recorded=meeting.report().sent)

    return find


def judge(step, attack_report):
    """Who refuses at that step."""
    words = step.split()
    if "admits" in words:
        return words[0]
    if "message" in words:
        return words[-1]
    return attack_report.control.initiator if step == "final" else attack_report.control.replier


def fits(result, expected):
    what, step, cause = expected
    at = result.step.name.split()
    return re.search(what, result.what) and step in at and re.search(cause, result.step.detail)


@each_profile
@pytest.mark.parametrize("name", ALL)
def test_an_attack_is_refused_where_the_table_says(attack_report, profile, name):
    attack_report = attack_report(profile)
    [outcome] = [each for each in attack_report.outcomes if each.attack.name == name]
    assert outcome.ok
    if name in FOR_TWO_KEYS and profile != "transition":
        assert outcome.skipped == f"participants of profile {profile.split(',')[-1]} have one key"
        return
    if name in OF_SETS and profile != SETS:
        assert re.fullmatch("/[a-z]+ has one set of credentials here", outcome.skipped)
        return
    if name in OF_VERSIONS and profile == "classical":
        assert outcome.skipped == "messages with ECDH+prime256v1-CEUM have one version"
        return
    for result in outcome.results:
        assert result.refused
        assert any(fits(result, each) for each in EXPECTED[name]), result
        assert result.by == judge(result.step.name, attack_report)
        assert not ("as initiator" in result.what and result.by == attack_report.control.initiator)
        assert not ("as replier" in result.what and result.by == attack_report.control.replier)
    assert all(
        any(re.search(what, result.what) for result in outcome.results)
        for what, *_ in EXPECTED[name]
    )


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda row: row.name)
def test_a_row_names_the_steps_that_refuse_it_and_no_others(attack_report, attack):
    sieges = [attack_report(profile) for profile in NAMES]
    results = [
        result
        for each in sieges
        for outcome in each.outcomes
        if outcome.attack is attack
        for result in outcome.results
    ]
    seen = {
        word for word in attack.refused_at for each in results if word in each.step.name.split()
    }
    assert seen == set(attack.refused_at)
    assert all(set(attack.refused_at) & set(each.step.name.split()) for each in results)


def test_the_attacks_are_all_known_here_by_names_that_can_be_typed():
    assert list(EXPECTED) == ALL
    assert len(set(ALL)) == len(ALL)
    assert all(re.fullmatch("[a-z]+(-[a-z]+)*", name) for name in ALL)
    assert [attack_named(name.upper()) for name in ALL] == list(ATTACKS)


def test_an_unknown_attack_is_told_with_those_there_are():
    with pytest.raises(UnknownAlgorithmError, match="no attack named 'nothing'") as error:
        attack_named("nothing")
    assert all(name in error.value.hint for name in ("all", *ALL))


# Would they show it?


def trusting(context, **policy):
    """The same two, who insist on less."""
    one, other = (
        replace(side, terms=replace(side.terms, policy=replace(side.terms.policy, **policy)))
        for side in context.session.sides
    )
    return replace(context, session=replace(context.session, initiator=one, replier=other))


def through(name, context):
    """What of that attack gets through."""
    results = attempted(attack_named(name), context).results
    assert all((each.by, each.step) == (None, None) for each in results if not each.refused)
    return [each.what for each in results if not each.refused]


@pytest.mark.parametrize(
    ("name", "policy", "what"),
    [
        ("plain-signature", {"require_alternative": False}, "the plain key alone"),
        ("broken-ca", {"require_alternative": False}, "no alternative signature"),
        ("downgrade", {"agreements": tuple(KEY_AGREEMENTS)}, "ecdh-p256 in the request"),
    ],
)
def test_an_attack_gets_through_where_the_policy_lets_it(context, name, policy, what):
    found = through(name, trusting(context("transition"), **policy))
    assert found
    assert any(each.startswith(what) for each in found)


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_attacks_on_a_key_agreement_are_refused_whichever_it_is(setup, row):
    names = ("change-request", "change-reply", "key-in-the-middle", "downgrade")
    attacks = [attack_named(name) for name in (*names, "bad-public-key", "bad-ciphertext")]
    attack_report = run_attacks(replace(setup("classical"), agreement=row), *GUESTS, attacks)
    assert attack_report.control.key_agreement == row.wire_name
    assert attack_report.ok, attack_report.verdict
    for outcome in attack_report.outcomes:
        for result in outcome.results:
            assert any(fits(result, each) for each in EXPECTED[outcome.attack.name]), result


# What is made of it


def nothing_done(context):
    """An attacker who lets everything pass."""
    yield context.between("nothing")


def stops_itself(context):
    """An attacker who finds the other's certificate wrong."""
    one, _ = context.session.sides
    another_ca = one.participant.permissions_ca
    posed = replace(context.session, initiator=with_identity(one, ca=another_ca))
    yield Attempt("with another CA", posed, one.name)


def harmless(act, *checks):
    return Attack(
        name="harmless",
        attacker=Attacker.INSIDER,
        title="nothing",
        refused_at=(),
        checks=checks,
        act=act,
    )


@pytest.mark.parametrize("act", [nothing_done, stops_itself])
def test_what_nobody_refuses_got_through(setup, act):
    attack_report = run_attacks(
        setup("classical"), *GUESTS, [harmless(act), attack_named("replay")]
    )
    assert not attack_report.ok
    assert attack_report.verdict == "1 of 2 attacks succeeded: harmless"
    bad, good = attack_report.to_json()["attacks"]
    assert (bad["ok"], bad["refused"], good["ok"], good["refused"]) == (False, 0, True, 7)
    [attempt] = bad["attempts"]
    assert attempt | {"what": ""} == {
        "what": "",
        "refused": False,
        "by": None,
        "step": None,
        "cause": None,
        "checks": [],
        "shares_key": False,
    }
    assert "SECURITY.md" in bad["hint"]
    assert "hint" not in good


@pytest.mark.parametrize("due", [Code.C26, Code.EXPIRED])
def test_what_another_check_refuses_than_is_due_got_through(setup, due):
    """So an attack cannot seem to be refused while the check that it tries is broken."""
    attack = attack_named("reflect-message")
    attack_report = run_attacks(setup("classical"), *GUESTS, [replace(attack, checks=(due,))])
    assert attack_report.ok is (due is Code.C26)
    [result] = attack_report.outcomes[0].results
    assert (result.refused, result.step.codes) == (attack_report.ok, {Code.C26})


@pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
def test_an_insider_in_the_middle_has_two_share_a_key_only_with_a_plain_suite(setup, row):
    """And the first protected message tells (docs/reference/wire.md, 15)."""
    attacks = [attack_named("insider-in-the-middle")]
    attack_report = run_attacks(replace(setup("classical"), agreement=row), *GUESTS, attacks)
    assert attack_report.ok, attack_report.verdict
    [result] = attack_report.outcomes[0].results
    assert result.shares_key is not row.binds_transcript
    cause = OTHER_KEYS if row.binds_transcript else "is for another participant$"
    assert re.search(cause, result.step.detail)


def test_an_attack_without_attempts_proves_nothing(setup):
    attack_report = run_attacks(setup("classical"), *GUESTS, [harmless(lambda _: iter(()))])
    assert not attack_report.ok
    assert attack_report.outcomes[0].example is None


def test_where_the_two_do_not_meet_nothing_is_tried(setup):
    told = []
    elsewhere = replace(setup("classical"), domain=5)
    attack_report = run_attacks(elsewhere, *GUESTS, ATTACKS, told.append)
    assert not attack_report.ok
    assert attack_report.outcomes == ()
    assert told == []
    assert attack_report.verdict.startswith(
        "the handshake fails without an attacker, so attacks prove nothing"
    )
    assert "documents of /talker failed: /talker may not join domain 5" in attack_report.verdict


def test_each_attack_is_told_once_it_is_over(setup):
    told = []
    attacks = [attack_named(name) for name in ("reflect", "broken-ca")]
    attack_report = run_attacks(setup("pq"), *GUESTS, attacks, told.append)
    assert tuple(told) == attack_report.outcomes
    assert attack_report.verdict == "1 attack in 2 attempts, all refused"
    reflect, skipped = json.loads(json.dumps(attack_report.to_json()))["attacks"]
    assert reflect["attempts"][0] == {
        "what": "its own credentials, in the request",
        "refused": True,
        "by": "/listener",
        "step": "reply",
        "cause": attack_report.outcomes[0].example.step.detail,
        "checks": ["C12", "C13"],
        "shares_key": False,
    }
    assert skipped["skipped"] == "participants of profile pq have one key"


def test_permissions_that_are_for_both_are_not_borrowed(tmp_path):
    keystore = made(tmp_path / "k", "classical")
    folders = [keystore.root / "enclaves" / name for name in ("talker", "listener")]
    documents = [Permissions.from_xml((each / "permissions.xml").read_bytes()) for each in folders]
    both = Permissions(grants=tuple(grant for each in documents for grant in each.grants))
    ca = keystore.unlock(None).permissions
    for folder in folders:
        signed = sign(both.to_xml(), Signer(ca.certificate, ca.key), now=NOW)
        (folder / "permissions.p7s").write_bytes(signed)
    setup = HandshakeSetup(keystore=keystore, domain=0, now=NOW)
    attacks = [attack_named(name) for name in ("reflect", "borrowed-permissions")]
    attack_report = run_attacks(setup, *GUESTS, attacks)
    assert attack_report.ok, attack_report.verdict
    _, borrowed = attack_report.outcomes
    assert borrowed.skipped == "the permissions of /listener are for /talker too"


def test_a_stock_stack_is_not_attacked(setup):
    stock = HandshakeParty(name="/listener", stack=stack_named("cyclonedds"))
    with pytest.raises(UsageError, match="not on that of Cyclone DDS"):
        run_attacks(setup("classical"), GUESTS[0], stock, ATTACKS)
