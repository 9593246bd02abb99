"""`ros2 pqsec`: the command line of pqsec, found by ros2cli's entry point `ros2cli.command`."""

import argparse
import sys

from pqsec_pki.cli import main
from pqsec_pki.ros.environment import missing

try:
    from ros2cli.command import CommandExtension
except ModuleNotFoundError as error:
    raise missing("ros2cli", error) from error


class PqsecCommand(CommandExtension):
    """Keys, certificates and signed policy for post-quantum DDS Security."""

    def add_arguments(
        self, parser: argparse.ArgumentParser, cli_name: str, *, argv: list[str] | None = None
    ) -> None:
        """Take all words after `pqsec` as they are, also options."""
        del cli_name, argv
        parser.prefix_chars = ""  # nothing is an option of argparse, neither is --help
        parser.add_argument("words", nargs=argparse.REMAINDER)

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
        """Run pqsec with these words; it ends the process with its own exit code."""
        del parser
        sys.argv = ["pqsec", *args.words]
        main()
