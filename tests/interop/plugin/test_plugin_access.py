"""The plugin's access control, in C and out of it, and Cyclone DDS's own as the measure.

Also the declarations of the interface that both have.
"""

import ctypes
import shutil
import subprocess
from collections import Counter
from contextlib import ExitStack
from ctypes import CFUNCTYPE, POINTER
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from pqsec_pki.access import SPEC, Action, Viewpoint, decide
from pqsec_pki.documents import Governance, Grant, Permissions, ProtectionKind
from pqsec_pki.plugin.attributes import BUILTIN
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.smime import Signer, sign
from tests.interop.conftest import DOMAINS, TOPIC, YEAR
from tests.interop.cyclone_abi import ACCESS_CONTROL, RefusedError, started
from tests.interop.cyclone_access import access_control
from tests.interop.cyclone_types import (
    Byte,
    EndpointAttributes,
    Failure,
    Handle,
    ParticipantAttributes,
    Properties,
    Qos,
    Structure,
    Text,
)
from tests.interop.policies import Maker, questions
from tests.unit.plugin_wire import FILES

pytestmark = pytest.mark.interop

DOMAIN = 0
HEADERS = Path("/usr/include/dds/security/dds_security_api.h")
_pointer = ctypes.c_void_p


def test_the_interface_is_declared_as_in_the_installed_headers(requires):
    requires(HEADERS if HEADERS.exists() else None, "Cyclone DDS's headers", "cyclonedds-dev")
    check = Path(__file__).with_name("abi_check.c")
    command = ["cc", "-std=c11", "-fsyntax-only", "-I", SOURCES, check]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


class TopicAttributes(Structure):
    _fields_ = tuple((name, Byte) for name in ("read", "write", "discovery", "liveliness"))


def _getter(kind, *more):
    return CFUNCTYPE(Byte, _pointer, Handle, *more, POINTER(kind), POINTER(Failure))


class WithAttributes(ACCESS_CONTROL):
    """The table, further than other tests need it."""

    _fields_ = (
        ("set_listener", _pointer),
        ("return_permissions_token", _pointer),
        ("return_permissions_credential_token", _pointer),
        ("get_participant_sec_attributes", _getter(ParticipantAttributes)),
        ("get_topic_sec_attributes", _getter(TopicAttributes, Text)),
        ("get_datawriter_sec_attributes", _getter(EndpointAttributes, Text, _pointer, _pointer)),
        ("get_datareader_sec_attributes", _getter(EndpointAttributes, Text, _pointer, _pointer)),
    )


def _numbers(attributes):
    return {
        name: getattr(attributes, name) for name, *_ in attributes._fields_ if name != "properties"
    }


class Answers:
    """What a plugin says of a governance document."""

    def __init__(self, plugin, folder):
        properties = {name: f"file:{folder / file}" for name, file in FILES.items()}
        self._plugin, self._qos = plugin, Qos(properties=Properties.of(properties.items()))
        self._handle = plugin.call(
            "validate_local_permissions", plugin.instance, 1, DOMAIN, self._qos
        )

    def participant(self):
        found = ParticipantAttributes()
        self._plugin.call("get_participant_sec_attributes", self._handle, found)
        return _numbers(found)

    def topic(self, name):
        found = TopicAttributes()
        self._plugin.call("get_topic_sec_attributes", self._handle, name.encode(), found)
        return _numbers(found)

    def endpoint(self, kind, name):
        found = EndpointAttributes()
        function = f"get_{kind}_sec_attributes"
        self._plugin.call(function, self._handle, name.encode(), None, None, found)
        return _numbers(found)


def _governances():
    """Each kind of protection of each kind of traffic, and each switch both ways."""
    plain = Governance.protected(DOMAINS).domain_rules[0]
    topic = plain.topic_rules[0]
    for number, (kind, switch) in enumerate(product(ProtectionKind, (False, True))):
        data = list(ProtectionKind)[number % 3]
        each = replace(
            topic,
            enable_discovery_protection=switch,
            enable_liveliness_protection=not switch,
            enable_read_access_control=switch,
            enable_write_access_control=number % 4 < 2,
            metadata_protection_kind=kind,
            data_protection_kind=data,
        )
        yield Governance(
            domain_rules=(
                replace(
                    plain,
                    allow_unauthenticated_participants=switch,
                    enable_join_access_control=number % 4 < 2,
                    rtps_protection_kind=kind,
                    discovery_protection_kind=list(ProtectionKind)[(number + 1) % 5],
                    liveliness_protection_kind=list(ProtectionKind)[(number + 3) % 5],
                    topic_rules=(replace(each, topic_expression="rt/*"), topic),
                ),
            )
        )


