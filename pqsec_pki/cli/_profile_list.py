"""A list of profiles on the command line."""

import click

from pqsec_pki.algorithms import PROFILES


class ProfileList(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """Profiles with commas between them: one for each set of credentials."""

    name = "profiles"

    def __init__(self) -> None:
        super().__init__([profile.name for profile in PROFILES], case_sensitive=False)

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """The names. Raises click's error for an unknown one."""
        if isinstance(value, tuple):
            return value
        one = super().convert
        return tuple(one(each, param, ctx) for each in str(value).split(","))
