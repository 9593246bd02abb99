"""No hint destroys: each that has --force says what is lost, or is for what was checked."""

import ast
from collections.abc import Iterator
from pathlib import Path

import yaml

import pqsec_pki

ROOT = Path(pqsec_pki.__file__).parent
REPLACES_A_FILE = "a file of the user's choice is in the way, and the hint says that it is replaced"
SAYS_WHAT = "the hint says that the user must state the rights that were lost, or would be, again"
NEWEST = "a copy of what the keystore has takes the place of an older copy"
IF_WANTED = "for a participant that was revoked, and only if it may come back"
JUSTIFIED = {
    "choose another place, or --force to replace it": REPLACES_A_FILE,
    "choose another -o, or --force to replace it": REPLACES_A_FILE,
    "`pqsec permit` changes rights and `pqsec renew` renews; --force replaces key,"
    " certificate and permissions": "the user named a participant that is there",
    "to admit it again, issue it with --force --after-revocation": IF_WANTED,
    "to admit it again: `pqsec issue` with --force --after-revocation": IF_WANTED,
    "to admit them again, with new rights: `* --force --after-revocation`": IF_WANTED,
    "to issue {name} again, use `pqsec issue` with --force --after-revocation": IF_WANTED,
    "remove it from the file; or, if it came back, run `pqsec issue {} --validity {} --force"
    " --after-revocation`, and apply it again": IF_WANTED,
    "remove it from the file; or, if it came back, `pqsec enrolment-token create {} --replace"
    " --after-revocation`, or `pqsec issue --csr` with --force --after-revocation, and apply it"
    " again": IF_WANTED,
    "if it came back, `pqsec enrolment-token create NAME --replace --after-revocation` makes a"
    " token for it at the server, and `pqsec enrol --force` with that a new key here": IF_WANTED,
    "on the robot: `pqsec enrol --force` makes a new key for *": IF_WANTED,
    "`pqsec propose issue --csr FILE --force --after-revocation` proposes it": IF_WANTED,
    "Restore the newest one from a backup, or make the next: `pqsec ca crl`, `pqsec apply` or"
    " `pqsec sign-governance`, `pqsec issue NAME --force`. If another machine uses this ledger,"
    " `pqsec ca recover` gets it.": "what is there is older than what was issued",
    "* bundle *--outdated --no-keys --bundles bundles --force": NEWEST,
    "* ca crl --show --force -o crl.pem": NEWEST,
    "* ca crl --show --set * --force -o *.crl.pem": NEWEST,
    "Delete its enclave. To allow it again, run `pqsec issue` with --force"
    " --after-revocation.": IF_WANTED,
    "issue it again: pqsec issue --force, with its topics or a --policy": SAYS_WHAT,
    "issue it again: `pqsec issue` with --force and all its topics; with --csr if its key is on"
    " the robot": SAYS_WHAT,
    "Restore the files that were issued; if only `ledger.proof` is missing or wrong, install a new"
    " bundle. Else run `pqsec issue` with --force and all rights of the participant.": SAYS_WHAT,
    "restore it, or issue it again: pqsec issue * --force ...; if it was issued with"
    " --certificate-only: pqsec permit * ...": SAYS_WHAT,
    "restore that file, or issue it again: pqsec issue * --force ...": SAYS_WHAT,
    "restore it from a backup; or issue it again, with new keys and permissions: pqsec issue *"
    " --force ...": SAYS_WHAT,
    "add the domain to * and run `pqsec -k * sign-governance * --force`; the permissions must"
    " name the domain too": "it signs what the user edits, in place of what was signed before",
    "`pqsec -k * sign-permissions * --force` signs what it says now; or remove *: it is written"
    " again from the signed document": "it signs what the user edited, and names the file",
    "*: not signed by the permissions CA (*), and no participant starts with it: restore the"
    " signed file, or review governance.xml and `pqsec -k * sign-governance * --force`": (
        "it replaces a governance that no stack accepts, and says to review it first"
    ),
    "review governance.xml and `pqsec -k * sign-governance * --force`": (
        "it signs what is signed in the form of pqsec, and says to review it first"
    ),
    "Issue the participant again, in all sets: `pqsec issue NAME --force` with all its rights."
    " `pqsec sign-governance` signs the governance in all sets, `pqsec ca crl` issues all"
    " lists.": SAYS_WHAT,
    "`pqsec verify-handshake` asks the token. For a key in a file: `pqsec issue --force"
    " --participant-key-uri file`, with all rights of the participant.": SAYS_WHAT,
    "*issue it with a key in a file, and all its rights: --force --participant-key-uri file": (
        SAYS_WHAT
    ),
    "work there; or issue it here: `pqsec issue * --force`, with all its rights": SAYS_WHAT,
    "work there; --force issues it here, with new key, certificate and permissions": SAYS_WHAT,
    "an order enrols new names only; `pqsec issue --csr --force` replaces certificate and"
    " permissions": SAYS_WHAT,
    "enrol into another --dir; --force replaces what is installed here": SAYS_WHAT,
    "make a new request: `pqsec enrol --force`, with the same options": (
        "the server has refused what would be lost"
    ),
    "--force, --after-revocation and --reuse-compromised-key are for other requests": (
        "it tells nobody to use it"
    ),
    "pqsec issue * --force *": "a node lacks topics that it needs to live; its own are named",
}
SHOWN = {"examples", "bad", "good"}
"""What is shown in help and of rules: no user is told to run it for what was found here."""
WORDS = ("all its", "--ros-node", "plugin install")
"""One of them stands in each remedy of explain-error with --force."""


