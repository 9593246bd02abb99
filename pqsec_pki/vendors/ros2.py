"""ROS 2: a script that sets the environment, and the checks that ROS 2 makes late or not at all.

Measured with rclpy of Jazzy: only `true` and `Enforce`, case sensitive, secure a node; it does not
report which of the six files is missing; a key's passphrase cannot be given.
"""

import shlex
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path, PurePosixPath

from pqsec_pki.access import Action
from pqsec_pki.credentials import REVOCATION_LIST, SIX
from pqsec_pki.documents import ros
from pqsec_pki.errors import PqsecError, UsageError, VerificationError, shown
from pqsec_pki.keystore import Keystore, refuse_further_sets, regular_name
from pqsec_pki.lint import Severity, check
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import _first_set, _ros2_plugin, own_plugin
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors._ros2_environment import (
    DOMAIN,
    ENCLAVE_OVERRIDE,
    KEYSTORE,
    SECURED,
    domain_in,
    environment,
    near_misses,
)
from pqsec_pki.vendors._ros2_needs import Needs
from pqsec_pki.vendors._ros2_plugin import CYCLONE, RMW
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import Export, Options
from pqsec_pki.vendors.ros2_check import Check

SCRIPT = "ros2.sh"
FAST_DDS_NOTE = (
    "under rmw_fastrtps, ROS 2's default, nodes of this profile meet with Fast DDS 2.14.5 or 3.2.3,"
    " and not with 2.14.4 or 3.2.0 to 3.2.2; under rmw_cyclonedds, with any"
)
"""A note about versions that cannot send more than 8192 bytes (PQS501); 2.14 is Jazzy's, 3.2
Kilted's."""
RANGE, LOCALHOST = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"


def export(enclave: StackEnclave, options: Options) -> Export:
    """The script; and with `options.at` the enclave's files too, for another machine.

    UsageError for a name that ROS 2 does not accept, a passphrase, and an `at` that is not the
    folder of this enclave in a keystore.
    """
    _refuse_name(enclave.name)
    if options.password is not None:
        raise UsageError(
            "ROS 2 has no setting for a passphrase",
            hint="keep the key unencrypted, mode 0600, on an encrypted disk",
        )
    needs, keystore = Needs.of(enclave), str(_keystore(enclave))
    variables = {} if options.at else options.environment  # another machine has others
    domain = _domain(needs, variables)
    more = {DOMAIN: str(domain)} if domain else {}
    more |= {RANGE: LOCALHOST} if options.loopback else {}
    more |= _ros2_plugin.variables(options)
    plugin = _ros2_plugin.assignments(enclave, options)
    script = render(
        SCRIPT,
        name=enclave.name,
        keystore=shlex.quote(keystore),
        domain=domain,
        loopback=options.loopback,
        plugin=plugin,
        middleware=_ros2_plugin.middleware(options),
    )
    return Export(
        stack=Stack.ROS2,
        participant=enclave.name,
        files={SCRIPT: script, **(_copies(enclave, options) if options.at else {})},
        environment=SECURED | {KEYSTORE: keystore} | more,
        steps=(
            *(f"export {each}" for each in plugin),
            f"unset {ENCLAVE_OVERRIDE}",
            f"ros2 run PACKAGE NODE --ros-args --enclave {enclave.name}",
        ),
        notes=tuple(_notes(enclave, keystore, options)),
        warnings=(*near_misses(variables), *_warnings(needs, domain, variables)),
    )


def preflight(
    keystore: Keystore, name: str, variables: Mapping[str, str], *, now: datetime
) -> Iterator[Check]:
    """Whether a node would run secured as `name`, if it starts with these variables.

    The checks in order; if a file is missing, the content of the files is not checked.
    KeystoreError if there is no such participant.
    """
    keystore.refuse_unknown(name)
    name = regular_name(name)
    options = Options(plugin=_ros2_plugin.folder_of(variables))
    credentials: list[Check] = []
    try:
        _refuse_name(name)
        if options.plugin:
            refuse_further_sets(keystore, "this check knows")
        elif unfit := _first_set.unfit(keystore):
            raise VerificationError(unfit, hint=_first_set.way_out(keystore))
        enclave = StackEnclave.find(keystore, name)
        needs = Needs.of(enclave)
        files = Check(what="files")
        credentials += _credentials(enclave, options, now)
    except PqsecError as error:
        files = Check(what="files", problem=str(error), fix=error.hint or "")
    needs_plugin = any(each.fix.endswith(own_plugin.WAY_OUT) for each in credentials)
    yield from environment(keystore.folder.absolute(), name, variables, plugin=needs_plugin)
    yield from _ros2_plugin.loaded(variables, name)
    yield files
    if files.ok:
        yield from credentials
        yield from _life(needs, domain_in(variables))


