"""What git takes of a keystore: everything that is public, and no secret."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SECRET = re.compile(rb"PRIVATE KEY|correct horse|secret of a token")
PASSPHRASE = "correct horse battery staple"


@pytest.fixture
def added(tmp_path, requires):
    """The files that `git add -A` takes in the test's folder."""
    requires(shutil.which("git"), "git", "apt-get install git")

    def git(*words):
        plain = ["git", "-c", "core.excludesFile=/dev/null", *words]
        return subprocess.run(
            plain, cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout

    def taken():
        git("init", "-q")
        git("add", "-A")
        return git("ls-files").splitlines()

    return taken


def refuse_secrets(folder, names):
    """None of the files has a secret, also those whose name says nothing."""
    assert names
    regular = [folder / each for each in names if (folder / each).is_file()]
    assert [path for path in regular if SECRET.search(path.read_bytes())] == []
    assert [name for name in names if "/private/" in f"/{name}"] == []


WAYS = {
    "init": [
        "-k k ca init --passphrase-file passphrase",
        "-k k issue /a /fleet/b --publish rt/a --passphrase-file passphrase",
    ],
    "unencrypted": [
        "-k k ca init --no-passphrase --profile pq",
        "-k k issue /a /fleet/b --publish rt/a",
    ],
    "apply": ["-k k apply --yes --no-passphrase"],
    "demo": ["demo k"],
    "rotate": [
        "-k k ca init --no-passphrase",
        "-k k issue /a /fleet/b --publish rt/a",
        "-k k ca crl",
        "-k k ca rotate --apply --yes --no-passphrase",
    ],
}


@pytest.mark.parametrize("way", WAYS)
def test_no_secret_of_a_keystore_goes_into_git(pqsec, tmp_path, added, way):
    (tmp_path / "domain.yaml").write_text(
        "name: A\nparticipants:\n  - {name: /a, publish: [rt/a]}\n"
    )
    passphrase = tmp_path / ("k.passphrase" if way != "init" else "passphrase")
    passphrase.write_text(PASSPHRASE)
    passphrase.chmod(0o600)
    for line in WAYS[way]:
        assert pqsec(line).code == 0
    passphrase.rename(tmp_path / "k/passphrase")
    (tmp_path / "k/a.token").write_text("secret of a token")
    names = added()
    refuse_secrets(tmp_path, names)
    enclave = {"demo": "talker"}.get(way, "a")
    wanted = {"k/public/identity_ca.cert.pem", "k/pqsec.json", "k/enclaves/governance.p7s"}
    wanted |= {f"k/enclaves/{enclave}/{each}" for each in ("cert.pem", "permissions.p7s")}
    assert wanted <= set(names), "what is public can be kept in git"


def test_a_users_own_rules_stay_and_do_not_let_keys_in(pqsec, tmp_path, added):
    (tmp_path / "k").mkdir()
    (tmp_path / "k/.gitignore").write_text("notes.txt\n!key.pem\n!private")
    pqsec("-k k ca init --no-passphrase").done()
    pqsec("-k k issue /a --publish rt/a").done()
    (tmp_path / "k/notes.txt").write_text("mine")
    text = (tmp_path / "k/.gitignore").read_text()
    assert text.startswith("notes.txt\n!key.pem\n!private\n# Written by pqsec")
    names = added()
    refuse_secrets(tmp_path, names)
    assert "k/notes.txt" not in names


def test_an_adopted_keystore_keeps_its_keys_too(pqsec, tmp_path, added):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    pqsec("-k k issue /a --publish rt/a").done()
    for each in (".gitignore", "pqsec.json", "private/ledger.sqlite3"):
        (tmp_path / "k" / each).unlink()
    pqsec("adopt k").done()
    refuse_secrets(tmp_path, added())


def test_keys_of_a_server_and_tokens_stay_out_of_git(pqsec, tmp_path, added):
    (tmp_path / "domain.yaml").write_text(
        "name: A\nparticipants:\n  - {name: /a, publish: [rt/a]}\n"
    )
    pqsec("-k k apply --yes --no-passphrase").done()
    pqsec("-k k serve --init https://localhost:8443").done()
    pqsec("-k k enrolment-token create /a -o a.token").done()
    names = added()
    refuse_secrets(tmp_path, names)
    assert not [name for name in names if name.endswith((".token", ".key"))]
    assert "serve.yaml" in names


def test_the_session_of_the_readme_leaves_nothing_to_commit_in_the_checkout(tmp_path, added):
    """Its files are to stand elsewhere; in the checkout they are ignored."""
    shutil.copy(ROOT / ".gitignore", tmp_path)
    text = (ROOT / "README.md").read_text()
    made = {"pqsec-demo/private/k", "robots/private/k", "robots/enclaves/a/key.pem", "passphrase"}
    made |= {"forged.p7s", "talker/cyclonedds.xml", "ros2-talker/env.sh", "domain.yaml"}
    for name in made:
        assert name.partition("/")[0] in text
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("secret of a token")
    assert added() == [".gitignore"]


def test_a_clone_of_a_keystore_says_what_it_lacks(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    shutil.rmtree(tmp_path / "k/private")  # which git leaves out
    for line in ("status", "issue /a --publish rt/a", "log"):
        pqsec(f"-k k {line}").refused(3, "k/private: no such file", hint="restore it from a backup")
