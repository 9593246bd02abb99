"""Just enough DER to take certificates and CMS apart without this project's own code."""

from typing import Self


class Der(bytes):
    """One DER value, header and all."""

    __slots__ = ()

    @property
    def tag(self) -> int:
        return self[0]

    @property
    def content(self) -> bytes:
        return self[_ends(self, 0)[0] :]

    @property
    def parts(self) -> list[Self]:
        """The values inside a constructed one."""
        found, at, content = [], 0, self.content
        while at < len(content):
            end = _ends(content, at)[1]
            found.append(type(self)(content[at:end]))
            at = end
        return found

    @classmethod
    def of(cls, tag: int, content: bytes) -> Self:
        size = len(content)
        if size < 0x80:
            return cls(bytes([tag, size]) + content)
        octets = size.to_bytes((size.bit_length() + 7) // 8, "big")
        return cls(bytes([tag, 0x80 | len(octets)]) + octets + content)


def _ends(data: bytes, at: int) -> tuple[int, int]:
    """Where the header of the value at `at` ends, and where the value does."""
    first = data[at + 1]
    start = at + 2 + (first & 0x7F if first & 0x80 else 0)
    size = int.from_bytes(data[at + 2 : start], "big") if first & 0x80 else first
    return start, start + size
