"""The check before an export: whether the stack, or our plugin, would accept the participant."""

from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pqsec_pki.errors import KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import CurrentFiles, Keystore, public_files
from pqsec_pki.lint import Finding, Severity, check, largest_messages
from pqsec_pki.problems import Code, Problem
from pqsec_pki.stacks import Stack
from pqsec_pki.tokens import SCHEME
from pqsec_pki.vendors import _datagrams, _first_set, _plugin_sets, own_plugin
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exporters import EXPORTERS, Exporter, exporter_of
from pqsec_pki.vendors.exports import Export, Options
from pqsec_pki.vendors.own_plugin import FASTRTPS, PRELOAD


def export(stack: str, keystore: Keystore, name: str, options: Options, *, now: datetime) -> Export:
    """What the stack of that name needs to run as the participant called `name`.

    Of several sets of credentials, a stack with its own plugins gets the first. VerificationError
    if that is not for such stacks, the credentials cannot be trusted (room `credentials`), or the
    stack is known to refuse them (`pqsec check` finds an error), or our plugin does, unless
    `options.anyway`; UsageError if there is no such stack, or an option is not for it;
    KeystoreError if there is no such participant, or, unless `options.anyway`, a file is not the
    newest by the ledger; FileError if our plugin is not there.
    """
    _plugin_sets.refuse_unfit(keystore, stack, options)
    exporter = exporter_of(stack)
    exporter.refuse_unknown(options)
    _refuse_place(exporter, options)
    _refuse_plugin(exporter, options)
    enclave = _plugin_sets.enclave_for(keystore, name, options)
    if options.password is not None and not enclave.key_is_encrypted:
        raise UsageError(f"the key of {enclave.name} is not encrypted: it needs no passphrase")
    _refuse_token(exporter, enclave, options)
    unfit = None if options.plugin else _first_set.unfit(keystore)
    if unfit and not options.anyway:
        plugin = "; or run pqsec's plugin in it: --plugin" if exporter.loads_ours else ""
        raise VerificationError(unfit, hint=_first_set.way_out(keystore) + plugin)
    made = _plugin_sets.with_settings(exporter.make(enclave, options), keystore, enclave, options)
    report = check([enclave.folder], now=now, targets=[exporter.stack])
    found: dict[Severity | None, list[Finding]] = {}
    for finding in report.findings:
        found.setdefault(exporter.severity(finding, options), []).append(finding)
    errors, warnings = found.get(Severity.ERROR, []), found.get(Severity.WARNING, [])
    refusal = _refusal(exporter, enclave, errors, options, now)
    refusal = refusal or _plugin_sets.refusal(keystore, name, options, now)
    if refusal and not options.anyway:
        raise refusal
    refused = [*map(str, refusal.problems if refusal else ())]
    refused += () if unfit is None else (str(unfit),)
    try:
        for each in keystore.sets if options.plugin else (keystore,):
            refused += _not_compared(each, enclave.name)
    except (KeystoreError, VerificationError) as error:
        if not options.anyway:
            raise
        refused.append(str(error))
    profile = enclave.profile if options.plugin else None
    sizes = [each.message for each in largest_messages(report.inventory, profile)]
    datagrams = _datagrams.notes(exporter.stack, enclave, options, max(sizes, default=0))
    return replace(
        made,
        notes=(*made.notes, *datagrams),
        warnings=(
            *made.warnings,
            *refused,
            *map(_message_of, warnings),
            *_first_set.lacking(keystore, enclave.name),
        ),
    )


def _not_compared(keystore: Keystore, name: str) -> list[str]:
    """A warning if the user may not read the ledger.

    Errors as of `CurrentFiles.enclave`: a stack reads the files where they are.
    """
    with CurrentFiles.if_readable(keystore) as current:
        if current is None:
            return ["you may not read the ledger: the files may be older than what it has"]
        current.refuse_others(name, public_files(keystore.folder, name))
    return []


def _refusal(
    exporter: Exporter,
    enclave: StackEnclave,
    errors: list[Finding],
    options: Options,
    now: datetime,
) -> VerificationError | None:
    """Why the stack or our plugin would refuse the credentials."""
    told = {each.code for each in errors}
    problems = [_problem(each) for each in errors]
    problems += [each for each in enclave.refusals(now) if each.code not in told]
    if problems:
        return VerificationError(*problems, hint=_way_out(exporter, errors))
    return own_plugin.refusal(enclave, options, now)


def _way_out(exporter: Exporter, errors: list[Finding]) -> str:
    if not errors:
        return "`pqsec check` shows more"
    hint = errors[0].rule.fix
    if exporter.loads_ours and own_plugin.is_of_others(errors[0]):
        hint += own_plugin.WAY_OUT
    return hint


def _problem(finding: Finding) -> Problem:
    return Problem(_message_of(finding), finding.code or Code.OTHER)


def _refuse_place(exporter: Exporter, options: Options) -> None:
    """UsageError for paths of the stack's own plugins that cannot be configured."""
    places = [each for each in (options.plugins, options.crypto) if each]
    if places and not exporter.loads_plugins:
        raise UsageError(
            f"the configuration of {exporter.stack.product} does not name security plugins"
        )
    for each in places:
        if options.at and not each.is_absolute():
            raise _relative(each)


def _relative(path: Path) -> UsageError:
    return UsageError(
        f"{path}: not an absolute path",
        hint="with --at, name the plugin as it is on that machine: --plugins /DIR",
    )


def _refuse_token(exporter: Exporter, enclave: StackEnclave, options: Options) -> None:
    """VerificationError for a key in a token, if the plugin that is to run takes none."""
    uri = enclave.key_uri or ""
    takes = exporter.takes_key_uris and uri.startswith(f"{SCHEME}:")
    if uri and not (options.plugin or takes or options.anyway):
        way = "run pqsec's plugin in it (--plugin), or " if exporter.loads_ours else ""
        raise VerificationError(
            f"the key of {enclave.name} is in a token, and {exporter.stack.product}'s own plugin is"
            " not known to take one",
            hint=f"{way}issue it with a key in a file, and all its rights: --force"
            " --participant-key-uri file",
        )


def _refuse_plugin(exporter: Exporter, options: Options) -> None:
    if options.rmw and (exporter.stack is not Stack.ROS2 or options.plugin is None):
        raise UsageError(
            "--rmw is for ros2 with --plugin", hint="it says which middleware runs the plugin"
        )
    if options.plugin is None:
        return
    if not exporter.loads_ours:
        able = ", ".join(each.stack for each in EXPORTERS if each.loads_ours)
        raise UsageError(
            f"{exporter.stack.product} cannot load pqsec's plugin", hint=f"it is for {able}"
        )
    preloads = exporter.stack is Stack.ROS2 and options.runs_in == FASTRTPS
    names = (PRELOAD,) if preloads else exporter.loads_ours
    if options.at and not options.plugin.is_absolute():
        raise _relative(options.plugin)
    if not options.at:  # another machine cannot be checked from here
        own_plugin.refuse_missing(options.plugin, names)


def _message_of(finding: Finding) -> str:
    return f"{finding.path}: {finding.message} ({finding.rule.id})"
