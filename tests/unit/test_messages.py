"""The table of stacks' security errors, and how a text is looked up in it."""

import re

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.cli import pqsec
from pqsec_pki.vendors._log import MAX_VALUE
from pqsec_pki.vendors.messages import MessageKind, messages, nearest, recognise

STACKS = {"cyclonedds", "fastdds", "opendds", "ros2"}
CYCLONE_CODES = {100, *range(110, 153), 200, 301}

# What stacks were seen to say (the tests of tests/interop) -> what it is.
MEASURED = {
    "Error occurred while validating local permission: Certificate authentication algorithm"
    " unknown(code: 125)": "Certificate authentication algorithm unknown",
    "asn1 encoding routines:SMIME_text:mime no content type": "mime no content type",
    "Failed to parse PKCS7 SMIME document: error:1D000000:X509_PUBKEY_get0:decode error:"
    "X509_self_signed:unable to get certs public key": "X509_PUBKEY_get0:decode error",
    "evp_pkey_signature_init:provider signature not supported: ML-DSA-65 verify_init"
    " PKCS7_signatureVerify:signature failure": "provider signature not supported",
    "certificate verify error:Verify error: self-signed certificate": "certificate verify error",
    "PKCS7_get0_signers:signer certificate not found": "signer certificate not found",
    "RTPS protection is unsupported": "RTPS protection is unsupported",
    "(12|34) SSL::DiffieHellman::factory: ERROR, unknown kagree_algo": (
        "SSL::DiffieHellman::factory: ERROR, unknown kagree_algo"
    ),
    "peer: tpp.c:83: __pthread_tpp_change_priority: Assertion `new_prio == -1 ||": (
        "__pthread_tpp_change_priority"
    ),
    "Subject name is invalid(code: 146)": "Subject name is invalid",
    "Process handshake failed: Failed to finalize digest context: (code: 200)": (
        "Failed to finalize digest context"
    ),
    "Process handshake failed: Certificate not valid: error: certificate revoked; subject:"
    r" /CN=\/tl\/talker(code: 200)": "certificate revoked",
    "unable to get local issuer certificate": "unable to get local issuer certificate",
    "HandshakeMessageToken property c.dsign_algo not supported(code: 200)": (
        "HandshakeMessageToken property c.dsign_algo not supported"
    ),
    "Failed to convert octet sequence to ASN1 integer: (code: 200)": (
        "Failed to convert octet sequence to ASN1 integer"
    ),
    "Could not find domain 1 in governance(code: 141)": "Could not find domain 1 in governance",
    "Could not load Authentication plugin.": "Could not load Authentication plugin",
    "Invalid Crypto Handle": "Invalid Crypto Handle",
    "Remote secure participant 1104c5:2b:0:1c1 not allowed": (
        "Remote secure participant 1104c5:2b:0:1c1 not allowed"
    ),
    "/CycloneDDS/Domain: Security: unknown element": "Security: unknown element",
    "[SECURITY Error]  -> Function validate_local_identity": "Function validate_local_identity",
    "Invalidation error of certificate  (unspecified certificate verification error)": (
        "unspecified certificate verification error"
    ),
    "Invalidation error of certificate  (certificate revoked)": "certificate revoked",
    "Cannot init signature (478150778) (/src/security/authentication/PKIDH.cpp:395)": (
        "Cannot init signature"
    ),
    "[RTPS_PARTICIPANT Error] Cannot create participant due to initialization error": (
        "Cannot create participant due to initialization error"
    ),
    "Participant is not allowed with its own permissions file.": (
        "Participant is not allowed with its own permissions file"
    ),
    "Error verifying private key key.pem": "Error verifying private key key.pem",
    "Cannot serialize ParticipantGenericMessage": "Cannot serialize ParticipantGenericMessage",
    "Not supported signature algorithm (ECDSA-SHA256\0)": (
        r"Not supported signature algorithm (ECDSA-SHA256\u0000"
    ),
    "Remote participant PermissionsCA algorithm differs from local": (
        "Remote participant PermissionsCA algorithm differs from local"
    ),
    "Local identity certificate has expired": "Local identity certificate has expired",
    "rmw_create_node: failed to create DDS participant": "failed to create DDS participant",
    "failed to create client: failed to create topic [rq/talker/get_parametersRequest] for"
    " unknown reasons": (
        "failed to create topic [rq/talker/get_parametersRequest] for unknown reasons"
    ),
    "Failed to initialize type description service": (
        "Failed to initialize type description service"
    ),
    "[INFO] [rmw_cyclonedds_cpp]: could not find all security files": (
        "could not find all security files"
    ),
    "failed to initialize rcl: error not set": "failed to initialize rcl: error not set",
    "SECURITY ERROR: directory '/ks/enclaves/nope' does not exist., at security.c:202": (
        "SECURITY ERROR: directory '/ks/enclaves/nope' does not exist"
    ),
    "Expected RMW implementation identifier of 'rmw_cyclonedds_cpp' but instead found"
    " 'rmw_fastrtps_cpp', exiting with 102": (
        "Expected RMW implementation identifier of 'rmw_cyclonedds_cpp' but instead found"
        " 'rmw_fastrtps_cpp'"
    ),
    "[INFO] [rcl]: Found security directory: /ks/enclaves/talker": (
        "Found security directory: /ks/enclaves/talker"
    ),
    "ERROR: dds_create_topic: Not Allowed By Security": "Not Allowed By Security",
    "private key: bad decrypt ... empty password": "bad decrypt",
    "failed to create reader": "failed to create reader",
}


