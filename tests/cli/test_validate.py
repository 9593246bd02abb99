"""pqsec validate: documents against their schemas, with any signer."""

import re

import pytest

from tests.cli.conftest import snapshot

GOVERNANCE = "k/enclaves/governance"
PERMISSIONS = "k/enclaves/talker/permissions"


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        (f"{GOVERNANCE}.xml", "governance"),
        (f"{GOVERNANCE}.p7s", "governance"),
        (f"{PERMISSIONS}.xml", "permissions"),
        (f"{PERMISSIONS}.p7s", "permissions"),
    ],
)
def test_the_kind_is_found_signed_or_not(pqsec, keystore, file, kind):
    keystore("transition")
    assert pqsec("validate", file).done().out == f"{file}: valid {kind} document\n"
    assert pqsec("validate --json", file).done().json["files"] == [
        {"file": file, "valid": True, "kind": kind, "problems": []}
    ]


def test_no_keystore_is_needed_and_nothing_is_written(pqsec, keystore, tmp_path):
    keystore()
    before = snapshot(tmp_path)
    pqsec(f"validate {GOVERNANCE}.xml", PQSEC_KEYSTORE="nowhere").done()
    assert snapshot(tmp_path) == before


def test_a_broken_document_is_told_with_file_line_element_and_rule(pqsec, keystore, tmp_path):
    text = (keystore() / "enclaves/governance.xml").read_text()
    (tmp_path / "broken.xml").write_text(text.replace(">SIGN<", ">SIGNED<"))
    number = text[: text.index(">SIGN<")].count("\n") + 1
    said = pqsec("validate broken.xml")
    assert said.code == 1
    start = f"broken.xml: line {number}: <rtps_protection_kind>: 'SIGNED' is not one of "
    assert said.out.startswith(start)
    [result] = pqsec("validate broken.xml --json").json["files"]
    assert result["valid"] is False
    [problem] = result["problems"]
    assert problem["line"] == number
    assert problem["element"] == "rtps_protection_kind"
    assert problem["rule"].startswith("'SIGNED' is not one of")
    assert problem["text"] == said.out.removeprefix("broken.xml: ").rstrip("\n")


def test_the_xml_inside_a_signed_file_is_checked(pqsec, keystore, tmp_path):
    signed = (keystore() / "enclaves/governance.p7s").read_text()
    (tmp_path / "broken.p7s").write_text(signed.replace(">SIGN<", ">SIGNED<"))
    said = pqsec("validate broken.p7s")
    assert said.code == 1
    assert "<rtps_protection_kind>: 'SIGNED' is not one of" in said.out


def test_all_files_are_told_and_one_that_is_broken_makes_it_a_no(pqsec, keystore, tmp_path):
    keystore()
    (tmp_path / "broken.xml").write_text("<dds/>")
    said = pqsec(f"validate broken.xml {GOVERNANCE}.xml {PERMISSIONS}.xml")
    assert said.code == 1
    lines = said.out.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("broken.xml: line 1: <dds>: ")
    assert lines[1:] == [
        f"{GOVERNANCE}.xml: valid governance document",
        f"{PERMISSIONS}.xml: valid permissions document",
    ]
    results = pqsec(f"--json validate {GOVERNANCE}.xml broken.xml").json["files"]
    assert [result["valid"] for result in results] == [True, False]


SIGNED = b'Content-Type: multipart/signed; boundary="x"\n\n--x\n'
NO_DOCUMENTS = {
    "empty": b"",
    "binary": b"\0\xff" * 99,
    "cut": b"<dds>",
    "text": b"hello",
    "bare": b"<dds/>",
    "namespace": b"<dds xmlns='urn:x'><permissions/></dds>",
    "entity": b'<!DOCTYPE dds [<!ENTITY a "b">]><dds>&a;</dds>',
    "deep": b"<a>" * 5000,
    "no boundary": b"Content-Type: multipart/signed\n\n",
    "no header": SIGNED + b"\n--x\n\n--x--\n",
    "bare inside": SIGNED + b"Content-Type: text/plain\n\n<dds/>\n--x\n\nAAAA\n--x--\n",
}


