"""Builds and runs a target of a Containerfile in root file systems, where no engine is to be had.

It has the instructions that ours uses, and refuses others. The base image is a copy of a root file
system; a step runs in it by chroot, with /proc and /dev, as the instruction before it said.
"""

import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

Instruction = tuple[str, str]
PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
CHROOT = shutil.which("chroot") or "/usr/sbin/chroot"


@dataclass
class Stage:
    """A `FROM`, and what stands below it."""

    name: str
    base: str
    steps: list[Instruction]


@dataclass
class Image:
    """A root file system, and how a container of it starts."""

    root: Path
    environment: dict[str, str] = field(default_factory=lambda: {"PATH": PATH})
    folder: str = "/"
    user: str = "root"
    entrypoint: list[str] = field(default_factory=list)
    command: list[str] = field(default_factory=list)
    volumes: list[str] = field(default_factory=list)
    ports: list[str] = field(default_factory=list)


Base = Callable[[Path], Image]


def read(text: str) -> dict[str, Stage]:
    """The stages by their names."""
    stages: dict[str, Stage] = {}
    lines = (line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        word, _, rest = line.strip().partition(" ")
        if word == "FROM":
            base, name = re.fullmatch(r"(\S+) AS (\S+)", rest).groups()
            stages[name] = Stage(name, base, [])
        elif word:
            list(stages.values())[-1].steps.append((word, " ".join(rest.split())))
    return stages


def start(image: Image, words: list[str]) -> list[str]:
    """The command that runs `words` in it, with mounts that only they see."""
    uid, gid, home = _user(image)
    variables = [f"{key}={value}" for key, value in {"HOME": home, **image.environment}.items()]
    inner = f'cd {shlex.quote(image.folder)} && exec "$@"'
    mounts = (
        f'mount --rbind /proc "{image.root}/proc"; mount --rbind /dev "{image.root}/dev"; exec "$@"'
    )
    return [
        *("unshare", "--mount", "sh", "-ec", mounts, "-"),
        *("env", "-i", *variables, CHROOT, f"--userspec={uid}:{gid}", "--groups="),
        *(str(image.root), "sh", "-ec", inner, "-", *words),
    ]


def _user(image: Image) -> tuple[str, str, str]:
    for line in (image.root / "etc/passwd").read_text().splitlines():
        name, _, uid, gid, _, home, _ = line.split(":")
        if image.user in {name, uid}:
            return uid, gid, home
    raise AssertionError(f"no user {image.user}")


class Builder:
    """Builds images below a folder. `base(root)` makes the base image there."""

    def __init__(self, text: str, context: Path, folder: Path, base: Base) -> None:
        self.stages, self.context, self.folder, self.base = read(text), context, folder, base
        self.built: dict[str, Image] = {}

    def build(self, name: str) -> Image:
        """The image of a stage, with those that it is made from."""
        if name not in self.built:
            stage, root = self.stages[name], self.folder / name
            if stage.base in self.stages:
                below = self.build(stage.base)
                subprocess.run(["cp", "-a", below.root, root], check=True)
                image = Image(root, dict(below.environment), below.folder, below.user)
            else:
                image = self.base(root)
            for word, rest in stage.steps:
                getattr(self, f"_{word.lower()}")(image, rest)
            self.built[name] = image
        return self.built[name]

    def _run(self, image: Image, rest: str) -> None:
        subprocess.run(start(image, ["sh", "-c", rest]), check=True, timeout=900)

    def _copy(self, image: Image, rest: str) -> None:
        source = self.context
        words = rest.split()
        if words[0].startswith("--from="):
            source = self.build(words.pop(0).removeprefix("--from=")).root
        *names, goal = words
        place = image.root / (Path(image.folder) / goal).as_posix().lstrip("/")
        for path in (source / each.lstrip("/") for each in names):
            if path.is_dir():
                shutil.copytree(path, place, symlinks=True, dirs_exist_ok=True)
            elif goal.endswith("/"):
                place.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, place / path.name)
            else:
                shutil.copy(path, place)

    def _workdir(self, image: Image, rest: str) -> None:
        image.folder = rest
        (image.root / rest.lstrip("/")).mkdir(parents=True, exist_ok=True)

    def _user(self, image: Image, rest: str) -> None:
        image.user = rest

    def _env(self, image: Image, rest: str) -> None:
        key, _, value = rest.partition("=")
        image.environment[key] = value

    def _volume(self, image: Image, rest: str) -> None:
        image.volumes.append(rest)

    def _expose(self, image: Image, rest: str) -> None:
        image.ports.append(rest)

    def _entrypoint(self, image: Image, rest: str) -> None:
        image.entrypoint = json.loads(rest)

    def _cmd(self, image: Image, rest: str) -> None:
        image.command = json.loads(rest)
