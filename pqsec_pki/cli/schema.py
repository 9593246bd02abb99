"""pqsec schema: the JSON Schemas of the files that people write."""

from pathlib import Path

import click

from pqsec_pki._assets import asset
from pqsec_pki.cli import _help, _settings
from pqsec_pki.cli._policy import output_options, put

KINDS = ("domain", "governance", "permissions", "serve", "check", "plugin")


@_help.command(
    examples={
        "Write the schema of domain.yaml for an editor": (
            "pqsec schema domain -o domain.schema.json"
        ),
        "Write that of .pqsec-check.yaml": "pqsec schema check -o .pqsec-check.schema.json",
    },
    exit_codes={
        0: "the schema is written",
        3: "the file exists, or cannot be written",
    },
)
@click.argument("kind", type=click.Choice(KINDS), metavar="KIND")
@output_options
@_settings.command_options
def schema(kind: str, output: Path | None, *, force: bool) -> None:
    """Write the JSON Schema of a file, for editors.

    KIND is domain (domain.yaml), governance or permissions (in YAML), serve (serve.yaml), check
    (.pqsec-check.yaml) or plugin (pqsec.toml). An editor with a language server completes keys by
    it, shows their meaning, and marks mistakes.
    """
    put(asset("schemas", f"{kind}.schema.json").read_bytes(), output, force=force)
