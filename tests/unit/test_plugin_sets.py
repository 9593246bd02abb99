"""The agent with several sets of credentials: which it uses with a peer, and what it refuses.

Each participant here has both sets and `pqsec.toml` beside the certificate that its stack's
configuration names, or is stock: a stack that knows the first set only.
"""

import shutil
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import private_key_pem, profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import (
    DataHolder,
    IdentityToken,
    StockPeers,
    adjusted_guid,
    choice,
    participant_data,
)
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew_list, revoke
from pqsec_pki.plugin.authentication import NO_TOKEN
from pqsec_pki.plugin.settings import SettingsFile
from pqsec_pki.problems import Code
from pqsec_pki.smime import document_in
from tests.unit.keystores import DAY, NOW
from tests.unit.plugin_wire import RefusedError, Shim, new_guid, properties

A, B = "/a", "/b"
KINDS = ("hybrid", "pq")
LIST = {"org.eclipse.cyclonedds.sec.auth.crl": "file:crl.pem"}
TOKEN = DataHolder("DDS:Access:Permissions:1.0")


def made(root, *profiles):
    zero = DomainSet.of(0)
    keystore = Keystore.create(
        root,
        *map(profile_named, profiles),
        name="Lab",
        domains=zero,
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    may = {"domains": zero, "publish": ("x",), "subscribe": ("x",), "validity": 90 * DAY}
    specs = [ParticipantSpec(name=each, **may) for each in (A, B)]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    return keystore


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    return {
        each: made(tmp_path_factory.mktemp(each) / "k", "classical", each).root for each in KINDS
    }


@pytest.fixture(params=KINDS)
def root(request, models, tmp_path):
    """A copy of a keystore with two sets, and two participants."""
    shutil.copytree(models[request.param], tmp_path / "k", symlinks=True)
    return tmp_path / "k"


def strongest_of(root):
    (found,) = (root / "sets").iterdir()
    return found


def configured(root, name, *stock, first=False, text=None):
    """The folder that a stack's configuration names: of the strongest set, or of the first."""
    strong, weak = strongest_of(root) / f"enclaves{name}", root / f"enclaves{name}"
    profile = strongest_of(root).name
    if first:
        sets = {"classical": ".", profile: f"../../sets/{profile}/enclaves{name}"}
    else:
        sets = {"classical": f"../../../../enclaves{name}", profile: "."}
    folder = weak if first else strong
    (folder / "pqsec.toml").write_text(text or SettingsFile(sets=sets, stock=stock).text)
    return folder


class Peer:
    """A process with both plugins, and one participant."""

    def __init__(self, folder, *, strip=False, subject=None, **more):
        self.shim, self.access = Shim("authentication"), Shim("access_control")
        self.identity, self.guid = self.shim.identity(folder, **more)
        pairs, where = properties(folder, **more)
        self.rights = self.access.call(
            "validate_local_permissions", self.identity, 0, where, pairs
        )[1]
        _, credential = self.access.call("get_permissions_credential_token", self.rights)
        self.shim.call("set_permissions_credential_and_token", self.identity, credential, TOKEN)
        self.token = self.shim.call("get_identity_token", self.identity)[1]
        if strip:
            self.token = without(self.token, "pqsec.sets")

    def hears_of(self, other):
        _, self.peer, _ = self.shim.call(
            "validate_remote_identity", NO_TOKEN, self.identity, other.token, other.guid
        )

    def admits(self, handshake):
        _, credential = self.shim.call("get_authenticated_peer_credential_token", handshake)
        self.access.call("validate_remote_permissions", self.identity, 7, TOKEN, credential)
        return credential


def without(token, *names):
    return replace(
        token, properties=tuple(each for each in token.properties if each[0] not in names)
    )


def meet(one, other, relay=lambda _, token: token):
    """A whole handshake, with permissions: the algorithms with which both signed."""
    first, second = sorted((one, other), key=lambda each: each.guid)
    first.hears_of(second)
    second.hears_of(first)
    data = [participant_data(each.guid) for each in (first, second)]
    _, begun, request = first.shim.call(
        "begin_handshake_request", first.identity, first.peer, data[0]
    )
    request = relay("request", request)
    _, answered, reply = second.shim.call(
        "begin_handshake_reply", request, second.peer, second.identity, data[1]
    )
    reply = relay("reply", reply)
    _, final = first.shim.call("process_handshake", reply, begun)
    second.shim.call("process_handshake", relay("final", final), answered)
    secrets = [
        each.shim.call("get_shared_secret", handle)[3:]
        for each, handle in ((first, begun), (second, answered))
    ]
    assert secrets[0] == secrets[1]
    first.admits(begun)
    second.admits(answered)
    return {dict(each.binary_properties)["c.dsign_algo"].rstrip(b"\0") for each in (request, reply)}


CLASSICAL_SIGNATURE = {b"ECDSA-SHA256"}
NOT_NAMED = r"stock does not name it|it may be a stock stack|allowed here"


def test_the_same_subject_gives_the_same_guid_in_every_set(root):
    """So a peer is one participant, whichever set it is met with."""
    keystore, candidate = Keystore.open(root), bytes(range(16))
    for name in (A, B):
        own = [each.participant(name).certificate for each in keystore.sets]
        assert len({each.spki for each in own}) == 2
        assert len({adjusted_guid(each.subject_der, candidate) for each in own}) == 1
    pairs = [properties(each) for each in (root / "enclaves/a", strongest_of(root) / "enclaves/a")]
    shim = Shim("authentication")
    guids = [
        shim.call("validate_local_identity", 0, where, given, candidate)[2]
        for given, where in pairs
    ]
    assert guids[0] == guids[1]


@pytest.mark.parametrize("first", [False, True])
def test_two_with_all_sets_meet_with_the_strongest(root, first):
    """Whichever set the stack's configuration names, and whoever is named."""
    for stock in ((), ("/*",)):
        sides = Peer(configured(root, A, *stock, first=first)), Peer(configured(root, B))
        assert not meet(*sides) & CLASSICAL_SIGNATURE


def test_what_is_announced_is_that_of_the_first_set_and_the_names_of_all(root):
    """A stock stack sees no other algorithm; the agreements are for our own plugin."""
    said = dict(Peer(configured(root, A)).token.properties)
    plain = dict(Peer(root / "enclaves/b").token.properties)
    assert said["dds.cert.algo"] == plain["dds.cert.algo"]
    assert said["dds.ca.algo"] == plain["dds.ca.algo"]
    assert said["pqsec.sets"] == f"classical,{strongest_of(root).name}"
    assert "pqsec.sets" not in plain


@pytest.mark.parametrize("ours", [A, B])
@pytest.mark.parametrize("entry", ["{}", "/*", "/**", "{}, /other"])
def test_a_named_stock_stack_is_met_with_the_first_set_whoever_begins(root, ours, entry):
    theirs = B if ours == A else A
    stock = entry.format(theirs).split(", ")
    assert meet(Peer(configured(root, ours, *stock)), Peer(root / f"enclaves{theirs}")) == (
        CLASSICAL_SIGNATURE
    )


@pytest.mark.parametrize("ours", [A, B])
@pytest.mark.parametrize("stock", [(), ("/other",), ("/*/x", "/c*")])
def test_one_that_stock_does_not_name_is_refused_with_the_first_set(root, ours, stock):
    theirs = B if ours == A else A
    with pytest.raises(RefusedError, match=NOT_NAMED):
        meet(Peer(configured(root, ours, *stock)), Peer(root / f"enclaves{theirs}"))


@pytest.mark.parametrize("ours", [A, B])
def test_an_announcement_that_is_stripped_is_refused_for_one_that_is_not_named(root, ours):
    """Attack: the peer seems to have one set. It is asked for the strongest all the same."""
    theirs = B if ours == A else A
    one, other = Peer(configured(root, ours)), Peer(configured(root, theirs), strip=True)
    assert not meet(one, other) & CLASSICAL_SIGNATURE
    bare = Peer(configured(root, theirs, ours))
    bare.token = without(bare.token, "pqsec.sets", "pqsec.kagree_algo")
    hidden = Peer(configured(root, ours))
    hidden.token = without(hidden.token, "pqsec.sets", "pqsec.kagree_algo")
    with pytest.raises(RefusedError, match=NOT_NAMED):
        meet(hidden, bare)


def test_what_remains_a_stripped_announcement_of_a_named_peer_gives_the_first_set(root):
    """Both must name the other: that is the policy of both, and all that an attacker gets."""
    sides = [Peer(configured(root, name, other), strip=True) for name, other in ((A, B), (B, A))]
    assert meet(*sides) == CLASSICAL_SIGNATURE


def test_a_peer_without_a_name_is_compared_with_exact_names_only(root):
    """By the hash in its GUID: a pattern has no hash."""

    def nameless():
        found = Peer(root / "enclaves/b")
        found.token = without(found.token, "dds.cert.sn")
        return found

    assert meet(Peer(configured(root, A, B)), nameless()) == CLASSICAL_SIGNATURE
    with pytest.raises(RefusedError, match=NOT_NAMED):
        meet(Peer(configured(root, A, "/*", "/**")), nameless())


@pytest.mark.parametrize("announced", ["/CN=\\/a", "CN=/other", "/CN=/b/O=Lab", "nonsense", ""])
def test_an_announced_name_that_does_not_belong_to_the_guid_is_refused(root, announced):
    """Attack: the name of one that is named, with the GUID and certificate of another."""
    for folder in (root / "enclaves/b", configured(root, B, A)):
        one, other = Peer(configured(root, A, A, "/other", "/b/**")), Peer(folder)
        pairs = dict(other.token.properties) | {"dds.cert.sn": announced}
        other.token = replace(other.token, properties=tuple(pairs.items()))
        with pytest.raises(RefusedError, match="does not belong to the peer's GUID"):
            meet(one, other)


@pytest.mark.parametrize("spelling", ["/CN=\\/b", "/CN=/b", "CN=/b", "CN = /b"])
def test_the_spellings_of_stacks_are_read(spelling):
    guid = adjusted_guid(choice.common_name(B), new_guid())
    row = StockPeers((B,)).row(IdentityToken(subject=spelling), guid)
    assert row.is_stock
    assert row.subject == choice.common_name(B)


def test_a_certificate_must_have_the_very_name_that_chose_the_row(root, monkeypatch):
    """Attack: 47 bits of a hash are 2^47 attempts, so another name may fit the GUID of a named
    one. Here all hashes are equal, as of two names that were found so."""
    monkeypatch.setattr("pqsec_pki.handshake.guid._high_half", lambda _: b"\x80" + bytes(5))
    for stock, announced in (((A, "/c"), "/CN=/c"), (("/c*",), "/CN=/c"), (("/c",), None)):
        one, other = Peer(configured(root, A, *stock)), Peer(root / "enclaves/b")
        pairs = dict(other.token.properties) | {"dds.cert.sn": announced}
        other.token = replace(
            other.token, properties=tuple(each for each in pairs.items() if each[1] is not None)
        )
        with pytest.raises(RefusedError, match="is not the one that was announced"):
            meet(one, other)


# An attacker with a quantum computer: it has the private keys of the classical CAs


def forged(root, name, folder):
    """A stock participant of that name with a certificate by the real classical CA's key."""
    keystore = Keystore.open(root)
    key = profile_named("classical").participant_key.generate()
    ca = keystore.unlock(None).identity
    certificate = ca.issue(name, key.public_key, now=NOW, validity=9 * DAY)
    shutil.copytree(root / f"enclaves{name}", folder)
    for file, octets in (("cert.pem", certificate.pem), ("key.pem", private_key_pem(key))):
        (folder / file).unlink()
        (folder / file).write_bytes(octets)
    (folder / "pqsec.toml").unlink(missing_ok=True)
    return folder


@pytest.mark.parametrize("ours", [A, B])
@pytest.mark.parametrize("announces", [True, False])
def test_a_forged_classical_certificate_is_refused_for_one_that_is_not_named(
    root, tmp_path, ours, announces
):
    theirs = B if ours == A else A
    one, other = Peer(configured(root, ours, "/other")), Peer(forged(root, theirs, tmp_path / "f"))
    if announces:  # that it has the strongest set, which it has not
        real = Peer(configured(root, theirs)).token
        other.token = real
    with pytest.raises(RefusedError, match=NOT_NAMED):
        meet(one, other)
    named = Peer(configured(root, ours, theirs))  # what remains for one that is named
    assert meet(named, Peer(forged(root, theirs, tmp_path / "g"))) == CLASSICAL_SIGNATURE


# No mixing of sets


def replaced(token, **values):
    pairs = dict(token.binary_properties)
    pairs |= {name.replace("_", "."): octets for name, octets in values.items()}
    return replace(token, binary_properties=tuple(pairs.items()))


@pytest.mark.parametrize("ours", [A, B])
def test_a_certificate_of_one_set_with_the_document_of_the_other_is_refused(root, ours):
    """An insider, or one that forged the classical document: that is not the strongest set's."""
    theirs = B if ours == A else A
    weak, strong = root / f"enclaves{theirs}", strongest_of(root) / f"enclaves{theirs}"
    for goal, source in ((configured(root, theirs), weak), (weak, strong)):
        one, other = Peer(configured(root, ours, theirs)), Peer(goal)
        document = (source / "permissions.p7s").read_bytes().decode("utf-8", "surrogateescape")
        credential = DataHolder("DDS:Access:PermissionsCredential", (("dds.perm.cert", document),))
        other.shim.call("set_permissions_credential_and_token", other.identity, credential, TOKEN)
        with pytest.raises(RefusedError, match="the peer's permissions"):
            meet(one, other)


def test_a_certificate_of_the_other_set_in_a_reply_is_refused(root):
    """Both certificates are genuine, but the Request chose the set."""
    first, second = sorted(
        ((A, Peer(configured(root, A))), (B, Peer(configured(root, B)))),
        key=lambda each: each[1].guid,
    )
    weak = Certificate.from_pem((root / f"enclaves{second[0]}/cert.pem").read_bytes()).pem

    def relay(name, token):
        return replaced(token, c_id=weak) if name == "reply" else token

    with pytest.raises(RefusedError, match=r"issued by .*, not by"):
        meet(first[1], second[1], relay)


def test_messages_of_one_set_are_refused_in_a_handshake_of_the_other(root):
    """Replay across sets: what was said with the classical key proves nothing to the other."""
    recorded = {}

    def record(name, token):
        recorded[name] = token
        return token

    meet(Peer(configured(root, A, B)), Peer(root / "enclaves/b"), record)
    meet(Peer(root / "enclaves/a"), Peer(configured(root, B, A)), record)
    for names in (("request",), ("reply",), ("final",), ("request", "reply")):
        with pytest.raises(RefusedError):
            meet(
                Peer(configured(root, A)),
                Peer(configured(root, B)),
                lambda name, token, names=names: recorded[name] if name in names else token,
            )


def test_what_a_named_peer_with_one_set_announces_chooses_that_set(tmp_path):
    """Of hybrid and pq: one that has only the first is not asked with the other."""
    root = made(tmp_path / "k", "hybrid", "pq").root
    for ours, theirs in ((A, B), (B, A)):
        folder = root / f"sets/pq/enclaves{ours}"
        sets = {"hybrid": f"../../../../enclaves{ours}", "pq": "."}
        (folder / "pqsec.toml").write_text(SettingsFile(sets=sets, stock=(theirs,)).text)
        (root / f"sets/pq/enclaves{theirs}/pqsec.toml").unlink(missing_ok=True)
        with_first = meet(Peer(folder), Peer(root / f"enclaves{theirs}"))
        with_last = meet(Peer(folder), Peer(root / f"sets/pq/enclaves{theirs}"))
        assert len(with_first) == len(with_last) == 1
        assert with_last == {b"ML-DSA-65"}
        assert with_first != with_last


# Fails closed


@pytest.mark.parametrize(
    "file",
    [
        "",
        "cert.pem",
        "key.pem",
        "identity_ca.cert.pem",
        "permissions_ca.cert.pem",
        "permissions.p7s",
        "governance.p7s",
    ],
)
@pytest.mark.parametrize("first", [False, True])
def test_a_missing_folder_or_file_of_any_set_refuses_the_start(root, file, first):
    folder = configured(root, A, first=first)
    lacking = (strongest_of(root) if first else root) / "enclaves/a"
    path = lacking / file
    if file:
        path.unlink()
    else:
        shutil.rmtree(path)
    with pytest.raises(RefusedError, match=file or "cert.pem"):
        Peer(folder)


def test_a_missing_revocation_list_of_any_set_refuses_the_start(root):
    keystore = Keystore.open(root, to_change=True)
    renew_list(keystore, keystore.unlock(None), now=NOW)
    weak, strong = configured(root, A, first=True), configured(root, B)
    for folder in (weak, strong):
        assert Peer(folder, **LIST)
        with pytest.raises(RefusedError, match="the configuration names no revocation list"):
            Peer(folder)
    (strongest_of(root) / "enclaves/a/crl.pem").unlink()
    (root / "enclaves/b/crl.pem").unlink()
    for folder in (weak, strong):
        with pytest.raises(RefusedError, match=r"crl\.pem: no such file"):
            Peer(folder, **LIST)


def test_a_peer_that_the_list_of_its_set_names_is_refused_and_dropped(root):
    """Each set has a list of its own, and the other's says nothing about its certificates."""
    keystore = Keystore.open(root, to_change=True)
    renew_list(keystore, keystore.unlock(None), now=NOW)
    old = root.parent / "old"
    shutil.copytree(root, old, symlinks=True)
    ours = configured(root, A, B)
    for theirs, kinds in ((old / "enclaves/b", 0), (configured(old, B), 1)):
        one, other = Peer(ours, **LIST), Peer(theirs, **LIST)
        assert (meet(one, other) == CLASSICAL_SIGNATURE) == (kinds == 0)
        assert one.shim.call("find_revoked")[1] == 0
        lists = [path for path in root.rglob("crl.pem") if "enclaves/a" in str(path)]
        before = [path.read_bytes() for path in lists]
        copies = [path.resolve() for path in lists]
        new = root.parent / f"new{kinds}"
        shutil.copytree(root, new, symlinks=True)
        changed = Keystore.open(new, to_change=True)
        revoke(changed, changed.unlock(None), [B], now=NOW)
        weak, strong = (new / each.relative_to(root) for each in lists)
        assert {weak.read_bytes(), strong.read_bytes()}.isdisjoint(before)
        goal = copies[0] if ("sets" in str(lists[0])) == bool(kinds) else copies[1]
        saved = goal.read_bytes()
        goal.write_bytes((new / goal.relative_to(root)).read_bytes())
        assert one.shim.call("find_revoked")[1] == one.peer
        with pytest.raises(RefusedError, match="revoked"):
            meet(one, other)
        goal.write_bytes(saved)


@pytest.mark.parametrize("set_name", ["", "sets"])
def test_a_participant_that_the_list_of_any_set_names_is_revoked(root, set_name):
    keystore = Keystore.open(root, to_change=True)
    renew_list(keystore, keystore.unlock(None), now=NOW)
    running, new = Peer(configured(root, A), **LIST), root.parent / "new"
    shutil.copytree(root, new, symlinks=True)
    changed = Keystore.open(new, to_change=True)
    revoke(changed, changed.unlock(None), [A], now=NOW)
    folder = strongest_of(root) if set_name else root
    goal = (folder / "enclaves/a/crl.pem").resolve()
    assert running.shim.call("find_revoked")[1] == 0
    goal.write_bytes((new / goal.relative_to(root)).read_bytes())
    assert running.shim.call("find_revoked")[1] == running.identity
    with pytest.raises(RefusedError, match="revoked"):
        Peer(configured(root, A), **LIST)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('stock = ["/b"]', "there is no table sets"),
        ('stock = "/b"\n[sets]\nclassical = "x"\nhybrid = "."', "no such value"),
        ('stock = [""]\n[sets]\nclassical = "x"\nhybrid = "."', "no such value"),
        ('stock = ["/b="]\n[sets]\nclassical = "x"\nhybrid = "."', "read differently"),
        ('peers = "stock"\n[sets]\nclassical = "x"\nhybrid = "."', "peers is about everybody"),
        ('[sets]\nhybrid = "."', "no such value"),
        ('[sets]\nclassical = "x"\nhybrid = "y"', "no such value"),
        ('[sets]\nclassical = "."\nhybrid = "."', "no such value"),
        ('[sets]\nclassical = 1\nhybrid = "."', "no such value"),
        ('sets = ["classical", "hybrid"]', "no such value"),
        ('[sets]\nclassical = "a\\u0000b"\n{profile} = "."', "null"),
        ('[sets]\nclassical = "nowhere"\n{profile} = "."', "cert.pem: no such file"),
        ('[sets]\nother = "../../../../enclaves/a"\n{profile} = "."', "other"),
        ('[sets]\n{profile} = "."\nclassical = "../../../../enclaves/a"', "the strongest"),
        ('[sets]\ncnsa2 = "../../../../enclaves/a"\n{profile} = "."', "not for the set cnsa2"),
        ('[sets]\nclassical = "../../../../enclaves/b"\n{profile} = "."', "different participants"),
        ('[sets]\nhybrid = "."\npq = "../../enclaves/a"', "two sets have .* the same key"),
        ('[sets]\npq = "../a"\nhybrid = "."', "an identity CA of the same name"),
    ],
)
def test_a_table_of_sets_that_does_not_fit_is_refused(models, tmp_path, text, words):
    shutil.copytree(models["hybrid"], tmp_path / "k", symlinks=True)
    folder = configured(tmp_path / "k", A, text=text.format(profile="hybrid"))
    with pytest.raises(RefusedError, match=words):
        Peer(folder)


