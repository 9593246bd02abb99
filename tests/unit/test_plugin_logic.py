"""What the agent does for identities, peers and permissions, without a socket or a shim."""

import os
import shutil
from dataclasses import replace
from itertools import product

import pytest

from pqsec_pki.algorithms import PROFILES, SIGNATURES, Family, profile_named
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.documents import Criteria, DomainSet, Grant, PermissionRule, Permissions
from pqsec_pki.handshake import DataHolder, compact, participant_data
from pqsec_pki.plugin import handles
from pqsec_pki.plugin.authentication import (
    CREDENTIAL,
    CREDENTIAL_PROPERTY,
    NO_TOKEN,
    ValidationResult,
)
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.settings import AgentSettings, SettingsFile
from tests.unit.keystores import DAY, NOW, TWO, made
from tests.unit.plugin_wire import (
    IDENTITY,
    RefusedError,
    Shim,
    new_guid,
    properties,
    shaken,
    side,
)

DOMAINS = DomainSet.of(0)
TOKEN = DataHolder("DDS:Access:Permissions:1.0")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """folders["pq"] are those of two participants of that profile."""
    root = tmp_path_factory.mktemp("keystores")
    stores = {each.name: made(root / each.name, each.name) for each in PROFILES}
    return {name: [one.root / f"enclaves{each}" for each in TWO] for name, one in stores.items()}


@pytest.mark.parametrize("profile", [each.name for each in PROFILES])
def test_an_identity_asks_for_the_key_agreement_of_its_profile(folders, profile):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders[profile][0])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())
    _, _, request = shim.call("begin_handshake_request", identity, peer, b"data")
    found = dict(request.binary_properties)
    wanted = profile_named(profile).key_agreement.wire_name
    assert found["c.kagree_algo"].rstrip(b"\0").decode() == wanted
    assert found["c.pdata"] == b"data"  # all that Cyclone DDS says of itself is signed


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("peers = 1", "a setting has no such value"),
        ("peers = 'all'", "a setting has no such value"),
        ("key_agreements = 'mlkem768'", "a setting has no such value"),
        ("key_agreements = ['kyber768']", "kyber768"),
        ("key_agreement = ['mlkem768']", "key_agreement is not a setting"),
        ("peers: stock", "not TOML"),
        ("wire_versions = 2", "a setting has no such value"),
        ("wire_versions = [3]", "a setting has no such value"),
        ("wire_versions = []", "a setting has no such value"),
        ("wire_versions = [true, 2]", "a setting has no such value"),
        ("wire_versions = [2.0]", "a setting has no such value"),
        ("peers = []", "a setting has no such value"),
        ("proofs = 1", "a setting has no such value"),
        ("[peers]", "a setting has no such value"),
        ("peers = 'stock'", "accepts no ml-dsa-65 key"),
    ],
)
def test_a_setting_that_is_not_understood_is_refused(folders, tmp_path, text, words):
    for file in folders["pq"][0].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "pqsec.toml").write_text(text)
    with pytest.raises(RefusedError, match=words):
        Shim("authentication", NOW).identity(tmp_path)


def test_an_identity_with_keys_that_no_profile_has_asks_for_the_hybrid_key_agreement():
    for kinds in (("ml-dsa-87", "ml-dsa-65"), ("ecdsa-p256", "ml-dsa-87"), ("ml-dsa-44", None)):
        key, second = (each and SIGNATURES.named(each) for each in kinds)
        ca = Authority.create("CA", key, alternative=second, now=NOW, validity=DAY)
        found = AgentSettings.of(ca.certificate, SettingsFile()).agreements
        assert [each.name for each in found] == ["x25519mlkem768"]


