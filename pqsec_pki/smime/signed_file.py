"""A signed file that is parsed once, for those who ask it several questions."""

from functools import cached_property

from pqsec_pki._asn1 import SignedData
from pqsec_pki.smime import _cms, _reading


class SignedFile:
    """An S/MIME file. Each part is parsed when it is first needed; nothing is verified.

    Its attributes raise MalformedError or AmbiguousError, as `document_in` does.
    """

    def __init__(self, message: bytes) -> None:
        self.message = message

    @classmethod
    def of(cls, message: "bytes | SignedFile") -> "SignedFile":
        """The file, which may have been parsed before."""
        return message if isinstance(message, SignedFile) else cls(message)

    @cached_property
    def reading(self) -> _reading.ParsedMessage:
        """Its parts, the same for all readers."""
        return _reading.read(self.message)

    @property
    def document(self) -> bytes:
        """Its document, not verified."""
        return self.reading.document

    @property
    def lines_before(self) -> int:
        """Number of its lines before the document."""
        return self.reading.lines_before

    @cached_property
    def cms(self) -> SignedData:
        """Its CMS structure."""
        return _cms.parse(self.reading.cms)
