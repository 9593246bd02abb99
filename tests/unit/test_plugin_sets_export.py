"""Exports with pqsec's plugin for a participant with several sets: its `pqsec.toml`."""

import shutil
import tomllib
from dataclasses import replace
from pathlib import PurePosixPath

import pytest

from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import Options, export
from tests.unit.keystores import NOW
from tests.unit.plugin_wire import RefusedError
from tests.unit.test_plugin_exports import put_plugin
from tests.unit.test_plugin_sets import CLASSICAL_SIGNATURE, A, B, Peer, made, meet


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return made(tmp_path_factory.mktemp("export") / "k", "classical", "hybrid").root


@pytest.fixture
def keystore(model, tmp_path):
    shutil.copytree(model, tmp_path / "k", symlinks=True)
    return Keystore.open(tmp_path / "k")


@pytest.fixture
def options(tmp_path):
    return Options(plugin=put_plugin(tmp_path / "plugin"))


def exported(keystore, options, name=A, stack=Stack.CYCLONEDDS):
    return export(stack, keystore, name, options, now=NOW)


def installed(keystore, made_export, name=A):
    folder = keystore.root / f"sets/hybrid/enclaves{name}"
    (folder / "pqsec.toml").write_text(made_export.files["pqsec.toml"])
    return folder


@pytest.mark.parametrize("stack", [Stack.CYCLONEDDS, Stack.ROS2])
def test_the_configuration_names_the_strongest_set_and_the_file_all(keystore, options, stack):
    options = replace(options, anyway=stack is Stack.ROS2)  # /a may not discover as a node
    made_export = exported(keystore, options, stack=stack)
    place = keystore.root / "sets/hybrid"
    assert str(place) in str(made_export.files[made_export.main])
    assert tomllib.loads(made_export.files["pqsec.toml"]) == {
        "stock": [],
        "sets": {"classical": "../../../../enclaves/a", "hybrid": "."},
    }
    step = f"install -m 644 \0/pqsec.toml {place}/enclaves/a/pqsec.toml"
    assert step in made_export.steps


def test_what_is_exported_meets_with_the_plugin(keystore, options):
    """The plugin reads what the export writes: those that are named, and nobody else."""
    named = replace(options, stock=(B,))
    folder = installed(keystore, exported(keystore, named))
    assert meet(Peer(folder), Peer(keystore.root / "enclaves/b")) == CLASSICAL_SIGNATURE
    folder = installed(keystore, exported(keystore, replace(options, stock=())))
    with pytest.raises(RefusedError):
        meet(Peer(folder), Peer(keystore.root / "enclaves/b"))


def test_settings_that_are_there_stay(keystore, options):
    folder = keystore.root / "sets/hybrid/enclaves/a"
    text = (
        'proofs = true\nwire_versions = [2, 1]\nkey_agreements = ["mlkem768", "x25519mlkem768"]\n'
    )
    (folder / "pqsec.toml").write_text(text)
    with pytest.raises(VerificationError, match=r"ledger\.proof"):  # it demands one, as before
        exported(keystore, replace(options, stock=("/x/*", B)))
    found = exported(keystore, replace(options, stock=("/x/*", B), anyway=True))
    settings = tomllib.loads(found.files["pqsec.toml"])
    assert settings.pop("sets")
    assert settings == tomllib.loads(text) | {"stock": ["/x/*", B]}
    (folder / "pqsec.toml").write_text(found.files["pqsec.toml"].replace("proofs = true\n", ""))
    again = exported(keystore, options)
    assert tomllib.loads(again.files["pqsec.toml"])["stock"] == ["/x/*", B]


def test_the_place_on_another_machine_is_that_of_the_strongest_set(keystore, options):
    at = PurePosixPath("/etc/dds/current/enclaves/a")
    found = exported(keystore, replace(options, at=at))
    assert "/etc/dds/current/sets/hybrid/enclaves/a/cert.pem" in found.files["cyclonedds.xml"]
    assert not [each for each in found.steps if "install" in each]
    assert "/etc/dds/current/sets/hybrid/enclaves/a/pqsec.toml" in str(found.notes)
    with pytest.raises(UsageError, match="does not end in /enclaves/a"):
        exported(keystore, replace(options, at=PurePosixPath("/etc/dds/a")))
    with pytest.raises(UsageError, match="files of one set"):
        exported(keystore, replace(options, at=at), stack=Stack.ROS2)


@pytest.mark.parametrize("folder", ["enclaves/a", "sets/hybrid/enclaves/a"])
@pytest.mark.parametrize("file", ["permissions.p7s", "key.pem"])
def test_what_one_set_lacks_or_has_otherwise_refuses_the_export(keystore, options, folder, file):
    path = keystore.root / folder / file
    other = (keystore.root / folder / f"../b/{file}").read_bytes()
    path.unlink()
    path.write_bytes(other)
    with pytest.raises(VerificationError):
        exported(keystore, options)


def test_names_are_for_several_sets(tmp_path, options):
    one = made(tmp_path / "one", "pq")
    with pytest.raises(UsageError, match="several sets"):
        exported(one, replace(options, stock=(B,)))
    assert list(exported(one, options).files) == ["cyclonedds.xml"]