@pytest.mark.parametrize("name", ["cert.pem", "key.pem", "pqsec.toml"])
def test_nobody_waits_for_a_pipe_in_the_place_of_a_file(folders, tmp_path, name):
    for file in folders["pq"][0].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    with pytest.raises(RefusedError, match=f"{name} is not a file"):
        Shim("authentication", NOW).identity(tmp_path)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("dds.sec.auth.private_key", "", "is not configured"),
        ("dds.sec.auth.private_key", "pkcs11:token", "'token' in the URI of a key has no valid"),
        ("dds.sec.auth.private_key", "pkcs11:token=\udcff;object=x", "has no valid value"),
        (
            "dds.sec.auth.private_key",
            "pkcs11:token=x;object=x?pin-value=1",
            "the URI of a key contains a PIN",
        ),
        ("dds.sec.auth.identity_ca", "pkcs11:token=x;object=x", "neither file: and a path"),
        ("dds.sec.auth.identity_ca", "data:,x", "no certificate in PEM"),
        ("dds.sec.auth.identity_certificate", "file:nowhere.pem", "no such file"),
        ("dds.sec.auth.trusted_ca_dir", "nowhere", "no such file"),
        ("dds.sec.auth.trusted_ca_dir", "\0", "null"),
        ("dds.sec.auth.private_key", "file:\0", "neither file: and a path"),
    ],
)
def test_a_property_that_is_not_understood_is_refused(folders, name, value, words):
    with pytest.raises(RefusedError, match=words):
        Shim("authentication", NOW).identity(folders["pq"][0], **{name: value})


def test_a_key_that_stands_in_the_wrong_form_is_not_repeated(folders):
    folder, name = folders["classical"][0], "dds.sec.auth.private_key"
    text = (folder / "key.pem").read_text()
    for value in (text, f"data:,{text[:90]}", f"data:{text}", f"file:{text}"):
        shim = Shim("authentication", NOW)
        with pytest.raises(RefusedError) as refusal:
            shim.identity(folder, **{name: value})
        said = f"{refusal.value}{shim.log}".replace("\\u000a", "")
        body = "".join(text.splitlines()[1:-1])
        assert not [at for at in range(len(body) - 8) if body[at : at + 8] in said]


def test_credentials_may_stand_in_the_configuration_itself(folders):
    folder = folders["pq"][0]
    texts = {
        name: f"data:,{(folder / value.removeprefix('file:')).read_text()}"
        for name, value in properties(folder)[0]
    }
    handle, _ = Shim("authentication", NOW).identity("/", **texts)
    assert handle


def test_an_identity_tells_the_second_when_it_ends(folders):
    pairs, where = properties(folders["pq"][0])
    shim = Shim("authentication", NOW)
    *_, end, _ = shim.call("validate_local_identity", 0, where, pairs, new_guid())
    late = (NOW + 90 * DAY).timestamp()
    assert end - 1 == late
    for when, good in ((end - 1, True), (end, False)):
        other = Shim("authentication", NOW.fromtimestamp(when, NOW.tzinfo))
        if good:
            other.identity(folders["pq"][0])
        else:
            with pytest.raises(RefusedError, match="expired on"):
                other.identity(folders["pq"][0])


def test_a_peer_is_one_for_all_our_participants_and_another_when_it_comes_back(folders):
    shim = Shim("authentication", NOW)
    one, other = (shim.identity(each)[0] for each in folders["pq"])
    guid = new_guid()

    def met(identity):
        return shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, guid)[1]

    first = met(one)
    assert met(other) == first
    again = met(one)
    assert again != first  # the first is still to be returned
    shim.call("return_identity_handle", first)
    assert shim.call("begin_handshake_request", one, again, b"")[0] == (
        ValidationResult.PENDING_HANDSHAKE_MESSAGE
    )


def test_a_peer_that_another_participant_met_is_no_peer_of_this_one(folders):
    shim = Shim("authentication", NOW)
    one, other = (shim.identity(each)[0] for each in folders["pq"])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, one, IDENTITY, new_guid())
    with pytest.raises(RefusedError, match="a peer that was not validated"):
        shim.call("begin_handshake_request", other, peer, b"")


def test_what_is_not_a_permissions_credential_is_not_carried_in_handshakes(folders):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["pq"][0])
    for wrong in (
        DataHolder(CREDENTIAL),
        DataHolder(CREDENTIAL, (("dds.perm.certificate", "x"),)),
        DataHolder("DDS:Access:Other", ((CREDENTIAL_PROPERTY, "x"),)),
    ):
        with pytest.raises(RefusedError, match="is not a permissions credential"):
            shim.call("set_permissions_credential_and_token", identity, wrong, TOKEN)


def test_a_secret_comes_with_its_peer_and_when_that_ends(folders):
    ends = shaken(*map(side, folders["pq"]))
    told = [shim.call("get_shared_secret", handshake) for shim, handshake, _ in ends]
    assert told[0][3:] == told[1][3:]
    assert [each[1] for each in told] == [peer for *_, peer in ends]
    assert [each[2] - 1 for each in told] == [(NOW + 90 * DAY).timestamp()] * 2


