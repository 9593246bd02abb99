"""What measured times depend on: versions, processor, frequency governor, load."""

import os
import platform
from datetime import datetime
from pathlib import Path
from typing import Self

import cryptography
from cryptography.hazmat.backends.openssl import backend

from pqsec_pki import __version__
from pqsec_pki._dataclass import dataclass

_CPUS = Path("/proc/cpuinfo")
_GOVERNOR = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")


@dataclass(frozen=True, slots=True)
class Environment:
    """The environment of this process, at `time`."""

    time: datetime
    pqsec: str
    python: str
    cryptography: str
    openssl: str
    """The library that `cryptography` was built with."""
    system: str
    machine: str
    processor: str
    """The processor's name; empty if the system does not report it."""
    cores: int
    """Processor cores that this process may use."""
    governor: str
    """The frequency governor of the first core; empty if the system does not report it."""
    load: tuple[float, float, float]
    """Average number of running processes in the last 1, 5 and 15 minutes."""

    @property
    def hardware(self) -> str:
        """The processor, its cores and the load, as one line."""
        name = self.processor or self.machine
        return f"{name}, {self.cores} cores, load {self.load[0]:.1f}"

    @classmethod
    def here(cls, now: datetime) -> Self:
        """This machine's."""
        return cls(
            time=now,
            pqsec=__version__,
            python=f"{platform.python_implementation()} {platform.python_version()}",
            cryptography=cryptography.__version__,
            openssl=backend.openssl_version_text(),
            system=f"{platform.system()} {platform.release()}",
            machine=platform.machine(),
            processor=_processor(),
            cores=len(os.sched_getaffinity(0)),
            governor=_read(_GOVERNOR).strip(),
            load=os.getloadavg(),
        )


def _processor() -> str:
    names = (line for line in _read(_CPUS).splitlines() if line.startswith("model name"))
    return next(names, "").partition(":")[2].strip()


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
