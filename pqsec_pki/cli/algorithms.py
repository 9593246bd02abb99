"""pqsec profiles, pqsec algorithms: what there is to choose from."""

from collections.abc import Mapping

import click

from pqsec_pki.algorithms import DEFAULT_PROFILE, KEY_AGREEMENTS, PROFILES, SIGNATURES
from pqsec_pki.cli import _common


@click.command()
@_common.command_options
def profiles() -> None:
    """List the profiles: algorithms that are used together."""
    value = [
        profile.to_names()
        | {
            "summary": profile.summary,
            "promises": [promise.text for promise in profile.promises],
            "level": profile.level,
            "runs_in_stock_stacks": profile.runs_in_stock,
            "runs_in": profile.runs_in,
            "default": profile is DEFAULT_PROFILE,
        }
        for profile in PROFILES
    ]
    lines: list[str] = []
    for profile in PROFILES:
        default = " (default)" if profile is DEFAULT_PROFILE else ""
        second = profile.alternative_key
        keys = profile.identity_key.name + (f" and {second.name}" if second else "")
        lines += [
            f"{profile.name}{default}: {profile.summary}",
            f"  keys and documents    {keys}",
            f"  key agreement         {profile.key_agreement.name}",
            f"  NIST level            {profile.level or '0: broken by a quantum computer'}",
            f"  runs in               {profile.runs_in}",
            *(f"  promises              {promise.text}" for promise in profile.promises),
            "",
        ]
    _common.emit(value, lines[:-1])


@click.command()
@_common.command_options
def algorithms() -> None:
    """List the algorithms, their sizes and which stacks run them.

    Level is NIST's security category; 0 is broken by a quantum computer. Sizes are in
    bytes, at most.
    """
    signatures = [
        {
            "name": row.name,
            "aliases": list(row.aliases),
            "family": row.family.value,
            "level": row.level,
            "public_key_bytes": row.public_key_size,
            "signature_bytes": row.signature_size,
            "standard": row.standard,
            "identities_run_in": row.runs_in,
        }
        for row in SIGNATURES
    ]
    agreements = [
        {
            "name": row.name,
            "aliases": list(row.aliases),
            "family": row.family.value,
            "level": row.level,
            "dh1_bytes": row.public_size,
            "dh2_bytes": row.ciphertext_size,
            "standard": row.standard,
            "runs_in": row.runs_in,
        }
        for row in KEY_AGREEMENTS
    ]
    _common.emit(
        {"signatures": signatures, "key_agreements": agreements},
        [
            *_common.table(
                ("SIGNATURE", "FAMILY", "LEVEL", "KEY", "SIG", "IDENTITIES RUN IN", "STANDARD"),
                [_cells(row, "public_key_bytes", "signature_bytes") for row in signatures],
            ),
            "",
            *_common.table(
                ("KEY AGREEMENT", "FAMILY", "LEVEL", "DH1", "DH2", "RUNS IN", "STANDARD"),
                [_cells(row, "dh1_bytes", "dh2_bytes") for row in agreements],
            ),
        ],
    )


def _cells(row: Mapping[str, object], *sizes: str) -> tuple[str, ...]:
    runs_in = str(row.get("identities_run_in") or row.get("runs_in"))
    numbers = [str(row[size]) for size in sizes]
    names = (str(row["name"]), str(row["family"]), str(row["level"]))
    return (*names, *numbers, runs_in, str(row["standard"]))