def test_a_peer_of_another_ca_is_taken_if_that_is_trusted(folders, tmp_path):
    stranger = made(tmp_path / "other", "pq").root / "enclaves/talker"
    ours, trusted = folders["pq"][0], {}
    for name, source in (("here", stranger), ("there", ours)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "README").write_text("no certificate")
        ca = (source / "identity_ca.cert.pem").read_bytes()
        (tmp_path / name / "ca.pem").write_bytes(ca)
        trusted[name] = {"dds.sec.auth.trusted_ca_dir": str(tmp_path / name)}
    assert shaken(side(ours, **trusted["here"]), side(stranger, **trusted["there"]))
    for here, there in ((trusted["here"], {}), ({}, trusted["there"])):
        with pytest.raises(RefusedError, match="not signed by this CA"):
            shaken(side(ours, **here), side(stranger, **there))


def test_a_revocation_list_and_trusted_cas_exclude_each_other(folders, tmp_path):
    more = {
        "dds.sec.auth.trusted_ca_dir": str(tmp_path),
        "org.eclipse.cyclonedds.sec.auth.crl": "file:crl.pem",
    }
    with pytest.raises(RefusedError, match="exclude each other"):
        side(folders["pq"][0], **more)


def test_what_belongs_to_a_participant_goes_with_it(folders):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["pq"][0])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())
    _, handshake, _ = shim.call("begin_handshake_request", identity, peer, b"")
    shim.call("return_identity_handle", identity)
    for call in ("get_shared_secret", "get_authenticated_peer_credential_token"):
        with pytest.raises(RefusedError, match="does not know the handle"):
            shim.call(call, handshake)
    shim.call("return_identity_handle", peer)
    assert shim.connection.what == ("test[1]", "authentication", 0)


def test_only_a_handshake_is_returned_as_one(folders):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["pq"][0])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())
    _, handshake, _ = shim.call("begin_handshake_request", identity, peer, b"")
    for handle in (handshake, handshake, 1, identity, peer):
        shim.call("return_handshake_handle", handle)
    with pytest.raises(RefusedError, match="does not know the handle"):
        shim.call("get_shared_secret", handshake)
    assert shim.call("begin_handshake_request", identity, peer, b"")[1]


def introduced(folders):
    """Two that have heard of each other: each as (shim, identity, the peer's handle, GUID)."""
    sides = (side(folder) for folder in folders)
    (one, own, guid), (other, theirs, peers) = sorted(sides, key=lambda each: each[2])
    _, seen, request = other.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    _, known, _ = one.call("validate_remote_identity", request, own, IDENTITY, peers)
    return (one, own, known, participant_data(guid)), (other, theirs, seen, participant_data(peers))


def test_a_request_is_answered_by_one_reply_and_a_refused_one_is_none(folders):
    (one, own, known, data), (other, theirs, seen, more) = introduced(folders["transition"])
    _, begun, request = one.call("begin_handshake_request", own, known, data)
    replies = [
        other.call("begin_handshake_reply", request, seen, theirs, more)[2] for _ in range(2)
    ]
    spoilt = dict(replies[0].binary_properties) | {"signature": bytes(32)}
    wrong = replace(replies[0], binary_properties=tuple(spoilt.items()))
    with pytest.raises(RefusedError, match="signature"):
        one.call("process_handshake", wrong, begun)
    result, _ = one.call("process_handshake", replies[0], begun)
    assert result == ValidationResult.OK_FINAL_MESSAGE
    secret = one.call("get_shared_secret", begun)
    for again in replies:
        with pytest.raises(RefusedError, match="the handshake is over"):
            one.call("process_handshake", again, begun)
    assert one.call("get_shared_secret", begun) == secret


def test_a_final_is_good_for_the_last_reply_though_all_have_one_announced_challenge(folders):
    (one, own, known, data), (other, theirs, seen, more) = introduced(folders["transition"])
    finals, challenges = [], set()
    for _ in range(2):
        _, begun, request = one.call("begin_handshake_request", own, known, data)
        _, answered, reply = other.call("begin_handshake_reply", request, seen, theirs, more)
        challenges.add(dict(reply.binary_properties)["challenge2"])
        finals.append(one.call("process_handshake", reply, begun)[1])
    assert len(challenges) == 1
    with pytest.raises(RefusedError, match="dh2 is not as expected"):
        other.call("process_handshake", finals[0], answered)
    assert other.call("process_handshake", finals[1], answered) == [ValidationResult.OK, NO_TOKEN]


