"""`approvals` of a domain file: how many people, with which keys, must approve what."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.algorithms import PublicKey, pem, public_key_from_pem
from pqsec_pki.approvals import ApprovalPolicy, Covered
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    all_of,
    build,
    chosen,
    fields,
    number,
    one_or_more,
    refused,
    table,
    text,
)
from pqsec_pki.errors import PqsecError

_EVERY = "all"
_KINDS = (*(Covered.REVOKE, Covered.ROTATE, Covered.GROW), _EVERY)
_DEFAULT = _KINDS[:3]
_BEGIN = "-----BEGIN"
_MAX_KEY = 64 << 10
"""Bytes; the largest public keys have 5 kB in PEM."""


@dataclass(frozen=True, slots=True)
class ApprovalsItem:
    """`approvals` as written; keys that are in files are not read yet."""

    item: Item
    required: int
    covers: tuple[str, ...]
    keys: Mapping[str, Item]

    def read(self, folder: Path) -> ApprovalPolicy:
        """The policy; files with keys are in `folder`. InvalidDocumentError with all mistakes."""
        found = all_of(partial(_key, item, folder) for item in self.keys.values())
        kinds = [*Covered] if _EVERY in self.covers else [Covered(each) for each in self.covers]
        return build(
            self.item,
            ApprovalPolicy.of,
            required=self.required,
            covers=kinds,
            approvers=dict(zip(self.keys, found, strict=True)),
        )


def approvals_in(item: Item) -> ApprovalsItem:
    """Read `approvals`; InvalidDocumentError with the lines at fault."""
    readers: Readers = {
        "required": number,
        "of": _keys,
        "for": partial(one_or_more, reader=partial(chosen, names=_KINDS)),
    }
    found = fields(item, readers, required=("required", "of"))
    return ApprovalsItem(item, found["required"], found.get("for", _DEFAULT), found["of"])


def approvals_as_yaml(policy: ApprovalPolicy) -> dict[str, object]:
    """The value that is read as this policy."""
    keys = {name: pem("PUBLIC KEY", key.spki).decode() for name, key in policy.approvers.items()}
    kinds = [each for each in _KINDS if each in policy.covers]
    return {
        "required": policy.required,
        "for": _EVERY if Covered.OTHER in policy.covers else [str(each) for each in kinds],
        "of": keys,
    }


def _keys(item: Item) -> dict[str, Item]:
    return {text(key): value for key, value in table(item).entries.values()}


def _key(item: Item, folder: Path) -> PublicKey:
    """The key in a PEM text, or in the file with that name."""
    given = text(item)
    is_pem = given.lstrip().startswith(_BEGIN)
    where = "the key" if is_pem else str(folder / given)
    try:
        if is_pem:
            return public_key_from_pem(given.encode())
        return public_key_from_pem(read(folder / given, limit=_MAX_KEY), where)
    except PqsecError as error:
        message = f"{where}: {error.words_at(where)}"
        raise refused(item, f"{message}; {error.hint}" if error.hint else message) from None
