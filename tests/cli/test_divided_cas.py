"""Each CA's key on a machine of its own: each command needs only the keys that it signs with."""

import shutil

import pytest

from pqsec_pki.keystore import Keystore, audit
from tests.unit.approving import make_key

MISSING = "the CA's private key is not here"
IDENTITY, PERMISSIONS = "identity", "permissions"


@pytest.fixture
def machines(tmp_path, domains):
    """A keystore as two machines have it: `identity` and `permissions`, each with its CA's key."""
    for own, other in ((IDENTITY, PERMISSIONS), (PERMISSIONS, IDENTITY)):
        shutil.copytree(domains("transition"), tmp_path / own, symlinks=True)
        for key in (tmp_path / own / "private").glob(f"{other}_ca*.key.pem"):
            key.unlink()
    return tmp_path


def carried(machines, source, goal):
    """Everything but CA keys goes from one machine to the other."""
    keys = {
        path.name: path.read_bytes() for path in (machines / goal / "private").glob("*.key.pem")
    }
    shutil.rmtree(machines / goal)
    ignored = shutil.ignore_patterns("*_ca.key.pem", "*_ca.alt.key.pem")
    shutil.copytree(machines / source, machines / goal, symlinks=True, ignore=ignored)
    for name, data in keys.items():
        (machines / goal / "private" / name).write_bytes(data)
        (machines / goal / "private" / name).chmod(0o600)


def test_one_machine_certifies_and_the_other_permits(machines, pqsec):
    pqsec(f"-k {IDENTITY} issue /arm --certificate-only").done()
    there = machines / IDENTITY / "enclaves/arm"
    assert (there / "cert.pem").exists()
    assert not (there / "permissions.p7s").exists()
    carried(machines, IDENTITY, PERMISSIONS)
    done = pqsec(f"-k {PERMISSIONS} permit /arm --publish rt/chatter --domain 0 --yes").done()
    assert "CN=/arm: publish 'rt/chatter' on domain 0" in done.out
    carried(machines, PERMISSIONS, IDENTITY)
    pqsec(f"-k {IDENTITY} verify-handshake /arm /listener").done()
    assert pqsec(f"-k {IDENTITY} check").code == 0
    audit(Keystore.open(machines / IDENTITY))
    [row] = pqsec(f"-k {IDENTITY} status /arm --json").done().json["participants"]
    assert row["domains"] == "0"


@pytest.mark.parametrize(
    "command",
    [
        "issue /arm --publish rt/x",
        "issue /arm --certificate-only",
        "revoke /talker --yes",
        "ca crl",
    ],
)
def test_without_the_identity_key_nothing_is_certified_or_revoked(machines, pqsec, command):
    before = (machines / PERMISSIONS / "private/ledger.sqlite3").read_bytes()
    pqsec(f"-k {PERMISSIONS} {command}").refused(3, MISSING, "identity_ca.key.pem")
    assert (machines / PERMISSIONS / "private/ledger.sqlite3").read_bytes() == before


@pytest.mark.parametrize(
    "command",
    [
        "issue /arm --publish rt/x",
        "permit /talker --publish rt/x --yes",
        f"sign-governance {IDENTITY}/enclaves/governance.xml --force",
        f"sign-permissions {IDENTITY}/enclaves/talker/permissions.xml --force",
        "report -o r.html --sign",
    ],
)
def test_without_the_permissions_key_nothing_is_permitted(machines, pqsec, command):
    before = (machines / IDENTITY / "private/ledger.sqlite3").read_bytes()
    pqsec(f"-k {IDENTITY} {command}").refused(3, MISSING, "permissions_ca.key.pem")
    assert (machines / IDENTITY / "private/ledger.sqlite3").read_bytes() == before


@pytest.mark.parametrize(
    ("machine", "command"),
    [
        (IDENTITY, "revoke /talker --yes"),
        (IDENTITY, "ca crl"),
        (PERMISSIONS, "permit /talker --publish rt/x --yes"),
        (PERMISSIONS, f"sign-governance {PERMISSIONS}/enclaves/governance.xml --force"),
        (PERMISSIONS, f"sign-permissions {PERMISSIONS}/enclaves/talker/permissions.xml --force"),
        (PERMISSIONS, "report -o r.html --sign"),
    ],
)
def test_a_command_needs_the_keys_that_it_signs_with_and_no_others(
    machines, pqsec, machine, command
):
    pqsec(f"-k {machine} {command}").done()
    audit(Keystore.open(machines / machine))