STOCK_TOKENS = {
    "empty": (),
    "Cyclone DDS": (("dds.cert.sn", "/CN=x"), ("dds.cert.algo", "EC-prime256v1")),
    "Fast DDS": (("dds.cert.algo", "ECDSA-SHA256"),),
    "another list": (("pqsec.kagree_algo", "MLKEM102,MLKEM76,X25519MLKEM76"),),
}


@pytest.mark.parametrize("profile", [each.name for each in PROFILES])
def test_a_peer_that_may_be_a_stock_stack_is_sent_no_request_that_it_may_not_know(folders, profile):
    """OpenDDS crashes on a c.kagree_algo that it does not know."""
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders[profile][0])

    def requested(token):
        _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, token, new_guid())
        return shim.call("begin_handshake_request", identity, peer, b"data")

    wanted = profile_named(profile).key_agreement
    for pairs in STOCK_TOKENS.values():
        token = replace(IDENTITY, properties=pairs)
        if wanted.family is Family.CLASSICAL:
            assert requested(token)
        else:
            with pytest.raises(RefusedError, match=f"that it knows {wanted.wire_name}"):
                requested(token)
    said = shim.call("get_identity_token", identity)[1]
    assert requested(said)
    assert wanted.wire_name in dict(said.properties)["pqsec.kagree_algo"].split(",")


@pytest.fixture
def enclave(folders, tmp_path):
    """A function: an enclave of `folders` with that pqsec.toml."""

    def made_with(profile, text, number=0):
        folder = tmp_path / f"{profile}{number}"
        shutil.copytree(folders[profile][number], folder)
        (folder / "pqsec.toml").write_text(text)
        return folder

    return made_with


def test_two_who_allow_only_the_second_version_meet_with_an_agreement_that_has_only_the_first(
    enclave,
):
    shim = Shim("authentication", NOW)
    ours, theirs = (enclave("classical", "wire_versions = [2]", each) for each in (0, 1))
    (identity, _), (other, guid) = shim.identity(ours), shim.identity(theirs)
    said = shim.call("get_identity_token", other)[1]
    assert dict(said.properties)["pqsec.versions"] == "2"
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, said, guid)
    _, _, request = shim.call("begin_handshake_request", identity, peer, b"data")
    assert "c.id" in dict(request.binary_properties)


def in_other_form(folder):
    """Another header in the signed part, as other signers write it."""
    file = folder / "permissions.p7s"
    plain, other = b"Content-Type: text/plain\n", b"Content-Type: text/plain; charset=us-ascii\n"
    assert plain in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(plain, other))


def test_a_version_that_cannot_carry_our_own_documents_is_neither_announced_nor_used(enclave):
    """Else each Request would fail after discovery had promised that it would not."""
    folder = enclave("pq", "wire_versions = [2, 1]")
    shim = Shim("authentication", NOW)
    announced = []
    for spoil in (lambda _: None, in_other_form):
        spoil(folder)
        identity, _ = shim.identity(folder)
        said = shim.call("get_identity_token", identity)[1]
        announced.append(dict(said.properties).get("pqsec.versions"))
        assert len(shim.log) == (spoil is in_other_form)
    assert announced == ["2,1", None]
    assert "version 2 of the messages cannot carry" in shim.log[0]
    assert "permissions.p7s" in shim.log[0]
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, said, new_guid())
    _, _, request = shim.call("begin_handshake_request", identity, peer, b"data")
    assert "c.id" in dict(request.binary_properties)


def test_documents_that_the_only_configured_version_cannot_carry_are_refused(enclave):
    folder = enclave("pq", "wire_versions = [2]")
    in_other_form(folder)
    with pytest.raises(RefusedError, match="version 2 of the messages cannot carry"):
        Shim("authentication", NOW).identity(folder)
    (folder / "permissions.p7s").unlink()  # which access control reports
    assert Shim("authentication", NOW).identity(folder)
    classical = enclave("classical", "wire_versions = [2]")
    in_other_form(classical)
    assert Shim("authentication", NOW).identity(classical)  # the first version, always


