"""Whether what names its issuer names a certain certificate (RFC 5280 4.2.1.1, 5.2.1)."""

from cryptography import x509

from pqsec_pki.certificates._rdns import same_name
from pqsec_pki.certificates.certificate import Certificate


def names_another(extensions: x509.Extensions, issuer: Certificate) -> bool:
    """Whether the authorityKeyIdentifier is of another certificate than `issuer`, as for OpenSSL.

    By key, serial number or issuer's name, as far as it has them; critical or not.
    """
    try:
        found = extensions.get_extension_for_class(x509.AuthorityKeyIdentifier).value
    except x509.ExtensionNotFound:
        return False
    own, named = issuer.subject_key_identifier, found.key_identifier
    serial = found.authority_cert_serial_number
    names = found.authority_cert_issuer or ()
    name = next((each for each in names if isinstance(each, x509.DirectoryName)), None)
    return (
        (own is not None and named is not None and own != named)
        or (serial is not None and serial != issuer.serial_number)
        or (name is not None and not same_name(name.value.public_bytes(), issuer.issuer_der))
    )
