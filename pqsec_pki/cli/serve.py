"""pqsec serve: let robots enrol and renew over a network."""

from pathlib import Path

import click

from pqsec_pki._libraries import needs_libraries
from pqsec_pki._places import trusted_files
from pqsec_pki.cli import _help, _network, _output, _passphrases, _printing, _progress, _settings
from pqsec_pki.server import ServerSettings, begin_server, read_settings

config_option = click.option(
    "--config",
    "file",
    default=Path("serve.yaml"),
    show_default=True,
    type=_settings.FILE,
    metavar="FILE",
    help="Use this configuration of the server.",
)


def trusted_settings(file: Path) -> ServerSettings:
    """The configuration of the server; FileError if another user could change it."""
    with trusted_files("what the server does"):
        return read_settings(file)


@_help.command(
    examples={
        "Write a configuration, and keys for TLS": (
            "pqsec serve --init https://enrol.example:8443"
        ),
        "Run the server": "pqsec serve",
        "Run its signer, which has the CA keys, as a service of its own": (
            "pqsec serve --config serve.yaml --part signer"
        ),
    },
    exit_codes={
        0: "stopped by SIGTERM or Ctrl-C; or with --init the files are written",
        1: "FILE or the domain file is not valid",
        3: "a file cannot be read, an address is in use, or a process ended by itself",
    },
)
@config_option
@click.option(
    "--init",
    "url",
    metavar="URL",
    help="Write FILE for a server at this URL, with TLS keys and certificates beside it.",
)
@click.option(
    "--part",
    type=click.Choice(["both", "front", "signer"]),
    default="both",
    show_default=True,
    help="Run one of the two processes: the front faces the network, the signer has the CA keys.",
)
@_passphrases.option
@_settings.command_options
def serve(file: Path, url: str | None, part: str, passphrase_file: Path | None) -> None:
    """Let robots enrol and renew over a network.

    It answers EST (RFC 7030) and requests of `pqsec enrol` with certificates and whole bundles,
    over TLS 1.3 with X25519MLKEM768. Names and rights come from the domain file alone, as it is
    now. It runs until SIGTERM; SIGHUP makes it read FILE and its TLS certificates again.
    """
    if url is not None:
        made = begin_server(url, file, _settings.keystore_path(), now=_settings.now())
        _printing.emit({"files": made}, map(str, made))
        return
    _progress.stop()
    _output.stay()
    with needs_libraries(_network.NEEDS):
        from pqsec_pki.server import run_both, run_front, run_signer  # noqa: PLC0415 -- of an extra

        if part == "front":
            run_front(read_settings(file))
            return
        settings = trusted_settings(file)
        run = run_both if part == "both" else run_signer
        secret = passphrase_file or settings.passphrase_file
        run(
            settings,
            lambda keystore: _passphrases.unlock(keystore, secret),
            _settings.now,
        )