def test_messages_of_a_version_that_is_not_configured_are_not_expanded(folders):
    """Neither a Request nor a Reply that nobody has verified."""
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["pq"][0])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())

    def second(kind):
        names = compact.names(f"DDS:Auth:PKI-DH:1.0+{kind}")
        pairs = tuple((each, b"2" if each == "ver" else b"") for each in names)
        return DataHolder(f"DDS:Auth:PKI-DH:1.0+{kind}", (), pairs)

    with pytest.raises(RefusedError, match="a message of version 2; allowed here: 1"):
        shim.call("begin_handshake_reply", second("Req"), peer, identity, b"")
    _, handshake, _ = shim.call("begin_handshake_request", identity, peer, b"")
    with pytest.raises(RefusedError, match="a message of version 2; allowed here: 1"):
        shim.call("process_handshake", second("Reply"), handshake)


def test_the_identity_token_has_no_name_of_a_ca_that_opendds_would_spell_otherwise(folders):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["transition"][0])
    names = [name for name, _ in shim.call("get_identity_token", identity)[1].properties]
    assert names == ["dds.cert.sn", "dds.cert.algo", "dds.ca.algo", "pqsec.kagree_algo"]


def test_a_secret_is_told_only_when_the_handshake_is_over(folders):
    shim = Shim("authentication", NOW)
    identity, _ = shim.identity(folders["pq"][0])
    _, peer, _ = shim.call("validate_remote_identity", NO_TOKEN, identity, IDENTITY, new_guid())
    _, handshake, _ = shim.call("begin_handshake_request", identity, peer, b"")
    with pytest.raises(RefusedError, match="the handshake is not over"):
        shim.call("get_shared_secret", handshake)


def test_a_handle_of_another_connection_is_unknown(folders):
    handle, _ = Shim("authentication", NOW).identity(folders["pq"][0])
    with pytest.raises(RefusedError, match="does not know the handle"):
        Shim("authentication", NOW).call("get_identity_token", handle)


def test_there_is_an_end_to_objects(monkeypatch):
    monkeypatch.setattr(handles, "MAX_OBJECTS", 2)
    few = Handles()
    few.add("one"), few.add("two")
    with pytest.raises(Exception, match="more than 2"):
        few.add("three")


def test_a_peer_of_an_unknown_participant_has_no_rights(folders):
    shim = Shim("access_control", NOW)
    with pytest.raises(RefusedError, match="a participant that the agent does not know"):
        shim.call("validate_remote_permissions", 1, 2, TOKEN, NO_TOKEN)


def _credential(folder):
    """What authentication says of a peer with the files in `folder`."""
    texts = [(folder / name).read_text() for name in ("cert.pem", "permissions.p7s")]
    return DataHolder("", tuple(zip(("c.id", "c.perm"), texts, strict=True)))


def test_a_peer_is_judged_by_the_documents_of_the_participant_that_met_it(folders):
    """Two participants of a process, each with a permissions CA of its own."""
    shim = Shim("access_control", NOW)
    both = [folders[profile][0] for profile in ("pq", "hybrid")]
    for handle, folder in enumerate(both, 1):
        pairs, where = properties(folder)
        shim.call("validate_local_permissions", handle, 0, where, pairs)
    for handle, folder in enumerate(both, 1):
        credential = _credential(folder)
        assert shim.call("validate_remote_permissions", handle, 9, TOKEN, credential)
        with pytest.raises(RefusedError, match="the peer's permissions"):
            shim.call("validate_remote_permissions", 3 - handle, 9, TOKEN, credential)


