"""Small shared libraries and programs, made by a real compiler: names, and what they load."""

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

COMPILER, REMEDY = "gcc", "apt-get install gcc libc6-dev"


@dataclass
class Libraries:
    """What was made is made once; a library is asked for by what it says of itself."""

    made: dict[tuple, bytes] = field(default_factory=dict)

    def __call__(
        self, soname: str = "", *needed: str, build: str = "", flags: tuple[str, ...] = ()
    ) -> bytes:
        """The bytes of a library of that name, that loads those, with that build ID in hex."""
        key = (soname, needed, build, flags)
        if key not in self.made:
            with TemporaryDirectory() as folder:
                self.made[key] = self._make(Path(folder), *key)
        return self.made[key]

    def can(self, *flags: str) -> bool:
        """Whether the compiler here makes libraries with these flags."""
        try:
            self(flags=flags)
        except subprocess.CalledProcessError:
            return False
        return True

    def program(self, *needed: str) -> bytes:
        """A program that is linked to those, and exits with 0."""
        return self("", *needed, flags=("-pie", "-nostartfiles", "-e", "nothing"))

    def cyclone(self, folder: Path, release: str, soname: str, *flags: str) -> Path:
        """A Cyclone DDS in that folder: libddsc.so and, beside it, its plugins."""
        self.installed(folder, "libddsc.so", release, soname, *flags)
        for kind in ("auth", "crypto", "ac"):
            name = f"libdds_security_{kind}.so"
            (folder / name).write_bytes(self(name, soname, flags=flags))
        return folder

    def installed(self, folder: Path, name: str, release: str, soname: str, *flags: str) -> Path:
        """A library in that folder, with the links that a package has; each version is a build."""
        folder.mkdir(parents=True, exist_ok=True)
        real = folder / f"{name}.{release}"
        real.write_bytes(self(soname, build=release.encode().hex(), flags=flags))
        for link in {name, soname} - {real.name}:
            (folder / link).unlink(missing_ok=True)
            (folder / link).symlink_to(real.name)
        return real

    def _make(self, folder: Path, soname: str, needed, build: str, flags) -> bytes:
        (folder / "x.c").write_text("int nothing(void) { return 0; }\n")
        words = [] if "-pie" in flags else ["-shared"]
        words += [f"-Wl,-soname,{soname}"] if soname else []
        words += [f"-Wl,--build-id=0x{build}" if build else "-Wl,--build-id=none"]
        for number, name in enumerate(needed):
            other = folder / f"{number}.so"
            machine = [flag for flag in flags if flag.startswith("-m")]
            _compile(folder, "-shared", *machine, f"-Wl,-soname,{name}", "-o", other, "x.c")
            words.append(str(other))
        _compile(folder, "-Wl,--no-as-needed", *flags, "-o", "made", "x.c", *words)
        return (folder / "made").read_bytes()


def _compile(folder: Path, *words) -> None:
    command = [COMPILER, "-nostdlib", "-fPIC", *map(str, words)]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=300)


def libraries(requires: Callable) -> Libraries:
    """The maker, where there is a compiler."""
    requires(shutil.which(COMPILER), "a C compiler", REMEDY)
    return Libraries()
