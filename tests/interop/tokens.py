"""PKCS#11 tokens for tests: SoftHSM's, and one with ML-DSA keys that runs from Debian sid."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from tests.docs.forking import Forks

SOFTHSM = Path("/usr/lib/softhsm/libsofthsm2.so")
SPY = next(Path("/usr/lib").glob("*-linux-gnu/pkcs11-spy.so"), None)
"""Notes each call to a token's library; part of OpenSC."""
PIN = "pin-of-a-test-9134"
SO_PIN = "so-pin-of-a-test"


@dataclass(frozen=True)
class Token:
    """A token with the label lab, and how programs reach it."""

    folder: Path
    module: Path
    environment: dict[str, str]
    begin: tuple[str, ...] = ()
    """What a program's command line begins with."""
    python: str = field(default=sys.executable)
    forks: Forks | None = None
    """Runs pqsec, where Python needs no other libraries for the token."""

    @classmethod
    def softhsm(cls, folder: Path, forks: Forks | None = None) -> "Token":
        """A new token of SoftHSM."""
        (folder / "tokens").mkdir()
        configuration = folder / "home/.config/softhsm2/softhsm2.conf"
        configuration.parent.mkdir(parents=True)
        configuration.write_text(f"directories.tokendir = {folder / 'tokens'}\n")
        token = cls(folder, SOFTHSM, {"SOFTHSM2_CONF": str(configuration)}, forks=forks)
        token.tool("--init-token", "--slot-index", "0", "--label", "lab", "--so-pin", SO_PIN)
        return token._with_pin()

    @classmethod
    def ml_dsa(cls, folder: Path, sid: Path) -> "Token":
        """A new token of FreeHSM, in programs that run with the libraries of Debian sid."""
        (folder / "tokens").mkdir()
        libraries = sid / "usr/lib/x86_64-linux-gnu"
        python = Path(sys.executable).resolve()
        places = (libraries, python.parent.parent / "lib", "/usr/lib/x86_64-linux-gnu")
        begin = (str(sid / "usr/lib64/ld-linux-x86-64.so.2"), "--library-path")
        environment = {
            "FHSM_TOKENS_DIR": str(folder / "tokens"),
            "FHSM_INTEGRITY_ALLOW_UNSIGNED": "1",
            "PYTHONPATH": os.pathsep.join(each for each in sys.path if each),
        }
        token = cls(
            folder,
            libraries / "libfreehsm.so",
            environment,
            (*begin, ":".join(map(str, places))),
            str(python),
        )
        token.tool("--init-token", "--slot-index", "0", "--label", "lab", "--so-pin", SO_PIN)
        return token._with_pin()

    def _with_pin(self) -> "Token":
        as_officer = ("--login", "--login-type", "so", "--so-pin", SO_PIN)
        self.tool("--token-label", "lab", *as_officer, "--init-pin", "--new-pin", PIN)
        self.pin_file.write_text(f"{PIN}\n")
        self.pin_file.chmod(0o600)
        return self

    @property
    def home(self) -> Path:
        """A home folder where SoftHSM finds the token: an agent gets few variables of its host."""
        return self.folder / "home"

    @property
    def pin_file(self) -> Path:
        return self.folder / "pin"

    def tool(self, *options: str) -> str:
        """What OpenSC's pkcs11-tool says."""
        command = [*self.begin, "/usr/bin/pkcs11-tool", "--module", str(self.module), *options]
        done = subprocess.run(
            command, env=os.environ | self.environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def objects(self) -> str:
        """All objects, as pkcs11-tool lists them."""
        return self.tool("--token-label", "lab", "--login", "--pin", PIN, "--list-objects")

    def run(self, *command: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """A Python program with access to the token."""
        return subprocess.run(
            [*self.begin, self.python, *command],
            env=self._variables() | variables,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )

    def _variables(self) -> dict[str, str]:
        environment = {
            **(os.environ | self.environment),
            "PQSEC_PKCS11_MODULE": str(self.module),
            "PQSEC_PIN_FILE": str(self.pin_file),
        }
        for name in ("PQSEC_KEYSTORE", "ROS_SECURITY_KEYSTORE", "PQSEC_PASSPHRASE_FILE"):
            environment.pop(name, None)
        return environment

    def _command(self, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        if self.forks is None:
            return self.run("-m", "pqsec_pki", "-k", "k", *words, **variables)
        environment = self._variables() | variables
        return self.forks.run(("-k", "k", *words), cwd=self.folder, env=environment)

    def pqsec(self, *words: str, exit_code: int = 0, **variables: str) -> str:
        """What pqsec prints, on stdout and stderr, with the keystore `k`."""
        done = self._command(*words, **variables)
        assert done.returncode == exit_code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr

    def answer(self, *words: str) -> dict[str, object]:
        """What it prints with --json."""
        done = self._command(*words, "--json")
        assert done.returncode == 0, done.stderr
        value: dict[str, object] = json.loads(done.stdout)
        return value
