"""groups.json: the groups of the domain file, as `pqsec apply` stored them.

They are in the keystore, not read from domain.yaml by each command: so a cron job needs no file,
and `revoke @hall1` means the participants that somebody has seen in a plan, not those of a file
that was edited since. They are not in pqsec.json, which another change may be rewriting.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path

from pqsec_pki._files import exists, read
from pqsec_pki.errors import KeystoreError, TooLargeError, UsageError, other_format
from pqsec_pki.keystore.layout import GROUPS, enclave_name

GROUP_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
"""The syntax of one part of a participant's name: no shell changes it."""
_FORMAT = 1
_LIMIT = 80 << 20
"""Bytes: 1,000,000 names of 64 characters, the most that a domain file may put into groups, each in
quotes on a line."""


def groups_file(groups: Mapping[str, tuple[str, ...]]) -> bytes:
    """The content of groups.json: the names of the members of each group. TooLargeError."""
    content = {"format": _FORMAT, "groups": {key: list(groups[key]) for key in sorted(groups)}}
    data = json.dumps(content, indent=1).encode() + b"\n"
    hint = "put fewer names into groups of the domain file"
    TooLargeError.check("groups.json", len(data), _LIMIT, hint=hint)
    return data


def read_groups(root: Path) -> dict[str, tuple[str, ...]]:
    """The groups of the keystore at `root`; empty if none were stored.

    FileError if the file cannot be read, KeystoreError if it is not such a file.
    """
    path = root / GROUPS
    if not exists(path):
        return {}
    try:
        content = json.loads(read(path, limit=_LIMIT))
        if content["format"] != _FORMAT:
            raise other_format(KeystoreError, content["format"], (_FORMAT,), where=path)
        return {_group(key): tuple(map(_name, names)) for key, names in content["groups"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, UsageError) as error:
        raise KeystoreError(
            f"not groups of pqsec ({error})", where=path, hint="`pqsec apply` writes it again"
        ) from error


def _group(key: str) -> str:
    if not GROUP_NAME.fullmatch(key):
        raise ValueError(f"{key[:64]!r} cannot be a group's name")
    return key


def _name(text: str) -> str:
    if enclave_name(text) != text:
        raise ValueError(f"{text[:64]!r} is not a participant's name")
    return text
