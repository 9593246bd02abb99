"""Renders configuration texts from the templates in templates/vendors."""

import os
from functools import cache
from typing import TYPE_CHECKING

from pqsec_pki._assets import asset
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.vendors.exports import UNFIT

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **values: object) -> str:
    """The text of `template` with `values`; in XML they are escaped.

    UsageError for a value that a configuration cannot contain.
    """
    return _environment().get_template(f"{template}.j2").render(values)


@cache
def _environment() -> "Environment":
    from jinja2 import (  # noqa: PLC0415 -- `pqsec --help` must not load it
        Environment,
        FunctionLoader,
        StrictUndefined,
        select_autoescape,
    )

    environment = Environment(
        loader=FunctionLoader(lambda name: asset("templates", "vendors", name).read_text("utf-8")),
        autoescape=select_autoescape(["xml.j2"]),
        finalize=_carried,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["literal"] = _literal
    return environment


def _carried(value: object) -> object:
    """`value`, if a configuration can contain it. It is not shown: it may be a passphrase."""
    if found := UNFIT.search(str(value)):
        raise UsageError(
            f"a path or the passphrase contains {shown(found[0])}, and a configuration cannot",
            hint="put the keystore elsewhere, or choose another passphrase",
        )
    return value


def _literal(text: str) -> str:
    """`text` as a string literal of C++: bytes outside printable ASCII in octal."""
    plain = set(range(0x20, 0x7F)) - set(b'"\\?')  # ?, because of trigraphs
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in os.fsencode(text)) + '"'
