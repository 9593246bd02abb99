"""`profile` of a domain file: the profile of each set of credentials."""

from functools import partial

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.documents.parts_yaml import Item, Items, chosen, one_or_more, refused

_PAIR = "transition"
"""Its certificates have two keys. That is an alternative to several sets, and not one of them."""


def profiles_in(item: Item) -> tuple[str, ...]:
    """One profile, or a list of them; InvalidDocumentError unless a keystore can have them."""
    names = [profile.name for profile in PROFILES]
    found = one_or_more(item, partial(chosen, names=names))
    if not found:
        raise refused(item, "the list is empty: leave the key out for the default")
    if twice := next((each for each in found if found.count(each) > 1), None):
        raise refused(item, f"{twice} is given twice: each set of credentials has its own profile")
    if isinstance(item, Items) and _PAIR in found:
        raise refused(item, f"{_PAIR} is not one of several: write it alone, and without brackets")
    return found
