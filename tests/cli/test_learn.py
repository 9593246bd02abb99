"""pqsec permissions learn on the command line."""

from pathlib import Path

from pqsec_pki.documents import permissions_from_yaml
from tests.unit.keystores import NOW

RECORDED = Path(__file__).parents[1] / "vectors/learning"
KITCHEN, PARTITIONS, NODES = (
    RECORDED / name for name in ("kitchen.log", "partitions.log", "nodes.txt")
)


def grants(text):
    return {each.name: each for each in permissions_from_yaml(text.encode(), now=NOW).grants}


def test_without_a_keystore_the_proposal_is_printed_or_written(pqsec, tmp_path):
    printed = pqsec("permissions learn --validity 90d", KITCHEN, NODES).done().out
    assert set(grants(printed)) == {
        "/clocked",
        "/cook",
        "/guest",
        "/kitchen/cook",
        "/lift/second",
        "/observer",
    }
    value = pqsec("permissions learn --validity 90d --json", KITCHEN, NODES).done().json
    assert value["document"] == printed
    assert (value["participants"], value["unread"]) == (None, [])
    pqsec("permissions learn --validity 90d -o l.yaml", KITCHEN, NODES).done()
    assert (tmp_path / "l.yaml").read_text() == printed
    pqsec("permissions learn -o l.yaml", KITCHEN).refused(3, "l.yaml exists")


def test_it_is_compared_with_a_keystore_until_all_is_granted(pqsec, keystore):
    root = keystore("classical")
    line = f"-k {root} permissions learn"
    first = pqsec(line, KITCHEN)
    assert first.code == 1
    assert "# in the keystore and never seen: /listener\n" in first.out
    assert "  # not in the keystore\n  - name: /guest\n" in first.out
    pqsec(f"{line} -o learned.yaml", KITCHEN)
    pqsec(f"-k {root} issue --policy learned.yaml").done()
    again = pqsec(f"{line} --json", KITCHEN).done().json
    assert [
        (each["name"], each["not_granted"], each["never_seen"]) for each in again["participants"]
    ] == [(name, [], []) for name in ("/guest", "/kitchen/cook", "/observer")]
    more = pqsec(f"-k {root} permit /guest --add --subscribe rt/order --yes")
    more.done()
    told = pqsec(f"{line} -o other.yaml", KITCHEN).done().out
    assert "/guest: granted and never seen: subscribe 'rt/order' on domain 0\n" in told


def test_lines_that_cannot_be_read_are_named_and_the_rest_is_written(pqsec, tmp_path):
    found = pqsec("permissions learn --name gripper=/arm -o arm.yaml", PARTITIONS)
    assert found.code == 3
    assert f"not read: {PARTITIONS}:17: its enclave is cut" in found.err
    assert "1 line cannot be read" in found.err
    text = (tmp_path / "arm.yaml").read_text()
    assert "# 1 line could not be read\n" in text
    assert set(grants(text)) == {"/arm"}
    many = tmp_path / "many.txt"
    many.write_text(NODES.read_text() + 50 * "\x1b[2Jhello\n")
    told = pqsec("permissions learn -o many.yaml", many)
    assert told.code == 3
    assert told.err.count("not read:") == 20
    assert "30 of them are not named" in told.err
    assert "\x1b" not in told.err


def test_wrong_names(pqsec):
    pqsec("permissions learn --name camera", NODES).refused(2, "SEEN=/NAME")
    pqsec("permissions learn --name /cok=/arm", NODES).refused(2, "'/cok'", hint="'/cook'")
    pqsec("permissions learn --domain 231", NODES).refused(2, "231")
    found = pqsec(
        "permissions learn --name /cook=/_hidden --name /clocked=/_b --name /lift/second=/_c", NODES
    )
    assert found.done().out.endswith("no participant to propose permissions for\n")
