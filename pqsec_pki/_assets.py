"""Finds the data files: XSD schemas and document templates.

They are at the top of the repository, and the wheel contains copies inside the package
(pyproject.toml, force-include). An editable install has only those of the repository,
which are tried second.
"""

from pathlib import Path

_PACKAGE = Path(__file__).parent


def asset(*parts: str) -> Path:
    """The data file at `parts`, as in asset("schemas", "governance.xsd")."""
    for folder in (_PACKAGE, _PACKAGE.parent):
        found = folder.joinpath(*parts)
        if found.is_file():
            return found
    raise FileNotFoundError("/".join(parts))