def test_a_partition_is_for_who_is_granted_all_that_its_wildcards_stand_for(tmp_path):
    """By its own stack and by its peers, and whatever a peer sends, in so many steps."""
    keystore = made(tmp_path / "k", "pq")
    folder = keystore.root / f"enclaves{TWO[0]}"
    where = (Criteria(topics=("x",), partitions=("floor?", "s*")),)
    secret = (Criteria(topics=("x",), partitions=("secret",)),)
    rules = (
        PermissionRule(allow=False, domains=DOMAINS, publish=secret, subscribe=secret),
        PermissionRule(allow=True, domains=DOMAINS, publish=where, subscribe=where),
    )
    subject = Certificate.from_pem((folder / "cert.pem").read_bytes()).subject_name
    least = Grant.least(
        subject_name=subject, not_before=NOW - DAY, not_after=NOW + DAY, domains=DOMAINS
    )
    document = Permissions(grants=(replace(least, rules=rules),)).to_xml()
    message = keystore.unlock(None).sign(document, now=NOW)
    (folder / "permissions.p7s").unlink()
    (folder / "permissions.p7s").write_bytes(message)
    shim, (pairs, at) = Shim("access_control", NOW), properties(folder)
    _, own, _ = shim.call("validate_local_permissions", 1, 0, at, pairs)
    _, peers, _ = shim.call("validate_remote_permissions", 1, 2, TOKEN, _credential(folder))
    calls = [(own, "create_datawriter"), (own, "create_datareader")]
    calls += [(peers, "remote_datawriter"), (peers, "remote_datareader")]
    let_in = ("floor1", "floor?", "sales", "sal*", "secrets")
    kept_out = ("floor*", "floor12", "s*", "secre?", "secret", "*", "", "floor[12]")
    hostile = tuple(f"s{'*?' * 100}{number}" for number in range(1000))
    wrong = []
    for (handle, name), partition in product(calls, (*let_in, *kept_out)):
        try:
            shim.call(f"check_{name}", handle, 0, "x", (partition,), ())
        except RefusedError:
            wrong += [(name, partition)] if partition in let_in else []
        else:
            wrong += [(name, partition)] if partition in kept_out else []
    assert not wrong
    with pytest.raises(RefusedError, match="so it is denied: no rule of grant"):
        shim.call("check_remote_datawriter", peers, 0, "x", hostile, ())


def test_a_topic_that_may_be_neither_published_nor_subscribed_to_is_refused_with_both_reasons(
    folders,
):
    shim, (pairs, where) = Shim("access_control", NOW), properties(folders["pq"][0])
    _, own, _ = shim.call("validate_local_permissions", 1, 0, where, pairs)
    shim.call("check_create_topic", own, 0, "x")
    with pytest.raises(RefusedError, match=r"may publish 'y' .*; .* may subscribe to 'y' "):
        shim.call("check_create_topic", own, 0, "y")


def test_builtin_topics_are_for_the_participant_itself_not_for_its_peers(folders):
    folder = folders["pq"][0]
    shim, (pairs, where) = Shim("access_control", NOW), properties(folder)
    _, own, _ = shim.call("validate_local_permissions", 1, 0, where, pairs)
    shim.call("check_create_topic", own, 0, "DCPSParticipant")
    shim.call("check_create_datareader", own, 0, "DCPSParticipant", (), ())
    _, peers, _ = shim.call("validate_remote_permissions", 1, 2, TOKEN, _credential(folder))
    with pytest.raises(RefusedError, match="'DCPSParticipant'"):
        shim.call("check_remote_datareader", peers, 0, "DCPSParticipant", (), ())


def test_a_guid_comes_from_the_identity_that_made_it_and_from_a_peer_once_authenticated(folders):
    """DDS-Security 1.1, 9.3.3, table 52; Fast DDS asks, for discovery servers."""
    candidates = [os.urandom(12) + b"\0\0\1\xc1" for _ in TWO]
    sides = []
    for folder, candidate in zip(folders["pq"], candidates, strict=True):
        shim, (pairs, where) = Shim("authentication"), properties(folder)
        _, handle, guid, *_ = shim.call("validate_local_identity", 0, where, pairs, candidate)
        sides.append((shim, handle, guid))
        assert shim.call("check_guid_comes_from", handle, guid, candidate) == [ValidationResult.OK]
        for wrong in ((guid, os.urandom(16)), (os.urandom(16), candidate), (guid, guid)):
            with pytest.raises(RefusedError, match="was not derived"):
                shim.call("check_guid_comes_from", handle, *wrong)
        with pytest.raises(RefusedError, match="has not authenticated"):
            shim.call("check_guid_comes_from", handle + 1, guid, candidate)
    made_of = dict(zip((guid for _, _, guid in sides), candidates, strict=True))
    for shim, _, peer in shaken(*sides):
        [(other, candidate)] = [
            (guid, each) for guid, each in made_of.items()
            if guid != next(guid for mine, _, guid in sides if mine is shim)
        ]  # fmt: skip
        assert shim.call("check_guid_comes_from", peer, other, candidate) == [ValidationResult.OK]
        with pytest.raises(RefusedError, match="was not derived"):
            shim.call("check_guid_comes_from", peer, other, os.urandom(16))
