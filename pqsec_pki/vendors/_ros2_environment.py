"""How ROS 2 reads the environment: case sensitive, and without messages (measured, Jazzy)."""

import re
from collections.abc import Iterator, Mapping
from os.path import realpath
from pathlib import PurePath

from pqsec_pki.errors import shown
from pqsec_pki.vendors.ros2_check import Check

ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"
KEYSTORE, ENCLAVE_OVERRIDE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
DOMAIN = "ROS_DOMAIN_ID"

SECURED = {ENABLE: "true", STRATEGY: "Enforce"}
"""The only value of each variable that enables security."""
_WITHOUT = {
    ENABLE: "nodes run unsecured, without a message",
    STRATEGY: "a node without its files runs unsecured, without a message",
}
_FIX = 'eval "$(pqsec export ros2 {}{})"'


def environment(
    keystore: PurePath, participant: str, variables: Mapping[str, str], *, plugin: bool = False
) -> Iterator[Check]:
    """A check of each ROS 2 variable about security, for that participant.

    `keystore` is its absolute path. With `plugin`, the fix is an export with pqsec's plugin,
    because stacks refuse its keys.
    """
    fix = _FIX.format(participant, " --plugin" if plugin else "")
    for name, exact in SECURED.items():
        value = variables.get(name)
        problem = "" if value == exact else f"{_is(value, exact)}: {_WITHOUT[name]}"
        yield Check(what=name, problem=problem, fix=fix)
    yield Check(what=KEYSTORE, problem=_keystore(keystore, variables.get(KEYSTORE)), fix=fix)
    other = variables.get(ENCLAVE_OVERRIDE, "")
    problem = f"{_is(other)}, and overrides --enclave" if other not in {"", participant} else ""
    yield Check(what=ENCLAVE_OVERRIDE, problem=problem, fix=f"unset {ENCLAVE_OVERRIDE}")


def near_misses(variables: Mapping[str, str]) -> Iterator[str]:
    """A sentence for each variable whose value looks right but does not enable security."""
    for name, exact in SECURED.items():
        value = variables.get(name)
        if value and value != exact and _looks_on(value):
            yield f"in this shell {name} {_is(value, exact)}: {_WITHOUT[name]}"


def domain_in(variables: Mapping[str, str]) -> int | None:
    """The domain that ROS 2 joins, 0 if none is set; None for text that is not a number."""
    text = variables.get(DOMAIN, "") or "0"
    return int(text) if re.fullmatch(r"[0-9]{1,10}", text) else None


def _looks_on(value: str) -> bool:
    return value.strip().lower() not in {"false", "0", "off", "no", "permissive"}


def _keystore(keystore: PurePath, value: str | None) -> str:
    if not value:
        return f"{_is(value)}: ROS 2 stops with 'failed to initialize rcl: error not set'"
    if not PurePath(value).is_absolute():
        return f"{_is(value)}, not absolute: it depends on the folder a node starts in"
    if realpath(value) != realpath(keystore):
        return f"{_is(value)}, and this keystore is {shown(str(keystore))}"
    return ""


def _is(value: str | None, wanted: str = "") -> str:
    if value is None:
        return "is not set"
    return f"is {shown(value)!r}" + (f", not {wanted}" if wanted else "")