@pytest.mark.parametrize(("text", "best"), MEASURED.items())
def test_a_message_that_was_measured_is_recognised(text, best):
    assert [found.said for found in recognise(text)][:1] == [best]


def test_the_table_has_every_code_of_cyclone():
    rows = messages("cyclonedds")
    codes = [row.code for row in rows if row.code is not None]
    assert sorted(codes) == sorted(CYCLONE_CODES)
    assert {row.code for row in messages()} == {None, *CYCLONE_CODES}


@pytest.mark.parametrize("row", messages(), ids=lambda row: row.title)
def test_a_row_of_the_table_is_whole(row):
    assert set(row.stacks) <= STACKS
    assert row.stacks
    assert row.texts or row.code
    assert row.cause.endswith((".", "}"))
    assert row.remedy.endswith(".")
    assert re.match(r"(measured|read), ", row.evidence)
    named = {name for text in row.texts for name in re.findall(r"\{(\w+)\}", text)}
    assert set(re.findall(r"\{(\w+)\}", row.cause + row.remedy)) <= named


def commands_in(text):
    """(command, its options) for each pqsec command in backticks."""
    for line in re.findall(r"`pqsec ([^`]+)`", text):
        words = line.split()
        command = pqsec.get_command(None, words.pop(0))
        while words and isinstance(command, click.Group):
            command = command.get_command(None, words.pop(0))
        yield command, {word for word in words if word.startswith("--")}


@pytest.mark.parametrize("row", messages(), ids=lambda row: row.title)
def test_a_remedy_names_commands_and_options_there_are(row):
    for command, options in commands_in(f"{row.cause} {row.remedy}"):
        assert command is not None
        assert options <= {name for parameter in command.params for name in parameter.opts}


def test_no_text_stands_in_two_rows():
    texts = [text.lower() for row in messages() for text in row.texts]
    assert [text for text in texts if texts.count(text) > 1] == []


@pytest.mark.parametrize("row", messages(), ids=lambda row: row.title)
def test_every_text_is_recognised_as_its_row(row):
    for text in row.texts:
        said = re.sub(r"\{(\w+)\}", "7", text)
        assert row in [each.message for each in recognise(said)], said


@pytest.mark.parametrize("code", sorted(CYCLONE_CODES))
@pytest.mark.parametrize("form", ["{}", "code {}", "(code: {})", "something new(code: {})"])
def test_a_code_is_recognised(code, form):
    (found,) = recognise(form.format(code))
    assert (found.message.code, found.message.stacks) == (code, ("cyclonedds",))


def test_words_that_name_the_cause_make_their_code_needless():
    (found,) = recognise("rt/chatter denied by default rule(code: 145)")
    assert (found.message.code, found.values) == (None, {"topic": "rt/chatter"})


def test_what_changes_in_a_message_stands_in_cause_and_remedy():
    [found] = recognise("check_create_datawriter: rt/chatter found in deny_rule.(code: 145)")
    assert "names rt/chatter." in found.cause
    assert "--publish rt/chatter --as" in found.remedy


@pytest.mark.parametrize(
    "topic", ["rt/x; reboot", "$(id)", "`id`", "--force", "a\u0131", "x" * 201]
)
def test_what_no_command_should_have_stays_out_of_the_remedy(topic):
    [found] = recognise(f"failed to create topic [{topic}] for unknown reasons")
    assert topic in found.cause
    assert "--publish TOPIC" in found.remedy


def test_control_characters_are_not_passed_on():
    [found] = recognise("failed to create topic [rt/\x1b[2J] for unknown reasons")
    assert "\x1b" not in found.said + found.cause + found.remedy