@pytest.mark.slow(but=4)
@pytest.mark.parametrize("number", range(10))
def test_governance_means_the_same_as_to_cyclones_own_plugin(shim, plugins, labs, enclave, number):
    lab, governance = labs("classical"), list(_governances())[number]
    folder = enclave(lab.alice, {})
    (folder / "governance.p7s").unlink()
    (folder / "governance.p7s").write_bytes(lab.sign(governance.to_xml()))
    with ExitStack() as stack:
        ours, theirs = (
            Answers(
                stack.enter_context(
                    started(each / "libdds_security_ac.so", "access_control", WithAttributes)
                ),
                folder,
            )
            for each in (shim.folder, plugins)
        )
        assert ours.participant() == theirs.participant()
        for name in (TOPIC, "another", *sorted(BUILTIN)):
            assert ours.topic(name) == theirs.topic(name), name
            for kind in ("datawriter", "datareader"):
                assert ours.endpoint(kind, name) == theirs.endpoint(kind, name), name


def test_what_was_asked_once_is_known_even_when_the_agent_is_gone(shim, labs):
    library = shim.folder / "libdds_security_ac.so"
    with started(library, "access_control", WithAttributes) as plugin:
        answers = Answers(plugin, labs("pq").alice)
        before = [answers.endpoint("datawriter", name) for name in (TOPIC, "DCPSTopic")]
        shim.kill_agent()
        after = [answers.endpoint("datareader", name) for name in (TOPIC, "DCPSTopic")]
        assert after == before
        with pytest.raises(RefusedError, match="the agent is gone"):
            answers.endpoint("datareader", "another")
        with pytest.raises(RefusedError, match="create the participant again"):
            answers.topic(TOPIC)


def _granted(lab, enclave, **grant):
    permissions = Permissions(
        grants=(
            replace(
                Grant.least(
                    subject_name="CN=/lab/alice",
                    not_before=lab.now - YEAR,
                    not_after=lab.now + YEAR,
                    domains=DOMAINS,
                    publish=[TOPIC],
                    subscribe=[TOPIC],
                ),
                **grant,
            ),
        )
    )
    return enclave(lab.alice, {"permissions.p7s": lab.sign(permissions.to_xml())})


def refused(shim, folder, words):
    """The plugin refuses a participant with the files in `folder`, and says why."""
    library = shim.folder / "libdds_security_ac.so"
    with (
        started(library, "access_control", WithAttributes) as ours,
        pytest.raises(RefusedError, match=words),
    ):
        Answers(ours, folder)


def test_a_grant_for_a_longer_subject_is_not_for_a_shorter_one(shim, plugins, labs, enclave):
    """Which Cyclone DDS's own plugin takes: it compares pieces."""
    folder = _granted(labs("classical"), enclave, subject_name="CN=/lab/alice/admin")
    with started(plugins / "libdds_security_ac.so", "access_control", WithAttributes) as theirs:
        assert Answers(theirs, folder)
    refused(shim, folder, "they have no grant for CN=/lab/alice")


def test_a_grant_that_is_not_in_force_is_refused(shim, labs, enclave):
    lab = labs("pq")
    folder = _granted(lab, enclave, not_after=lab.now - YEAR / 2)
    refused(shim, folder, "not valid now")


def test_documents_of_another_signer_or_changed_are_refused(shim, labs, other_labs, enclave):
    lab = labs("pq")
    message = (lab.alice / "permissions.p7s").read_bytes()
    for words, content in (
        ("not signed by", (other_labs("pq").alice / "permissions.p7s").read_bytes()),
        ("changed after", message.replace(b"rt/chatter", b"rt/shatter", 1)),
    ):
        folder = enclave(lab.alice, {"permissions.p7s": content})
        refused(shim, folder, words)


def test_a_countersignature_may_not_be_stripped(shim, labs, enclave):
    """Documents of a transition domain have one; the plugin knows by the CA beside the other."""
    lab = labs("transition")
    one, document = lab.authorities.permissions, (lab.alice / "permissions.xml").read_bytes()
    stripped = sign(document, Signer(one.certificate, one.key), now=lab.now)
    folder = enclave(lab.alice, {"permissions.p7s": stripped})
    refused(shim, folder, "no post-quantum signature")


def test_it_answers_as_the_standard(shim, labs, tmp_path):
    """Own endpoints and peers', through the structures that Cyclone DDS hands over."""
    lab, answers = labs("classical"), Counter()
    folder = shutil.copytree(lab.alice, tmp_path / "alice")
    for seed in range(12):
        made = Maker(seed)
        governance, permissions = made.governance(), made.permissions("CN=/lab/alice")
        (folder / "governance.p7s").unlink()
        (folder / "governance.p7s").write_bytes(lab.sign(governance.to_xml()))
        (folder / "permissions.p7s").write_bytes(lab.sign(permissions.to_xml()))
        with access_control(shim.folder, folder, DOMAIN) as plugin:
            for question in questions("CN=/lab/alice", DOMAIN, SPEC):
                if question.action is Action.RELAY or question.topic in BUILTIN:
                    continue
                for side, refusal in ((Viewpoint.OWN, plugin.own), (Viewpoint.PEER, plugin.peer)):
                    wanted = decide(governance, permissions, question, by=side)
                    said = refusal(question)
                    assert wanted.allowed is not bool(said), (question, side, said, wanted.reason)
                    answers[wanted.allowed] += 1
    assert min(answers[True], answers[False]) > 100, answers
