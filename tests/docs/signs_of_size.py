"""The signs of size in docs/explanation/house.md, counted again.

A call counts if a function of one room, or common module, calls one of another; a room is what
stands at the top of the package. They are counted by sys.setprofile in the last of several commands
in one process: imports, and what is made once, do not count. Run:

    python tests/docs/signs_of_size.py
"""

import ast
import contextlib
import io
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

import pqsec_pki
from pqsec_pki.__main__ import main
from pqsec_pki.credentials import FILES
from pqsec_pki.keystore import layout

ROOT = Path(pqsec_pki.__file__).parent
COMMON = {path.stem for path in ROOT.glob("*.py")}
TREES = {path: ast.parse(path.read_text()) for path in sorted(ROOT.rglob("*.py"))}
SHORT = 3
ENDS = (".pem", ".p7s", ".xml", ".json", ".sqlite3", ".checkpoint", ".tree")
NAMES = {*FILES} | {
    text for text in vars(layout).values() if isinstance(text, str) and text.endswith(ENDS)
}
COMMANDS = {
    "issue": ("issue", "/third", "--subscribe", "rt/chatter"),
    "verify-handshake": ("verify-handshake", "/talker", "/listener"),
}


def functions() -> Iterator[tuple[int, str]]:
    """Lines and name of each function, the longest first."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    found = [
        (1 + (node.end_lineno or 0) - node.lineno, f"{path.relative_to(ROOT)}: {node.name}")
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, kinds)
    ]
    yield from sorted(found, reverse=True)


def past_the_init() -> Iterator[tuple[Path, str]]:
    """The imports from a module of another room."""
    for path, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pqsec_pki."):
                room, *inside = str(node.module).split(".")[1:]
                if inside and room not in COMMON and room != path.relative_to(ROOT).parts[0]:
                    yield path, str(node.module)


def naming_files() -> Iterator[Path]:
    """The modules with a literal name of a keystore file."""
    for path, tree in TREES.items():
        texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
        if texts & NAMES:
            yield path


def run(*words: str) -> None:
    """Run one command; it must succeed."""
    sys.argv = ["pqsec", "-k", "keystore", *words]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            if end.code:
                raise


def room_of(frame: FrameType) -> str | None:
    """The room, or common module, of a function; None outside the package."""
    path = frame.f_code.co_filename
    if not path.startswith(f"{ROOT}/"):
        return None
    return path[len(f"{ROOT}/") :].split("/")[0].removesuffix(".py")


def calls_in(command: Sequence[str]) -> Counter[tuple[str, str]]:
    """How often a room calls another while the command runs."""
    found: Counter[tuple[str, str]] = Counter()

    def count(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_back and (called := room_of(frame)):
            caller = room_of(frame.f_back)
            if caller not in {None, called}:
                found[str(caller), called] += 1

    sys.setprofile(count)
    try:
        run(*command)
    finally:
        sys.setprofile(None)
    return found


def show_calls(name: str, found: Counter[tuple[str, str]]) -> None:
    """Print the sums of one command, and its most frequent pairs."""
    between = sum(count for pair, count in found.items() if COMMON.isdisjoint(pair))
    print(f"calls in {name}: {found.total()}; without the common modules {between}")
    for (caller, called), count in found.most_common(8):
        print(f"  {count:4} {caller} -> {called}")


def signs() -> None:
    """Print all of them."""
    lines = sum(path.read_text().count("\n") for path in TREES)
    sizes = list(functions())
    share = sum(size <= SHORT for size, _ in sizes) / len(sizes)
    print(f"modules, lines: {len(TREES)}, {lines}")
    print(f"functions of {SHORT} lines or fewer: {share:.0%}; the longest: {sizes[0]}")
    print(f"imports past an __init__: {len(list(past_the_init()))}")
    print(f"modules with a literal name of a keystore file: {len(list(naming_files()))}")
    run("ca", "init", "--profile", "transition", "--no-passphrase")
    run("issue", "/talker", "--publish", "rt/chatter")
    run("issue", "/listener", "--subscribe", "rt/chatter")
    run(*COMMANDS["verify-handshake"])
    for name, words in COMMANDS.items():
        show_calls(name, calls_in(words))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        signs()
