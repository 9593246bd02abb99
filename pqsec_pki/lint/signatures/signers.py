"""Rules about who signed a document, and whether the signature is valid."""

from collections.abc import Iterator

from pqsec_pki._times import said
from pqsec_pki.algorithms import Family as Strength
from pqsec_pki.certificates import BACKDATE, Certificate, same_name
from pqsec_pki.lint._keys import family_of
from pqsec_pki.lint.document import same_lines
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.signed import DocumentAndSigners, broken_digests, embedded, is_by
from pqsec_pki.lint.subjects import Inventory
from pqsec_pki.stacks import Stack


@lint_rule(
    "PQS336", Severity.ERROR, "the signer's certificate is not in the document",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 search for it only in the document.",
    fix="Sign without -nocerts, or run `pqsec sign-permissions --embed-certificate`.",
    stacks={Stack.CYCLONEDDS: "0.10.2, 0.10.5", Stack.FASTDDS: "2.9.1"},
    rows=("`NoCerts`",), measured="Cyclone DDS 0.10.2, 0.10.5; Fast DDS 2.9.1",
    bad=r"""
        $ cp k/public/permissions_ca.cert.pem .
        $ openssl smime -sign -text -nocerts -in k/enclaves/talker/permissions.xml \
          -signer permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def without_certificate(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        listed = each.file.listed
        if listed and not listed.certificates and _is_for_stock(each):
            words = "lacks the signer's certificate: Cyclone DDS 0.10 and Fast DDS 2.9"
            yield Violation(f"{words} refuse it", path=each.file.path)


@lint_rule(
    "PQS338", Severity.WARNING, "pqsec cannot check the signature",
    why="Stacks may accept it: OpenSSL supports more keys and digests than pqsec, and signatures"
    " without signed attributes. pqsec peers refuse it. This check cannot tell whether the document"
    " was changed.",
    fix="Sign it without -noattr, with SHA-256 and an ecdsa-p256 or RSA key, or with pqsec.",
    measured="`NoAttributes` is taken by " + SIX_STACKS,
    bad=r"""
        $ cp k/public/permissions_ca.cert.pem .
        $ openssl smime -sign -text -noattr -in k/enclaves/talker/permissions.xml \
          -signer permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def cannot_be_checked(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        reason = each.uncheckable
        if reason and not broken_digests(each.file):
            yield Violation(f"the signature was not checked: it has {reason}", path=each.file.path)


@lint_rule(
    "PQS340", Severity.ERROR, "the permissions CA did not sign the document",
    why="Cyclone DDS 11, Fast DDS 3 and OpenDDS refuse a document that another certificate below"
    " the CA signed. On stacks that accept it, any such certificate can give itself permissions.",
    fix="Sign with the permissions CA itself.",
    rows=("document signed by leaf or intermediate under the CA, CA file = root",),
    measured=SIX_STACKS,
    bad=r"""
        $ cp k/public/permissions_ca.cert.pem .
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/identity_ca.cert.pem -inkey k/private/identity_ca.key.pem \
          -out permissions.p7s
    """,
    good=r"""
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out permissions.p7s
    """,
)  # fmt: skip
def of_another_signer(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        signers = each.file.signers
        if signers and not any(is_by(signer, each.ca) for signer in signers):
            yield Violation(_by_another(each), path=each.file.path)


@lint_rule(
    "PQS341", Severity.ERROR, "the signature is not valid",
    why="The document was changed after signing, or another key signed it in the CA's name. Every"
    " stack refuses it.",
    fix="Find out who changed the document, and sign it again.",
    rows=("tampered",), measured=SIX_STACKS,
    bad="""
        $ cp k/public/permissions_ca.cert.pem .
        $ sed s/chatter/secret/ k/enclaves/talker/permissions.p7s > permissions.p7s
    """,
    good="$ cp k/enclaves/talker/permissions.p7s .",
)  # fmt: skip
def invalid_signature(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        for problem in each.plain_problems:
            yield Violation(problem, path=each.file.path)


@lint_rule(
    "PQS342", Severity.WARNING, "the XML file differs from the signed document",
    why="Stacks read the signed document. A reader of the XML file next to it is misled.",
    fix="Sign the XML file again, or remove it.",
    bad="$ sed -i s/chatter/secret/ k/enclaves/talker/permissions.xml",
    good="$ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml",
)  # fmt: skip
def differs_from_xml(inventory: Inventory) -> Iterator[Violation]:
    files = {file.path: file for file in inventory.files}
    for file in (each for each in inventory.files if each.is_signed):
        plain = files.get(file.path.with_suffix(".xml"))
        text = file.signed_text[0] if plain else None
        if plain and text is not None and not same_lines(text, plain.data):
            yield Violation(f"differs from {plain.path.name}", path=file.path)


@lint_rule(
    "PQS348", Severity.WARNING, "a keystore's document was signed in the future",
    why="A signing time that is more than a day ahead shows a wrong clock: of the CA then, or of"
    " this machine now. Other things of that time end too late, or are not valid yet. Robots take"
    " newer documents all the same: these have larger numbers.",
    fix="Set the clock. If it is right, sign again: `pqsec sign-governance` and `pqsec renew`.",
    bad="""
        $ cp k/public/permissions_ca.cert.pem k/enclaves/governance.p7s .
        # 2 days earlier
    """,
    good="# 20 hours earlier",
)  # fmt: skip
def signed_in_the_future(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        ours = (signer for signer in each.file.signers if is_by(signer, each.ca) and signer.number)
        at = [signer.signed_at for signer in ours]
        late = max(filter(None, at), default=inventory.now)
        if late > inventory.now + BACKDATE:
            yield Violation(f"was signed {said(late)}, which is in the future", path=each.file.path)


def _is_for_stock(document: DocumentAndSigners) -> bool:
    """Whether stock stacks can read the document: all keys are classical."""
    certificates = (document.ca, *(each for _, each in document.others))
    return all(family_of(each) is Strength.CLASSICAL for each in certificates)


def _by_another(document: DocumentAndSigners) -> str:
    """A message: who signed instead of the permissions CA, if document and enclave show it."""
    name, signers = document.ca.subject_name, document.file.signers
    if who := _known(document):
        return f"signed by {who}, not by {name}"
    issuers = (each.issuer_der for each in signers)
    if not any(each and same_name(each, document.ca.subject_der) for each in issuers):
        return f"signed by {signers[0].issuer or 'another key'}, not by {name}"
    certificate = next(embedded(document.file), None)
    if certificate is None:
        words = f"signed with a certificate whose issuer is {name}"
        return f"{words}: another CA with that name, or a certificate that the CA issued"
    if certificate.is_self_issued:
        return f"signed by another CA with the same name {name}, not by this one"
    return f"signed by a certificate that {name} issued, not by {name}"


def _known(document: DocumentAndSigners) -> str | None:
    """The signer with its role, if it is one of the enclave's certificates."""
    signers = document.file.signers
    known: list[tuple[str, Certificate]] = [
        (f"{role}, {certificate.subject_name}", certificate)
        for role, certificate in document.others
    ]
    named = (who for who, each in known for one in signers if is_by(one, each))
    return next(named, None)