def test_who_was_only_certified_has_no_rights_yet_and_commands_say_so(machines, pqsec):
    pqsec(f"-k {IDENTITY} issue /arm --certificate-only").done()
    assert "no permissions were signed yet for /arm" in pqsec(f"-k {IDENTITY} status").err
    bundle = pqsec(f"-k {IDENTITY} bundle /arm -o b --plain-key")
    bundle.refused(3, "lacks permissions.p7s", hint="pqsec permit /arm")
    pqsec(f"-k {IDENTITY} export ros2 /arm").refused(3, "lacks permissions.p7s")
    assert "error PQS301 lacks permissions.p7s" in pqsec(f"-k {IDENTITY} check").out
    pqsec(f"-k {PERMISSIONS} permit /arm --publish x --yes").refused(3, "/arm")  # not carried yet


def test_what_has_no_rights_yet_cannot_be_renewed(keystore, pqsec):
    k = keystore()
    pqsec(f"-k {k} issue /arm --certificate-only").done()
    renewed = pqsec(f"-k {k} renew /arm")
    renewed.refused(3, "no permissions were signed for /arm yet", hint="pqsec permit /arm")


def test_a_participant_that_is_certified_again_keeps_its_rights(machines, pqsec):
    signed = (machines / IDENTITY / "enclaves/talker/permissions.p7s").read_bytes()
    pqsec(f"-k {IDENTITY} issue /talker --certificate-only --force").done()
    assert (machines / IDENTITY / "enclaves/talker/permissions.p7s").read_bytes() == signed
    pqsec(f"-k {IDENTITY} verify-handshake /talker /listener").done()


def test_rights_that_stay_for_a_new_certificate_are_told(machines, pqsec):
    """Also those of a participant that was revoked: its permissions are still signed."""
    done = pqsec(f"-k {IDENTITY} issue /arm --certificate-only").done()
    assert "stay" not in done.err
    pqsec(f"-k {IDENTITY} revoke /talker --yes").done()
    again = "issue /talker --certificate-only --force --after-revocation"
    done = pqsec(f"-k {IDENTITY} {again}").done()
    assert "permissions that were signed before stay: /talker" in done.err


def test_certificate_only_takes_no_rights_and_writes_no_bundles(machines, pqsec):
    for rights in ("--publish x", "--ros-node /n", "--domain 0"):
        pqsec(f"-k {IDENTITY} issue /arm --certificate-only {rights}").refused(2, "rights")
    pqsec(f"-k {IDENTITY} issue /arm --certificate-only --bundles b").refused(2, "bundles")


def test_keys_of_a_robot_are_certified_without_rights(machines, pqsec):
    pqsec("request /fleet/r1 --dir r1 --csr r1.csr").done()
    pqsec(f"-k {IDENTITY} issue --csr r1.csr /fleet/r1 --certificate-only").done()
    carried(machines, IDENTITY, PERMISSIONS)
    pqsec(f"-k {PERMISSIONS} permit /fleet/r1 --publish rt/chatter --yes").done()
    pqsec(f"-k {PERMISSIONS} bundle /fleet/r1 -o r1.bundle").done()
    pins = pqsec(f"-k {PERMISSIONS} ca show --pins").out.replace("\n", " ")
    pqsec(f"install r1.bundle --dir r1 {pins}").done()


def test_ca_show_tells_which_keys_are_here(machines, pqsec):
    said = pqsec(f"-k {IDENTITY} ca show").done().out
    assert "those of the identity CA not encrypted, those of the permissions CA not here" in said


DOMAIN = """
validity: 90d
roles:
  robot: {publish: [rt$name/pose]}
  monitor: {subscribe: ["rt/*"]}
participants:
  - {name: "/fleet/r{1..2}", role: robot}
  - {name: /talker, role: robot}
  - {name: /listener, role: monitor}
"""


@pytest.fixture
def fleet(machines, monkeypatch):
    """A domain file on both machines, whose participants are partly there."""
    monkeypatch.chdir(machines)
    (machines / "domain.yaml").write_text(DOMAIN)
    return machines


def apply(pqsec, machine, options="--yes"):
    return pqsec(f"-k {machine} apply --only {machine} {options}")