def texts(path: Path) -> Iterator[str]:
    """Those of a module with --force, with * for what is filled in; no options or examples."""
    tree = ast.parse(path.read_text())
    passed = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "option":
            passed |= {id(each) for each in ast.walk(node)}
        if isinstance(node, ast.keyword) and node.arg in SHOWN:
            passed |= {id(each) for each in ast.walk(node)}
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            passed.add(id(node.value))  # a docstring
        if isinstance(node, ast.JoinedStr):
            text = "".join(
                str(part.value) if isinstance(part, ast.Constant) else "*" for part in node.values
            )
            if "--force" in text and id(node) not in passed:
                yield text
            passed |= {id(each) for each in node.values}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Constant) or id(node) in passed or node.value == "--force":
            continue
        if isinstance(node.value, str) and "--force" in node.value:
            yield node.value


def test_each_hint_that_has_force_has_its_reason():
    paths = [path for path in ROOT.rglob("*.py") if "--force" in path.read_text()]
    found = {text for path in paths for text in texts(path)}
    assert found == set(JUSTIFIED)


def test_each_remedy_that_has_force_says_that_rights_are_said_anew():
    messages = yaml.safe_load((ROOT / "vendors/messages.yaml").read_text())
    entries = messages if isinstance(messages, list) else messages["messages"]
    remedies = [each["remedy"] for each in entries if "--force" in each.get("remedy", "")]
    assert len(remedies) > 5
    assert [each for each in remedies if not any(word in each for word in WORDS)] == []


def test_no_hint_names_a_domain_that_was_not_asked_for(pqsec, keystore):
    """Two robots of domain 1 were told to move one of them to domain 0."""
    keystore()
    pqsec("governance new --domain 0-1 -o g.yaml").done()
    pqsec("-k k sign-governance g.yaml -o k/enclaves/governance.p7s --force").done()
    pqsec("-k k issue /r1 /r2 --domain 1 --publish a --subscribe a").done()
    said = pqsec("-k k verify-handshake /r1 /r2").done()
    assert "domain 1" in said.out
    refused = pqsec("-k k verify-handshake /r1 /r2 --domain 0")
    assert refused.code == 1
    assert "--force" not in refused.out + refused.err
