"""pqsec profiles, pqsec algorithms: list what can be chosen."""

from collections.abc import Iterator, Mapping

from pqsec_pki.algorithms import (
    DEFAULT_PROFILE,
    KEY_AGREEMENTS,
    PROFILES,
    SIGNATURES,
    Profile,
)
from pqsec_pki.cli import _formats, _help, _printing, _settings

_PROFILE_COLUMNS = (
    *("profile", "identity_key", "alternative_key", "key_agreement", "level", "runs_in"),
    *("promises", "default", "summary"),
)
_COLUMNS = (
    *("kind", "name", "aliases", "family", "level", "public_key_bytes", "signature_bytes"),
    *("dh1_bytes", "dh2_bytes", "runs_in", "standard", "experimental", "package"),
)


@_help.command(
    examples={
        "List the profiles": "pqsec profiles",
        "Print them for a program": "pqsec profiles --json",
    },
    exit_codes={
        0: "the profiles are listed",
        3: "the list cannot be printed",
    },
)
@_formats.option()
@_settings.command_options
def profiles(form: str) -> None:
    """List the profiles: algorithms that are used together."""
    lines = [line for profile in PROFILES for line in (*_lines(profile), "")]
    _formats.emit(
        form,
        {"profiles": PROFILES},
        lines[:-1],
        columns=_PROFILE_COLUMNS,
        items=[profile.to_json() for profile in PROFILES],
    )


def _lines(profile: Profile) -> Iterator[str]:
    second = profile.alternative_key
    keys = profile.identity_key.name + (f" and {second.name}" if second else "")
    yield f"{profile.name}{' (default)' if profile is DEFAULT_PROFILE else ''}: {profile.summary}"
    yield f"  keys and documents    {keys}"
    yield f"  key agreement         {profile.key_agreement.name}"
    yield f"  NIST level            {profile.level or '0: broken by a quantum computer'}"
    yield f"  runs in               {profile.runs_in}"
    for promise in profile.promises:
        yield f"  promises              {promise.text}"


@_help.command(
    examples={
        "List the algorithms": "pqsec algorithms",
        "Print them for a program": "pqsec algorithms --json",
    },
    exit_codes={
        0: "the algorithms are listed",
        3: "the list cannot be printed",
    },
)
@_formats.option()
@_settings.command_options
def algorithms(form: str) -> None:
    """List the algorithms, their sizes and which stacks run them.

    LEVEL is the NIST security category; 0 is broken by a quantum computer. Sizes are
    maxima in bytes. Experimental algorithms, and those of other packages,
    are in no profile, and are used only if named.
    """
    _formats.chosen(form)
    errors = (*SIGNATURES.load_foreign(), *KEY_AGREEMENTS.load_foreign())
    for error in dict.fromkeys(map(str, errors)):
        _printing.note(error)
    signatures, agreements = SIGNATURES.to_json(), KEY_AGREEMENTS.to_json()
    _formats.emit(
        form,
        {"signatures": signatures, "key_agreements": agreements},
        [
            *_printing.table(
                ("SIGNATURE", "FAMILY", "LEVEL", "KEY", "SIG", "IDENTITIES RUN IN", "STANDARD"),
                [_cells(row, "public_key_bytes", "signature_bytes") for row in signatures],
            ),
            "",
            *_printing.table(
                ("KEY AGREEMENT", "FAMILY", "LEVEL", "DH1", "DH2", "RUNS IN", "STANDARD"),
                [_cells(row, "dh1_bytes", "dh2_bytes") for row in agreements],
            ),
        ],
        columns=_COLUMNS,
        items=[
            *(
                {"kind": "signature", "runs_in": row["identities_run_in"]} | row
                for row in signatures
            ),
            *({"kind": "key agreement"} | row for row in agreements),
        ],
    )


def _cells(row: Mapping[str, object], *sizes: str) -> tuple[str, ...]:
    runs_in = str(row.get("identities_run_in") or row.get("runs_in"))
    numbers = [str(row[size]) for size in sizes]
    origin = "experimental" if row["experimental"] else row["package"]
    name = f"{row['name']} ({origin})" if origin else str(row["name"])
    names = (name, str(row["family"]), str(row["level"]))
    return (*names, *numbers, runs_in, str(row["standard"]))
