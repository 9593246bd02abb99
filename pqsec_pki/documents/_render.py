"""Values to XML, by the templates; the words of XML for strings and times."""

import re
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING

from pqsec_pki._assets import asset
from pqsec_pki.documents._schema import Kind, validate
from pqsec_pki.errors import UsageError

if TYPE_CHECKING:
    from jinja2 import Environment, Template

LAST_YEAR = 2261
"""Cyclone DDS counts nanoseconds in 64 bits: to it, a later time has passed."""

# XML 1.0, production 2. Compiled when it is needed, which takes some milliseconds.
_NOT_XML = "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
# Written as they are, a parser would make spaces or line feeds of them.
_REFERENCES = {ord("\t"): "&#9;", ord("\n"): "&#10;", ord("\r"): "&#13;"}


def render(kind: Kind, **values: object) -> bytes:
    """The document of that kind with `values` in it, checked against its schema.

    UsageError for a character XML cannot carry and a time no stack would understand.
    """
    document = _template(kind).render(values).encode()
    validate(document)
    return document


@cache
def _template(kind: Kind) -> "Template":
    return _environment().get_template(f"{kind}.xml.j2")


@cache
def _environment() -> "Environment":
    from jinja2 import (  # noqa: PLC0415 - `pqsec --help` must not load jinja2
        Environment,
        FunctionLoader,
        StrictUndefined,
    )

    environment = Environment(
        loader=FunctionLoader(lambda name: asset("templates", name).read_text("utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(text=_text, instant=_instant)
    return environment


def _text(value: str) -> str:
    if value.isprintable():
        return value  # and nothing but <, > and & need care: autoescape has it
    if found := re.search(_NOT_XML, value):
        raise UsageError(f"{value!r} holds the character {found[0]!r}, which XML cannot carry")
    from markupsafe import Markup, escape  # noqa: PLC0415 - comes and loads with jinja2

    # What escape() returned is safe, and the references are constants.
    return Markup(str(escape(value)).translate(_REFERENCES))  # noqa: S704 - see the line above


def _instant(value: datetime) -> str:
    if value.year > LAST_YEAR:
        raise UsageError(
            f"{value:%Y-%m-%d} is too late: Cyclone DDS takes any time after {LAST_YEAR} as expired"
        )
    return f"{value.replace(tzinfo=None).isoformat()}Z"
