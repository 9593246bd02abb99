"""pqsec governance: write and convert governance documents in YAML."""

from pathlib import Path

import click

from pqsec_pki.cli import _help, _policy, _printing, _settings
from pqsec_pki.cli._document_commands import DocumentCommands
from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    Governance,
    governance_from_yaml,
    governance_to_yaml,
    new_governance,
    preset_named,
)


@_help.group()
@_settings.command_options
def governance() -> None:
    """Write and convert governance documents in YAML."""


@governance.command(
    examples={
        "Write a governance for domains 0 to 3": "pqsec governance new --domain 0-3 -o new.yaml",
        "Print one from another preset": "pqsec governance new --preset authenticated",
    },
    exit_codes={
        0: "the document is written",
        3: "the file exists, or cannot be written",
    },
)
@click.option(
    "--preset",
    type=click.Choice([preset.name for preset in PRESETS]),
    default=PRESETS[0].name,
    show_default=True,
    help="Start from this preset; `pqsec governance presets` explains them.",
)
@click.option(
    "--domain",
    "domains",
    default="0",
    show_default=True,
    help="Govern these DDS domains: 0, or 0-3, or 0,5.",
)
@_policy.output_options
@_settings.command_options
def new(preset: str, domains: str, output: Path | None, *, force: bool) -> None:
    """Write a commented governance in YAML, to edit.

    Every setting of the preset is listed and explained.
    """
    document = new_governance(preset_named(preset), DomainSet.parse(domains))
    _policy.put(document, output, force=force)


@governance.command(
    examples={
        "Compare the presets": "pqsec governance presets",
    },
    exit_codes={
        0: "the presets are shown",
        3: "the list cannot be printed",
    },
)
@_settings.command_options
def presets() -> None:
    """Show what each preset protects, and what it costs."""
    keys = ("name", "summary", "protects", "costs")
    lines = []
    for preset in PRESETS:
        lines += [f"{preset.name}: {preset.summary}"]
        lines += click.wrap_text(f"Protects: {preset.protects}", 88, "  ", "  ").splitlines()
        lines += click.wrap_text(f"Costs: {preset.costs}", 88, "  ", "  ").splitlines()
        lines += [""]
    presets = [{key: getattr(preset, key) for key in keys} for preset in PRESETS]
    _printing.emit({"presets": presets}, lines[:-1])


def _warn(value: Governance) -> None:
    for rule in value.domain_rules:
        if rule.topic_rules[-1].topic_expression != "*":
            _printing.note(
                f"{rule.domains.words}: the last topic rule is not for '*': topics that no rule"
                " names cannot be used"
            )


DocumentCommands(
    from_yaml=governance_from_yaml,
    to_yaml=governance_to_yaml,
    from_xml=Governance.from_xml,
    warn=_warn,
).add_to(governance)
