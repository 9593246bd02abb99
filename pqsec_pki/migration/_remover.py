"""Removes a folder whatever the modes of its folders are; as a program, when its stdin ends.

It imports only the standard library: `_temporary_folder` runs this file.
"""

import shutil
import sys
from pathlib import Path


def make_writable(folder: Path) -> None:
    """Let the owner change `folder` and the folders in it; links are not followed."""
    folder.chmod(0o700)
    for each in folder.iterdir():
        if each.is_dir() and not each.is_symlink():
            make_writable(each)


def remove(folder: Path) -> None:
    """Remove `folder` with all that is in it, if it is there; OSError if it cannot be removed."""
    if folder.exists():
        make_writable(folder)
        shutil.rmtree(folder)


if __name__ == "__main__":
    sys.stdin.read()
    remove(Path(sys.argv[1]))