def _refuse_name(name: str) -> None:
    """UsageError for a name that ROS 2 does not accept for an enclave, by the rules for topics."""
    if reason := ros.fault(name):
        raise UsageError(
            f"ROS 2 does not accept the enclave name {name}: {reason}",
            hint="issue it under a name of letters, digits and _, such as /fleet/robot_1",
        )


def _keystore(enclave: StackEnclave) -> PurePosixPath:
    """Where the keystore will be; UsageError if `at` is not an enclave's folder."""
    here = f"enclaves{enclave.name}"
    keystore = PurePosixPath(*enclave.at.parts[: -len(PurePosixPath(here).parts)])
    if not keystore.is_absolute() or keystore / here != enclave.at:
        raise UsageError(
            f"{shown(str(enclave.at))} does not end in {here}",
            hint=f"ROS 2 finds enclaves in a keystore: write --at /KEYSTORE/{here};"
            " for several participants, --at /KEYSTORE/enclaves",
        )
    return keystore


def _copies(enclave: StackEnclave, options: Options) -> dict[str, Path]:
    """The files of the enclave that ROS 2 or the plugin reads; none if its robot has the keys."""
    if enclave.key_is_elsewhere:
        return {}
    files = [
        enclave.folder / name for name in ((*SIX, REVOCATION_LIST) if enclave.has_crl else SIX)
    ]
    if options.plugin:
        files += _ros2_plugin.files(enclave)
    return {f"enclaves{enclave.name}/{file.name}": file for file in files}


def _notes(enclave: StackEnclave, keystore: str, options: Options) -> Iterator[str]:
    if enclave.key_is_elsewhere:
        yield f"copy {SCRIPT} to its robot, which has its keys: `pqsec install` writes the others"
    elif options.at:
        yield f"with -o DIR, copy what is in DIR (of several: in each DIR/NAME) to {keystore} there"
    if options.plugin:
        yield from _ros2_plugin.notes(options)
    elif enclave.has_large_handshake and options.environment.get(RMW) != CYCLONE:
        yield FAST_DDS_NOTE


def _domain(needs: Needs, variables: Mapping[str, str]) -> int | None:
    """The domain that the script must set; None if it is 0, the default."""
    if 0 in needs.domains or not needs.domains:
        return None
    wanted = domain_in(variables)
    return wanted if wanted in needs.domains else needs.domains[0]


def _credentials(enclave: StackEnclave, options: Options, now: datetime) -> Iterator[Check]:
    """Findings of `pqsec check` that ROS 2, a stack below it or our plugin refuses."""
    report = check([enclave.folder], now=now, targets=[Stack.ROS2])
    errors = [
        each for each in report.findings if own_plugin.severity(each, options) is Severity.ERROR
    ]
    for each in errors:
        what = f"{each.path.name} ({each.rule.id})"
        more = own_plugin.WAY_OUT if own_plugin.is_of_others(each) else ""
        yield Check(what=what, problem=each.message, fix=each.rule.fix + more)
    if not errors:
        refusal = own_plugin.refusal(enclave, options, now)
        fix = refusal.hint or "" if refusal else ""
        yield Check(what="credentials", problem=str(refusal or ""), fix=fix)


def _warnings(needs: Needs, domain: int | None, variables: Mapping[str, str]) -> Iterator[str]:
    """Warnings for a node that is started with the script in a shell with these variables."""
    checks = _life(needs, domain_in(variables) if domain is None else domain)
    return (f"{each.what}: {each.problem}" for each in checks if not each.ok)


def _life(needs: Needs, domain: int | None) -> Iterator[Check]:
    """Whether a participant and its nodes can run on that domain; None if it is not a number."""
    if domain is None:
        yield Check(what=DOMAIN, problem="is not a number", fix=f"unset {DOMAIN}, or set it to 0")
        return
    refusal = needs.may(Action.JOIN, domain)
    may = ", ".join(map(str, needs.domains)) or "none"
    fix = f"set {DOMAIN} to a domain it may join: {may}"
    yield Check(what=f"{DOMAIN} {domain}", problem=refusal, fix=fix)
    if not refusal:
        for node in needs.nodes:
            how = "--policy FILE" if "*" in node else f"--ros-node {node}, with its own topics"
            fix = f"pqsec issue {needs.enclave} --force {how}"
            yield Check(what=f"node {node}", problem=needs.lack(node, domain), fix=fix)