@pytest.mark.parametrize("content", NO_DOCUMENTS.values(), ids=NO_DOCUMENTS)
def test_what_is_no_document_is_a_no_with_a_reason(pqsec, tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    said = pqsec("validate file")
    assert said.code == 1
    assert said.err == ""
    assert said.out.startswith("file: ")
    [result] = pqsec("validate file --json").json["files"]
    assert result["valid"] is False
    assert result["kind"] is None
    assert result["problems"][0]["text"]


def test_a_file_that_cannot_be_read_is_an_error_and_not_a_no(pqsec, tmp_path):
    pqsec("validate nowhere.xml").refused(3, "nowhere.xml: no such file")
    pqsec("validate .").refused(2, "is a directory")
    (tmp_path / "huge.xml").write_bytes(b"<dds>" + b" " * (9 << 20))
    pqsec("validate huge.xml").refused(3, "huge.xml: larger than")
    pqsec("validate").refused(2, "FILE...")


def test_a_name_of_a_file_does_not_reach_the_terminal_raw(pqsec):
    said = pqsec("validate \x1b[2Jclear.xml").err
    assert "\x1b" not in said
    assert r"\u001b[2Jclear.xml" in said


def test_a_document_in_yaml_is_checked_too(pqsec, tmp_path):
    pqsec("permissions new /camera -o camera.yaml").done()
    pqsec("governance new -o open.yaml").done()
    done = pqsec("validate camera.yaml open.yaml").done()
    assert done.out == (
        "camera.yaml: valid permissions document\nopen.yaml: valid governance document\n"
    )
    text = (tmp_path / "open.yaml").read_text()
    (tmp_path / "open.yaml").write_text(text.replace("\ndomains:", "\ndomain:"))
    number = text[: text.index("\ndomains:")].count("\n") + 2
    said = pqsec("validate open.yaml")
    assert said.code == 1
    assert said.out.startswith(f"open.yaml: line {number}: domain: no such key here; did you mean")


@pytest.mark.parametrize(
    ("kind", "new"),
    [
        ("domain", "plan --init f.yaml"),
        ("serve", "serve --config f.yaml --init https://a.example:8443"),
        ("governance", "governance new -o f.yaml"),
        ("permissions", "permissions new /a -o f.yaml"),
    ],
)
def test_each_kind_of_yaml_is_known_by_its_keys(pqsec, tmp_path, keystore, kind, new):
    keystore()
    pqsec(f"-k k {new}").done()
    assert pqsec("validate f.yaml").done().out == f"f.yaml: valid {kind} document\n"
    with (tmp_path / "f.yaml").open("a") as file:
        file.write("unheard_of: 5\n")
    said = pqsec("validate f.yaml")
    assert said.code == 1
    assert re.match("f.yaml: line [0-9]+: unheard_of: no such key here", said.out)


def test_a_problem_of_a_file_that_the_domain_file_names_has_its_place(pqsec, tmp_path):
    (tmp_path / "d.yaml").write_text("roles: {r: {publish: a}}\nparticipants:\n- csv: robots.csv\n")
    (tmp_path / "robots.csv").write_text("name,role\n/a,r\n/a,s\n")
    said = pqsec("validate d.yaml")
    assert (said.code, said.out.partition(" ")[0]) == (1, "robots.csv:")
    pqsec("validate d.yaml --json")


EXTENDED = "<id_range><min>0</min></id_range><tag>RTI_o11y</tag>"


def extended(keystore, tmp_path):
    text = (keystore() / "enclaves/governance.xml").read_text()
    assert "<id>0</id>" in text
    (tmp_path / "its own.xml").write_text(text.replace("<id>0</id>", EXTENDED))
    return text[: text.index("<id>0</id>")].count("\n") + 1


def test_a_document_is_judged_for_the_stacks_that_are_named(pqsec, keystore, tmp_path):
    line = extended(keystore, tmp_path)
    taken = ["validate", "its own.xml", "--target", "connext"]
    assert pqsec(*taken).done().out == "its own.xml: valid governance document\n"
    said = pqsec("validate", "its own.xml", "--target", "connext,fastdds", "--json")
    assert said.code == 1
    [result] = said.json["files"]
    assert (result["valid"], result["kind"]) == (False, "governance")
    assert {each["line"] for each in result["problems"]} == {line}
    [tag] = [each["text"] for each in result["problems"] if "tag" in each["text"]]
    assert "<tag> is not allowed in <domains> (PQS209 [Cyclone DDS; Fast DDS" in tag


def test_a_document_that_one_stack_takes_is_said_to_be_taken_by_it(pqsec, keystore, tmp_path):
    extended(keystore, tmp_path)
    said = pqsec("validate", "its own.xml")
    assert said.code == 1
    assert "RTI Connext takes more than the schema allows" in said.err
    assert "`pqsec validate --target connext 'its own.xml'`" in said.err
    (tmp_path / "broken.xml").write_text((tmp_path / "its own.xml").read_text().replace("tag", "g"))
    assert "note" not in pqsec("validate broken.xml").err


def test_markup_that_a_stack_cannot_read_is_told_for_that_stack(pqsec, keystore, tmp_path):
    text = (keystore() / "enclaves/governance.xml").read_text()
    (tmp_path / "spaced.xml").write_text(text.replace("</domains>", "</domains >"))
    pqsec("validate spaced.xml").done()
    pqsec("validate spaced.xml --target fastdds").done()
    said = pqsec("validate spaced.xml --target cyclonedds")
    assert said.code == 1
    assert "(PQS278 [Cyclone DDS 0.10.2, 11.0.1])" in said.out


@pytest.mark.parametrize("wrong", ["<topic></topic>", "<id_range><max>9</max></id_range>"])
def test_a_valid_document_that_crashes_a_stack_is_said_not_to_be_signed(
    pqsec, keystore, tmp_path, wrong
):
    text = (keystore() / "enclaves/talker/permissions.xml").read_text()
    tag = "id" if "id" in wrong else "topic"
    text = re.sub(f"<{tag}>[^<]*</{tag}>", wrong, text, count=1)
    (tmp_path / "d.xml").write_text(text)
    said = pqsec("validate d.xml").done()
    assert said.out == "d.xml: valid permissions document\n"
    assert "note: d.xml: it cannot be signed: line " in said.err
    assert "crash" in said.err
    assert "note" not in pqsec(f"validate {PERMISSIONS}.xml").done().err


def test_another_file_is_not_valid_for_any_stack(pqsec, tmp_path):
    (tmp_path / "a.txt").write_text("a")
    (tmp_path / "a.xml").write_text("<a/>")
    for file in ("a.txt", "a.xml"):
        assert pqsec(f"validate {file} --target fastdds,connext").code == 1
    assert pqsec("validate --target nodds a.xml").code == 2
