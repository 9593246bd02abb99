"""Where the data files are: XSD schemas and document templates.

They live at the top of the repository, and the wheel holds copies of them inside the
package (pyproject.toml, force-include). An editable install has only the first, so
that one is looked at second.
"""

from importlib.resources import files
from importlib.resources.abc import Traversable


def asset(*parts: str) -> Traversable:
    """The data file at `parts`, as in asset("schemas", "governance.xsd")."""
    package = files("pqsec_pki")
    in_wheel = package.joinpath(*parts)
    if in_wheel.is_file():
        return in_wheel
    in_checkout = package.joinpath("..", *parts)
    if in_checkout.is_file():
        return in_checkout
    raise FileNotFoundError("/".join(parts))
