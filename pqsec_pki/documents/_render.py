"""Writes values as XML with the templates, and strings and times in their XML form."""

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
"""Cyclone DDS counts nanoseconds in 64 bits: it treats a later time as past."""

# XML 1.0, production 2. Compiled only when needed: that takes some milliseconds.
_NOT_XML = "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
# A parser would change these to spaces or line feeds if they were not escaped.
_REFERENCES = {ord("\t"): "&#9;", ord("\n"): "&#10;", ord("\r"): "&#13;"}


def render(kind: Kind, **values: object) -> bytes:
    """The document of that kind with `values` in it, validated against its schema.

    UsageError for a character that XML does not allow, and for a time that no stack understands.
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
        return value  # autoescape handles <, > and &; nothing else needs to be escaped
    if found := re.search(_NOT_XML, value):
        raise UsageError(f"{value!r} has the character {found[0]!r}, which XML cannot carry")
    from markupsafe import Markup, escape  # noqa: PLC0415 - comes and loads with jinja2

    # What escape() returned is safe, and the references are constants.
    return Markup(str(escape(value)).translate(_REFERENCES))  # noqa: S704 - see the line above


def _instant(value: datetime) -> str:
    if value.year > LAST_YEAR:
        raise UsageError(
            f"{value:%Y-%m-%d} is too late: to Cyclone DDS, any time after {LAST_YEAR} is expired"
        )
    return f"{value.replace(tzinfo=None).isoformat()}Z"
