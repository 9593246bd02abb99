"""Properties of a participant: every stack's name of the revocation list, and none passed over."""

import pytest

from pqsec_pki.errors import UsageError
from pqsec_pki.lifecycle import revoke
from pqsec_pki.plugin.property_names import understood
from tests.unit.keystores import NOW, TWO, made
from tests.unit.plugin_wire import RefusedError, Shim, new_guid, properties, shaken, side

NAMES = {
    "Cyclone DDS": "org.eclipse.cyclonedds.sec.auth.crl",
    "Fast DDS": "dds.sec.auth.builtin.PKI-DH.identity_crl",
    "OpenDDS, by an adapter": "dds.sec.auth.crl",
    "as the standard's names are": "dds.sec.auth.identity_crl",
}
CYCLONES = [
    *(
        f"dds.sec.{plugin}.library.{what}"
        for plugin in ("auth", "access", "crypto")
        for what in ("path", "init", "finalize")
    ),
    *(f"dds.sec.auth.{what}" for what in ("identity_ca", "identity_certificate", "private_key")),
    *(f"dds.sec.auth.{what}" for what in ("password", "trusted_ca_dir")),
    *(f"dds.sec.access.{what}" for what in ("permissions_ca", "governance", "permissions")),
    "org.eclipse.cyclonedds.sec.auth.crl",
]
"""All that ddsi_xqos_mergein_security_config writes, in 0.10 and 11."""
UNKNOWN = {
    "dds.sec.auth.crll": "did you mean dds.sec.auth.crl?",
    "dds.sec.auth.Identity_CA": "did you mean dds.sec.auth.identity_ca?",
    "dds.sec.auth.builtin.PKI-DH.identity_ca": "did you mean dds.sec.auth.identity_ca?",
    "dds.sec.access.builtin.Access-Permissions.governance": "mean dds.sec.access.governance?",
    "dds.sec.auth.builtin.PKI-DH.preferred_key_agreement": "docs/reference/plugin.md",
    "dds.sec.auth.ocsp": "docs/reference/plugin.md",
    "DDS.SEC.AUTH.CRL": "is unknown to pqsec's plugin",
    "org.eclipse.cyclonedds.sec.auth.clr": "did you mean org.eclipse.cyclonedds.sec.auth.crl?",
    "com.rti.serv.secure.authentication.ca_file": "is unknown to pqsec's plugin",
    "com.rti.serv.secure.authentication.crl": "is unknown to pqsec's plugin",
    "pqsec.key_agreements": "docs/reference/plugin.md",
}


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    store = made(tmp_path_factory.mktemp("k") / "k", "classical", names=(*TWO, "/eve"))
    revoke(store, store.unlock(None), ["/eve"], now=NOW)
    return store


@pytest.fixture
def folder(keystore):
    return lambda name: keystore.root / "enclaves" / name


def test_a_revocation_list_counts_by_every_stacks_name(folder):
    wrong = []
    for stack, name in NAMES.items():
        for value in ("file:crl.pem", f"data:,{(folder('listener') / 'crl.pem').read_text()}"):
            try:
                shaken(side(folder("listener"), **{name: value}), side(folder("eve")))
            except RefusedError as refusal:
                if "eve was revoked on" not in str(refusal):
                    wrong.append((stack, str(refusal)))
            else:
                wrong.append((stack, value[:5]))
    assert wrong == []


def test_a_list_by_any_name_is_looked_at_again(folder):
    for name in NAMES.values():
        pairs, where = properties(folder("listener"), **{name: "file:crl.pem"})
        *_, ask = Shim("authentication").call(
            "validate_local_identity", 0, where, pairs, new_guid()
        )
        assert ask == 1


def test_a_list_by_two_names_must_be_one(folder):
    first, second, *_ = NAMES.values()
    same = dict.fromkeys((first, second), "file:crl.pem")
    assert side(folder("listener"), **same)
    with pytest.raises(RefusedError, match="has two values"):
        side(folder("listener"), **same | {second: "file:other.pem"})


def test_a_property_that_stands_there_twice_must_say_the_same(folder):
    pairs, where = properties(folder("listener"))
    shim = Shim("authentication")
    assert shim.call("validate_local_identity", 0, where, pairs * 2, new_guid())
    more = ("dds.sec.auth.identity_ca", "file:another.pem")
    for both in ((more, *pairs), (*pairs, more)):
        with pytest.raises(RefusedError, match=r"dds\.sec\.auth\.identity_ca has two values"):
            shim.call("validate_local_identity", 0, where, both, new_guid())


def test_a_property_of_security_that_is_unknown_is_refused_with_the_way_out(folder):
    wrong = []
    for plugin, call, head in (
        ("authentication", "validate_local_identity", (0,)),
        ("access_control", "validate_local_permissions", (1, 0)),
    ):
        for name, words in UNKNOWN.items():
            pairs, where = properties(folder("listener"), **{name: "secret"})
            tail = (new_guid(),) if plugin == "authentication" else ()
            try:
                Shim(plugin).call(call, *head, where, pairs, *tail)
            except RefusedError as refusal:
                said = str(refusal)
                if name not in said or words not in said or "secret" in said:
                    wrong.append((plugin, name, said))
            else:
                wrong.append((plugin, name, "taken"))
    assert wrong == []


def test_what_cyclone_passes_on_and_what_an_application_has_is_taken():
    pairs = [(name, "value") for name in CYCLONES]
    pairs += [("role", "camera"), ("dds.security", ""), ("com.rti.serv.load_plugin", "x"), ("", "")]
    assert understood(pairs) == dict(pairs)


def test_the_refusal_of_a_name_keeps_the_log_whole():
    with pytest.raises(UsageError) as refusal:
        understood([("dds.sec.\n2026-01-01 all is well" + "x" * 1000, "")])
    assert "\n" not in str(refusal.value)
    assert len(str(refusal.value)) < 300
