"""The example of each rule: what is bad is found by that rule, and what is good is not.

An example in XML is a part of a document without findings: its elements replace those of the
same tag, `...` stands for those between, and a blank line for others. An example in YAML is a
suppression file. Commands run beside a keystore `k` with /talker and /listener, in a copy for
each rule, and those of the good example after those of the bad one; `# 400 days later` is when
the check runs.
"""

import re
import shutil
import subprocess
import sys
from contextlib import suppress
from datetime import UTC, datetime, timedelta

import pytest
from lxml import etree

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.errors import FileError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lint import RULES, check
from pqsec_pki.smime import Signer, document_in
from tests.cli.conftest import clean_environment
from tests.unit.signed_files import quoted_parameter
from tests.unit.test_lint_documents import GOVERNANCE, NOW, PERMISSIONS
from tests.unit.test_lint_pq import by_another_alternative_key
from tests.unit.test_lint_pq import signed as countersigned
from tests.unit.test_lint_x509 import endless, old

TAG = re.compile(r"(?m)^(?:<!--[^<]*)?<(\w+)")
INNER_TAG = re.compile(r"  <(\w+)")
OTHER_TIME = re.compile(r"(?m)^# (\d+) (days|hours) (later|earlier)$")
PQSEC = "pqsec "

# What is found too, rightly.
AND_ALSO = {
    **{id_: {"PQS707"} for id_ in ("PQS002", "PQS003", "PQS005")},
    "PQS203": {"PQS206"},
    **{id_: {"PQS220"} for id_ in ("PQS202", "PQS206", "PQS208", "PQS209", "PQS210", "PQS211")},
    **{id_: {"PQS220"} for id_ in ("PQS213", "PQS214", "PQS215", "PQS216", "PQS219", "PQS264")},
    "PQS106": {"PQS101"},
    "PQS142": {"PQS112", "PQS322", "PQS348"},
    "PQS348": {"PQS112", "PQS322"},
    "PQS145": {"PQS319"},
    "PQS146": {"PQS149"},
    "PQS147": {"PQS149"},
    "PQS217": {"PQS202", "PQS220"},
    "PQS220": {"PQS213"},
    "PQS243": {"PQS239"},
    "PQS257": {"PQS258"},
    "PQS262": {"PQS320", "PQS322"},
    "PQS273": {"PQS258"},
    "PQS302": {"PQS607"},
    "PQS306": {"PQS603"},
    "PQS308": {"PQS346"},
    "PQS309": {"PQS345", "PQS346"},
    "PQS311": {"PQS340"},
    "PQS312": {"PQS340"},
    "PQS314": {"PQS303"},
    "PQS316": {"PQS131", "PQS319", "PQS326", "PQS604"},
    "PQS319": {"PQS131", "PQS316"},
    "PQS327": {"PQS322", "PQS326"},
    "PQS341": {"PQS344"},
    "PQS502": {"PQS345", "PQS503"},
    "PQS503": {"PQS345"},
    "PQS504": {"PQS345", "PQS502", "PQS503"},
    "PQS601": {"PQS602"},
    "PQS602": {"PQS601"},
    "PQS604": {"PQS319", "PQS609"},
    "PQS605": {"PQS344"},
    "PQS606": {"PQS319"},
    "PQS607": {"PQS319"},
    "PQS609": {"PQS319", "PQS604"},
    "PQS802": {"PQS804"},
    "PQS803": {"PQS804"},
}


def kind(rule):
    return {"<": "XML", "$": "commands"}.get(rule.bad[:1], "YAML")


def rules(wanted):
    return [pytest.param(rule, id=rule.id) for rule in RULES.values() if kind(rule) == wanted]


def targets(rule):
    return sorted(rule.stacks)[:1] if rule.only_when_asked else []


def assert_is_found_by(rule, bad, good):
    assert rule.id in bad
    assert rule.id not in good
    assert bad - good == {rule.id} | AND_ALSO.get(rule.id, set())


def test_every_rule_has_an_example():
    assert [rule.id for rule in RULES.values() if not (rule.bad and rule.good)] == []


def test_no_example_deletes_a_folder():
    """A reader may have one of that name, with keys that exist nowhere else."""
    assert [rule.id for rule in RULES.values() if "rm -" in rule.bad + rule.good] == []


# XML


def element(tag, document):
    """Where it is in the document. A deny_rule may replace an allow_rule."""
    tag = tag.replace("deny_rule", "allow_rule")
    return re.search(rf"(?s)\s*<{tag}\b[^>]*>.*?</{tag}>", document)


def children(found):
    whole = etree.fromstring(found[0].strip()) if found else ()
    return [(each.tag, etree.tostring(each, encoding="unicode")) for each in whole]


def filled(part, document):
    """The part of a document, with the elements that `...` stands for."""
    lines = part.splitlines()
    result, left = [], []
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        tags = [tag for tag, _ in left]
        if found := TAG.match(line):
            left = children(element(found[1], document))
        elif (found := INNER_TAG.match(line)) and found[1] in tags:
            left = left[tags.index(found[1]) + 1 :]
        if line.strip() != "...":
            result.append(line)
            continue
        end = INNER_TAG.match(following)
        number = tags.index(end[1]) if end and end[1] in tags else len(tags)
        result += [text for _, text in left[:number]]
    return "\n".join(result)


