"""The plain tree of a document: everything that values leave out."""

import pytest

from pqsec_pki.documents import read_tree
from pqsec_pki.documents.tree import MAX_ATTRIBUTES
from pqsec_pki.errors import InvalidDocumentError

XML = b"""<?xml version="1.0"?>
<!-- before --><dds a="1">
  <b>x<!-- in -->y <c/> z</b>
  <!-- between -->
  <d/><!-- after -->
</dds><!-- end -->"""


def test_elements_have_their_text_line_attributes_and_children():
    tree = read_tree(XML)
    assert [node.tag for node in tree.root.walk()] == ["dds", "b", "c", "d"]
    b = tree.root.child("b")
    assert (b.text, b.value, b.line) == ("xy  z", "xy  z", 3)
    assert tree.root.attributes == (("a", "1"),)
    assert [node.line for node in tree.root.all("d", "x")] == [5]
    assert tree.root.child("x") is None


@pytest.mark.parametrize(
    ("codec", "mark"), [("utf-8", False), ("utf-8-sig", True), ("utf-16", True)]
)
def test_a_byte_order_mark_is_seen(codec, mark):
    tree = read_tree("<dds><!-- é --></dds>".encode(codec))
    assert tree.byte_order_mark is mark
    assert tree.encoding.startswith(codec[:5].upper())


@pytest.mark.parametrize("xml", [b"", b"<a>", b"<!DOCTYPE a><a/>"])
def test_what_is_not_read_as_a_document_is_not_read_as_a_tree(xml):
    with pytest.raises(InvalidDocumentError):
        read_tree(xml)


def test_more_attributes_than_anyone_writes_are_refused():
    many = " ".join(f"a{n}=''" for n in range(MAX_ATTRIBUTES + 1))
    with pytest.raises(InvalidDocumentError, match="attributes"):
        read_tree(f"<a><b {many}/></a>".encode())
