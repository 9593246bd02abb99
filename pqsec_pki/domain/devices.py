"""Which device a participant is: a line of the inventory in a domain file.

    acme:serialNumber=SN-0017

It names a factory of `serve.yaml`, and what the factory's certificate of that device says.
"""

import re
from typing import Self

from cryptography.x509.oid import NameOID

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import UsageError, shown

FACTORY = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
"""The name of a factory."""
_DEVICE = re.compile(rf"({FACTORY.pattern}):(serialNumber|subject|sha256)=(\S(?:.*\S)?)")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Device:
    """A device of a factory, by the subject's serialNumber, the whole subject, or the SHA-256."""

    factory: str
    by: str
    value: str

    @classmethod
    def of(cls, text: str) -> Self:
        """The device in a domain file; UsageError for another text."""
        found = _DEVICE.fullmatch(text)
        if not found:
            raise UsageError(
                f"'{shown(text)}' names no device",
                hint="write FACTORY:serialNumber=VALUE, FACTORY:subject=CN=x,O=y or"
                " FACTORY:sha256=HEX",
            )
        if found[2] == "sha256" and not _SHA256.fullmatch(found[3]):
            raise UsageError(f"'{shown(found[3])}' is not a SHA-256: 64 digits of 0-9 and a-f")
        return cls(found[1], found[2], found[3])

    def has(self, certificate: Certificate) -> bool:
        """Whether the certificate, which is verified elsewhere, is of this device."""
        if self.by == "sha256":
            return certificate.fingerprint == self.value
        if self.by == "subject":
            return certificate.subject_name == self.value
        numbers = certificate.subject.get_attributes_for_oid(NameOID.SERIAL_NUMBER)
        return [each.value for each in numbers] == [self.value]

    def __str__(self) -> str:
        return f"{self.factory}:{self.by}={self.value}"