def test_a_domain_file_is_applied_on_two_machines_with_one_key_each(fleet, pqsec):
    certified = apply(pqsec, IDENTITY).done()
    assert "issue: 2 (/fleet/r1, /fleet/r2)" in certified.out
    assert "not selected, since they need the keys of the other CA" in certified.err
    assert not (fleet / IDENTITY / "enclaves/fleet/r1/permissions.p7s").exists()
    assert apply(pqsec, IDENTITY, "--check").code == 0
    carried(fleet, IDENTITY, PERMISSIONS)
    signed = apply(pqsec, PERMISSIONS).done()
    assert "sign permissions for: 4" in signed.out
    pqsec(f"-k {PERMISSIONS} apply --check").done()
    carried(fleet, PERMISSIONS, IDENTITY)
    assert pqsec(f"-k {IDENTITY} plan").done().out.startswith("no changes; 4 participants")
    pqsec(f"-k {IDENTITY} verify-handshake /fleet/r1 /listener").done()
    audit(Keystore.open(fleet / IDENTITY))


def test_the_machine_of_the_permissions_ca_certifies_nobody(fleet, pqsec):
    told = apply(pqsec, PERMISSIONS).done()
    assert "issue" not in told.out
    assert not (fleet / PERMISSIONS / "enclaves/fleet").exists()


def test_without_a_part_both_keys_are_needed(fleet, pqsec):
    pqsec(f"-k {IDENTITY} apply --yes").refused(3, MISSING, "permissions_ca.key.pem")
    pqsec(f"-k {IDENTITY} apply --only permissions --yes").refused(3, MISSING)
    pqsec(f"-k {PERMISSIONS} apply --only identity --yes").refused(3, MISSING)


def test_what_one_machine_renews_gets_rights_for_as_long_on_the_other(fleet, pqsec, monkeypatch):
    for machine in (IDENTITY, PERMISSIONS, IDENTITY):
        apply(pqsec, machine)
        other = PERMISSIONS if machine == IDENTITY else IDENTITY
        carried(fleet, machine, other)
    (fleet / "domain.yaml").write_text(DOMAIN.replace("90d", "200d") + "renew_before: 100d\n")
    renewed = apply(pqsec, IDENTITY).done()
    assert "renew: " in renewed.out
    carried(fleet, IDENTITY, PERMISSIONS)
    signed = apply(pqsec, PERMISSIONS).done()
    assert "sign permissions for: " in signed.out
    pqsec(f"-k {PERMISSIONS} apply --check").done()
    assert pqsec(f"-k {PERMISSIONS} check").code == 0


def test_one_machine_revokes_whom_the_file_no_longer_names(fleet, pqsec):
    (fleet / "domain.yaml").write_text(DOMAIN.replace("  - {name: /talker, role: robot}\n", ""))
    assert "revoke: 1 (/talker)" in apply(pqsec, IDENTITY, "--yes --prune").done().out


def test_a_part_is_refused_where_it_means_nothing(fleet, pqsec):
    apply(pqsec, IDENTITY, "--yes --bundles b").refused(2, "where the permissions are signed")
    pqsec("-k new apply --only identity --yes").refused(3, "there is no keystore yet")
    pqsec("-k new apply plan.json --only identity").refused(2, "for a domain file, not for a plan")


def test_people_approve_each_part(fleet, pqsec):
    """The approval of certificates is none of rights: each machine has a plan of its own."""
    for name in ("alice", "bob"):
        make_key(fleet, name)
    rule = "approvals: {required: 2, of: {alice: alice.pub.pem, bob: bob.pub.pem}}\n"
    (fleet / "domain.yaml").write_text(DOMAIN + rule)
    apply(pqsec, PERMISSIONS).done()
    carried(fleet, PERMISSIONS, IDENTITY)
    for machine, words in ((IDENTITY, "issue: 2"), (PERMISSIONS, "sign permissions for: 2")):
        apply(pqsec, machine).refused(3, "approvals are needed for rights that grow: 2 of alice")
        plan = f"plan --only {machine} -o {machine}.json --key alice.pem"
        pqsec(f"-k {machine} {plan}").done()
        shown = pqsec(f"approve {machine}.json --key bob.pem --yes").done()
        assert shown.out
        assert words in pqsec(f"-k {machine} apply {machine}.json --yes").done().out
        pqsec(f"-k {machine} apply {machine}.json --yes").refused(1, "applied already")
        carried(fleet, IDENTITY, PERMISSIONS)