def changed(document, example):
    """The document with the elements of the example."""
    for part in example.split("\n\n"):
        first, *others = TAG.findall(part)
        start, end = element(first, document).span()
        for tag in others:
            following = element(tag, document[end:])
            if following and following.start() == 0:
                end += following.end()
        document = document[:start] + filled(part, document) + document[end:]
    return document


@pytest.mark.parametrize("rule", rules("XML"))
def test_an_example_in_xml(rule, tmp_path):
    def found(example):
        tag = TAG.search(example)[1]
        is_granted = rule.scope.__name__ != "GovernanceFile" and element(tag, PERMISSIONS)
        document = changed(PERMISSIONS if is_granted else GOVERNANCE, example)
        (tmp_path / "document.xml").write_text(document)
        report = check([tmp_path / "document.xml"], now=NOW, targets=targets(rule))
        return {each.rule.id for each in report.findings}

    assert_is_found_by(rule, found(rule.bad), found(rule.good))


# In a keystore


class Signers:
    """The CAs of a keystore, for functions that make what no command makes."""

    def __init__(self, root):
        self._root = root

    def __truediv__(self, path):
        return self._root / path

    def authorities(self):
        return Keystore.open(self._root).unlock(None)


@pytest.fixture(scope="module")
def model(run_in, tmp_path_factory):
    """A keystore `k` of now, with /talker and /listener, a key, and what only others write."""
    folder = tmp_path_factory.mktemp("model")
    run_in(folder, "-k k ca init --no-passphrase --profile transition").done()
    run_in(folder, "-k k issue --publish chatter /talker").done()
    run_in(folder, "-k k issue --subscribe chatter /listener").done()
    shutil.copy(folder / "k/enclaves/talker/key.pem", folder)
    signers, now = Signers(folder / "k"), datetime.now(UTC)
    signed = (folder / "k/enclaves/talker/permissions.p7s").read_bytes()
    denied = signers.authorities().sign(document_in(signed).replace(b"ALLOW", b"DENY"), now=now)
    other_key = SIGNATURES.named("ml-dsa-65").generate()
    countersigner = signers.authorities().countersigner.certificate
    made = {
        "version-1.pem": old("")[1],
        "no-next-update.crl.pem": endless(signers.authorities().identity.key.handle),
        "ambiguous.p7s": quoted_parameter(signed, denied),
        "forged.cert.pem": by_another_alternative_key(signers),
        "forged.p7s": countersigned(signers, Signer(countersigner, other_key)),
    }
    (folder / "elsewhere").mkdir()
    for name, data in made.items():
        (folder / "elsewhere" / name).write_bytes(data)
    return folder


@pytest.fixture
def place(model, tmp_path):
    return shutil.copytree(model, tmp_path / "place", symlinks=True)


def found_in(place, rule, example=""):
    """What is found in each folder, and in the files together, at the time of the example."""
    time = datetime.now(UTC)
    for number, unit, way in OTHER_TIME.findall(example):
        time += timedelta(**{unit: int(number)}) * (1 if way == "later" else -1)
    folders = [[each] for each in place.iterdir() if each.is_dir() and each.name != "elsewhere"]
    ids = set()
    for paths in (*folders, [each for each in place.iterdir() if each.is_file()]):
        with suppress(FileError):  # there is nothing to check in it
            ids |= {each.rule.id for each in check(paths, now=time, targets=targets(rule)).findings}
    return ids


def run(example, place, run_in):
    """Run its commands: pqsec in this process, if the shell has nothing to do."""
    for command in re.split(r"(?m)^\$ ", OTHER_TIME.sub("", example))[1:]:
        if command.startswith(PQSEC) and "$" not in command:
            run_in(place, command.removeprefix(PQSEC)).done()
        else:
            function = f'pqsec() {{ "{sys.executable}" -m pqsec_pki "$@"; }}\n'
            subprocess.run(
                ["bash", "-euo", "pipefail", "-c", function + command], cwd=place, check=True,
                env=clean_environment(), capture_output=True,
            )  # fmt: skip


@pytest.mark.slow(but=42)
@pytest.mark.parametrize("rule", rules("commands"))
def test_an_example_with_commands(rule, place, run_in, requires):
    requires(shutil.which("openssl"), "OpenSSL", "apt install openssl")
    run(rule.bad, place, run_in)
    bad = found_in(place, rule, rule.bad)
    run(rule.good, place, run_in)
    assert_is_found_by(rule, bad, found_in(place, rule, rule.good))


@pytest.mark.parametrize("rule", rules("YAML"))
def test_an_example_of_a_suppression_file(rule, place):
    def found(example):
        (place / "k/.pqsec-check.yaml").write_text(example + "\n")
        return found_in(place, rule)

    assert_is_found_by(rule, found(rule.bad), found(rule.good))