def test_a_folder_of_trusted_cas_has_no_place_beside_sets(root, tmp_path):
    with pytest.raises(RefusedError, match="exclude each other"):
        Peer(configured(root, A), **{"dds.sec.auth.trusted_ca_dir": str(tmp_path)})


def test_documents_of_two_sets_that_differ_refuse_the_start(root):
    keystore = Keystore.open(root, to_change=True)
    further = keystore.sets[-1]
    folder = configured(root, A)
    ca = next(each for each in keystore.unlock(None).sets if each.set_name == further.set_name)
    document = document_in((folder / "permissions.p7s").read_bytes()).replace(b">x<", b">y<")
    path = folder / "permissions.p7s"
    path.unlink()
    path.write_bytes(ca.sign(document, number=9, now=NOW))
    with pytest.raises(RefusedError, match="the documents of two sets of credentials differ"):
        Peer(folder)


def test_without_the_file_the_configured_set_alone_is_used(root):
    """The configuration names the strongest, so a lost pqsec.toml makes nothing weaker."""
    one = Peer(strongest_of(root) / "enclaves/a")
    with pytest.raises(RefusedError):
        meet(one, Peer(root / "enclaves/b"))
    assert not meet(one, Peer(configured(root, B))) & CLASSICAL_SIGNATURE


def test_the_code_of_each_refusal_is_its_own():
    said = IdentityToken(subject="/CN=/b")
    with pytest.raises(VerificationError) as refused:
        StockPeers().row(said, new_guid())
    assert refused.value.codes == {Code.C29}
    with pytest.raises(VerificationError) as refused:
        choice.refuse_weak_set(choice.PolicyRow(None, is_stock=False), 0, ("classical", "pq"))
    assert refused.value.codes == {Code.C30}
    middle = choice.PolicyRow(None, is_stock=True)
    with pytest.raises(VerificationError):
        choice.refuse_weak_set(middle, 1, ("classical", "hybrid", "pq"))
    choice.refuse_weak_set(middle, 0, ("classical", "hybrid", "pq"))
    choice.refuse_weak_set(choice.PolicyRow(None, is_stock=False), 2, ("classical", "hybrid", "pq"))
