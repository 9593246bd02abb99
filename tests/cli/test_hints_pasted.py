"""The command in a hint works when it is pasted."""

import re
import shutil
from datetime import UTC, datetime

import pytest

from pqsec_pki.keystore import Keystore, State, status


def command_in(result):
    """The words of the command of pqsec in the hint, without `pqsec`."""
    last = result.err.splitlines()[-1]
    assert last.startswith("pqsec: hint: "), result
    [command] = re.findall(r"`pqsec ([^`]+)`", last)
    return command


@pytest.fixture
def keystore(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    pqsec("-k k issue /thief /thin --publish rt/a").done()
    return tmp_path / "k"


def state_of(root, name):
    found = status(Keystore.open(root), [name], now=datetime.now(UTC))
    return found.participants[0].state


@pytest.mark.parametrize("line", ["renew '/thi*'", "issue '/thi*' --force --publish rt/a"])
def test_revoked_participants_are_admitted_again_by_their_pattern(pqsec, keystore, line):
    """--after-revocation was ignored: all that match are revoked."""
    pqsec("-k k revoke /thief /thin --yes").done()
    refused = pqsec(f"-k k {line}")
    assert (refused.code, "all that match /thi* are revoked" in refused.err) == (3, True)
    pqsec(f"{command_in(refused)} --publish rt/a").done()
    assert {state_of(keystore, name) for name in ("/thief", "/thin")} == {State.VALID}


def test_after_revocation_issues_all_that_match(pqsec, keystore):
    pqsec("-k k revoke /thief --yes").done()
    pqsec("-k k issue '/thi*' --force --publish rt/b")
    assert state_of(keystore, "/thief") is State.REVOKED
    done = pqsec("-k k issue '/thi*' --force --after-revocation --publish rt/b").done()
    assert [line.split()[0] for line in done.out.splitlines()] == ["/thief", "/thin"]
    assert "left out" not in done.err


def two_domains(pqsec):
    """Bundles of one name in two domains, of the first an older one too; and the pins of each."""
    for each in "ab":
        pqsec(f"-k {each} ca init --no-passphrase --profile classical --name {each}").done()
        pqsec(f"-k {each} issue /r --publish rt/a").done()
        pqsec(f"-k {each} bundle /r --plain-key -o {each}.bundle").done()
    pqsec("-k a renew /r").done()
    pqsec("-k a bundle /r --plain-key -o newer.bundle").done()
    return [pqsec(f"-k {each} ca show --pins").out for each in "ab"]


def test_a_folder_of_another_domain_is_told_and_older_ones_are_not_proposed(pqsec):
    """Numbers of two domains are not compared: only what is older in its own domain is refused."""
    first, second = two_domains(pqsec)
    pqsec(f"install newer.bundle --dir r {first}").done()
    pqsec(f"install b.bundle --dir r {second}").done()
    refused = pqsec(f"install a.bundle --dir r {first}")
    assert refused.code == 1
    hint = refused.err.splitlines()[-1]
    assert "r has credentials of other CAs: name another --dir for another domain" in hint
    assert "--older" not in hint
    pqsec(f"install a.bundle --dir another {first}").done()


def test_an_option_with_another_meaning_is_not_proposed_for_force(pqsec, keystore, tmp_path):
    """It was --replace, which lets a token replace a robot's certificate."""
    (tmp_path / "domain.yaml").write_text("participants:\n  - {name: /thief, publish: [rt/a]}\n")
    pqsec("-k k serve --init https://localhost:8443").done()
    line = "-k k enrolment-token create /thief -o t"
    pqsec(line).done()
    refused = pqsec(f"{line} --force").refused(2, "--force", hint="remove what is in its way")
    assert "--replace" not in refused.err
    (tmp_path / "t").unlink()
    pqsec(line).done()
    assert "Did you mean" in pqsec(f"{line} --replaces").err


def test_check_knows_what_export_wrote(pqsec, keystore, tmp_path):
    """It took a configuration of Cyclone DDS for a document: 11 errors."""
    pqsec("-k k export cyclonedds /thief -o out")
    assert (tmp_path / "out/cyclonedds.xml").exists()
    pqsec("check out").done()
    pqsec("check out/cyclonedds.xml").done()
    pqsec("-k k export fastdds /thief -o fast")
    pqsec("check fast").done()
    shutil.copy(tmp_path / "out/cyclonedds.xml", keystore / "enclaves/thief/permissions.xml")
    assert "PQS203" in pqsec("check k").out  # where a document belongs it is a mistake
