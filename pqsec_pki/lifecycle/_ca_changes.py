"""Creates CAs, and changes which identity CAs are trusted during an overlap.

docs/explanation/adr/0010-two-identity-cas-in-one-file.md has the reasons for the overlap.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime

from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Overlap,
    Phase,
    SetChange,
    certificate_entry,
    check_pair,
    layout,
    load_ca_key,
    trust_entry,
    trust_file,
)
from pqsec_pki.lifecycle.rollover import RolloverPlan
from pqsec_pki.tokens import Pin, key_file

Keys = Mapping[str, PrivateKey] | None
"""Keys of new CAs that are there already, by the names of their files."""


def new_cas(plan: RolloverPlan, now: datetime, keys: Keys = None) -> Authorities:
    """Create the CAs of the plan's generation, named by its terms or after the old CA."""
    terms = plan.terms
    name = terms.name if terms.name is not None else _name(plan.issuing, plan.generation)
    try:
        made = Authorities.create(terms.profile, name, now=now, validity=terms.validity, keys=keys)
        return replace(made, set_name=plan.set_name)
    except UsageError as error:
        if terms.name is None and error.hint is None:
            error.hint = "name the new CAs with --name"
        raise


def _name(old: Certificate, number: int) -> str:
    """The start of the new CAs' names: Lab Identity CA -> Lab G2."""
    base = re.sub(r"(^| )G[0-9]+$", "", name_start(old))
    return f"{base} G{number}".strip()


def refuse_known(authorities: Authorities, new: Authorities) -> None:
    """UsageError if a new CA has the name or a key of one of another set of credentials."""
    cas = [ca for each in authorities.sets if each.set_name != new.set_name for ca in each.all]
    names = {each.certificate.subject_der for each in cas}
    keys = {each.certificate.spki for each in cas}
    for ca in new.all:
        if ca.certificate.subject_der in names:  # issuers are found by name
            raise UsageError(
                f"{ca.certificate.subject_name} is the name of another CA of this keystore",
                hint="choose another --name",
            )
        if ca.certificate.spki in keys:
            raise UsageError(
                f"{ca.certificate.subject_name} would have the key of another CA of this keystore"
                " (CVE-2023-24010)",
                hint="name another key for it",
            )


def name_start(ca: Certificate) -> str:
    """The start of an identity CA's name: that of Lab Identity CA is Lab."""
    found = re.search(r"(?:^|,)CN=([A-Za-z0-9_./ -]+)", ca.subject_name)
    return (found[1] if found else "").removesuffix("Identity CA").strip()


def next_identity_ca(
    keystore: Keystore,
    certificate: Certificate,
    passphrase: bytes | None,
    pin: Pin | None = None,
) -> Authority:
    """The CA with that certificate, which issues next; PassphraseError for a wrong passphrase."""
    private, second = keystore.folder / layout.PRIVATE, certificate.alternative_key
    authority = Authority(
        certificate,
        load_ca_key(private / layout.NEXT_KEY, passphrase, pin),
        load_ca_key(private / layout.NEXT_ALT_KEY, passphrase, pin) if second else None,
    )
    check_pair(authority)
    return authority


# The steps of an overlap that reissue no participant


def begin_overlap(  # noqa: PLR0913 -- what a rollover has, by name
    keystore: Keystore,
    plan: RolloverPlan,
    part: SetChange,
    *,
    kept: Authorities | None,
    passphrase: bytes | None,
    now: datetime,
    keys: Keys = None,
) -> Overlap:
    """Stage a CA that all trust beside the old one; UsageError if it has the old CA's name."""
    made = new_cas(plan, now, keys)
    if kept:
        refuse_known(kept, made)
    new = made.identity
    certificate = new.certificate
    if certificate.subject_der == plan.issuing.subject_der:
        raise UsageError(  # issuers are found by name
            f"{certificate.subject_name} is the name of the old identity CA",
            hint="choose another --name",
        )
    private = part.folder(layout.PRIVATE, private=True)
    for name, key in ((layout.NEXT_KEY, new.key), (layout.NEXT_ALT_KEY, new.alternative_key)):
        if key:
            private.private(name, key_file(key, passphrase))
    if plan.drop_list:
        _drop_list(keystore, part)
    _link_all(keystore, part)
    overlap = Overlap(Phase.BEGUN, plan.issuing, certificate)
    part.record(certificate_entry("identity-ca", certificate.subject_name, certificate, now))
    _trust(part, overlap.issuing, overlap.other)
    part.record(trust_entry(overlap, now))
    return overlap


def finish_overlap(overlap: Overlap, part: SetChange, now: datetime) -> None:
    """Stage the end of the trust in the old CA."""
    _trust(part, overlap.issuing)
    part.record(trust_entry(overlap, now, end="finished"))


def cancel_overlap(overlap: Overlap, part: SetChange, now: datetime) -> None:
    """Stage the end of the trust in the new CA; its key is overwritten with zeros."""
    _trust(part, overlap.issuing)
    part.record(trust_entry(overlap, now, end="cancelled"))
    for key in (layout.NEXT_KEY, layout.NEXT_ALT_KEY):
        part.shred(f"{layout.PRIVATE}/{key}")
        part.remove(f"{layout.PRIVATE}/{key}")


def _trust(part: SetChange, *authorities: Certificate) -> None:
    """Stage the file of trusted identity CAs; the first one issues."""
    public = part.folder(layout.PUBLIC, private=False)
    public.public(layout.IDENTITY_CA, trust_file(authorities))


def _link_all(keystore: Keystore, part: SetChange) -> None:
    """Link to that file in enclaves that have their own copy, as adopted ones may."""
    shared = {layout.IDENTITY_CA: layout.CA_TARGETS[layout.IDENTITY_CA]}
    for name in keystore.names():
        for link, target in layout.missing_links(keystore.folder, name, shared).items():
            part.folder(layout.enclave_folder(name), private=False).link(link, target)


def _drop_list(keystore: Keystore, part: SetChange) -> None:
    """Remove the list: stacks with one CA's list refuse certificates of the other CA."""
    part.remove(f"{layout.PUBLIC}/{layout.CA_LIST}")
    for name in keystore.names():
        part.remove(f"{layout.enclave_folder(name)}/{layout.LIST}")
