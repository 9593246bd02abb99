"""The value of `--as`: a stack that interprets policies, or a version of it."""

import click

from pqsec_pki.access import NAMES, interpretations_named
from pqsec_pki.errors import UsageError


class StackVersion(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """The names of `pqsec_pki.access.interpretations_named`, also such as cyclonedds@11.0.1."""

    def __init__(self) -> None:
        super().__init__(NAMES)

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The value; BadParameter if no row is for it."""
        try:
            interpretations_named(value)
        except UsageError:
            self.fail(f"{value!r} is not one of {', '.join(map(repr, self.choices))}.", param, ctx)
        return value