LOG = r"""
1795279814.24 [0] talker: using network interface lo
1795279814.25 [0] recv: Process handshake failed: Certificate not valid: error:
  certificate revoked; subject: /CN=\/lab\/bob(code: 200)
1795279815.25 [0] recv: Process handshake failed: Certificate not valid: error: certificate
  revoked; subject: /CN=\/lab\/bob(code: 200)
1795279816.01 [0] talker: failed to create topic [rt/a] for unknown reasons
1795279816.02 [0] talker: failed to create topic [rt/b] for unknown reasons
[INFO] [rcl]: Found security directory: /ks/enclaves/talker
"""


def test_several_messages_in_a_log_are_recognised_causes_first():
    found = recognise(LOG)
    assert [(each.said, each.line, each.times) for each in found] == [
        ("certificate revoked", 4, 2),
        ("failed to create topic [rt/a] for unknown reasons", 7, 1),
        ("failed to create topic [rt/b] for unknown reasons", 8, 1),
        ("Process handshake failed", 3, 2),
        (
            r"Certificate not valid: error: certificate revoked; subject: /CN=\/lab\/bob",
            3,
            2,
        ),
        ("Found security directory: /ks/enclaves/talker", 9, 1),
    ]
    assert [each.message.kind for each in found] == sorted(
        (each.message.kind for each in found), key=list(MessageKind).index
    )


def test_a_message_inside_the_words_of_another_is_not_one_more():
    assert [each.said for each in recognise("SMIME_text:mime no content type")] == [
        "mime no content type"
    ]


def test_a_stack_can_be_chosen():
    text = "certificate revoked, Certificate expired, Cannot load certificate"
    assert {each.said for each in recognise(text)} == {
        *("certificate revoked", "Certificate expired", "Cannot load certificate")
    }
    assert {each.said for each in recognise(text, stack="fastdds")} == {
        *("certificate revoked", "Cannot load certificate")
    }


def test_parts_of_a_message_that_stand_too_far_apart_are_none():
    near, far = (f"failed to create topic [{'x' * n}] for unknown reasons" for n in (300, 301))
    assert MAX_VALUE == 300
    assert recognise(near)
    assert recognise(far) == ()


@pytest.mark.parametrize("text", ["", "hello world", "9" * 50, "{topic}", "\0", "999", "\u0130"])
def test_what_is_no_message_is_not_recognised(text):
    assert recognise(text) == ()


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("certificate authentication algorithm is bad", 125),
        ("the subject name is wrong", 146),
        ("cannot find domain 7 in the permissions", 140),
    ],
)
def test_the_nearest_of_an_unknown_message_is_told(text, first):
    assert recognise(text) == ()
    assert first in [row.code for row in nearest(text)]


def test_nothing_is_near_to_what_has_no_words_of_messages():
    assert nearest("zebra giraffe 12") == ()


PIECES = [piece for row in messages() for text in row.texts for piece in text.split("{")]


@given(st.lists(st.sampled_from(PIECES) | st.text(max_size=20) | st.sampled_from(" \n(:)")))
def test_any_text_is_gone_through(pieces):
    text = "".join(pieces)
    for found in recognise(text):
        assert 1 <= found.line <= text.count("\n") + 1
        assert (found.said + found.cause + found.remedy).isprintable()
    nearest(text)


HOSTILE = [
    "Found " * 300_000,
    "Certificate not valid: error: " * 60_000,
    "failed to create topic [" * 80_000,
    "(code: 200)\n" * 150_000,
    "a\n" * 900_000,
    "x" * 1_800_000,
    " " * 1_800_000,
    "\n" * 1_800_000,
]


@pytest.mark.parametrize("text", HOSTILE, ids=lambda text: repr(text[:12]))
@pytest.mark.timeout(120)  # what is quadratic takes hours
def test_the_time_for_a_log_of_a_megabyte_is_bounded(text):
    recognise(text)


def test_a_signer_that_is_not_found_is_another_ca_before_anything_else():
    """OpenDDS said it of documents of another permissions CA; to embed a certificate is no cure."""
    (found,) = recognise("error:10800080:PKCS7_get0_signers:signer certificate not found")
    assert "Another CA" in found.cause
    assert "pqsec verify" in found.remedy.partition("--embed-certificate")[0]


@pytest.mark.parametrize("said", ["the handshake is over", "expected a 'y', got a 'x'"])
def test_late_answers_to_repeated_messages_are_no_cause_for_alarm(said):
    found = recognise(f"Process handshake failed: pqsec: {said}", stack="cyclonedds")
    assert not any(each.message.kind is MessageKind.CAUSE for each in found)
    [known] = [each for each in found if said in each.said]
    assert "repeat" in known.cause
