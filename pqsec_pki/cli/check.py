"""pqsec check: report errors and risks in a keystore, a folder or files."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import click

from pqsec_pki.cli import _completion, _formats, _help, _pager, _printing, _settings, _targets
from pqsec_pki.enrolment import problems_where_installed
from pqsec_pki.errors import UsageError
from pqsec_pki.lint import (
    RULES,
    Baseline,
    Finding,
    LintReport,
    Rule,
    Severity,
    Suppression,
    from_option,
    rule_named,
    stacks_text,
    to_code_quality,
    to_sarif,
)
from pqsec_pki.lint import check as check_all
from pqsec_pki.stacks import Stack

_WORST = [Severity.ERROR, Severity.WARNING, Severity.INFO]
_GROUPED = 2
"""Fewer equal findings after a first one are lines of their own."""
_GITLAB, _SARIF = "gitlab", "sarif"
_COLUMNS = ("severity", "rule", "path", "line", "message", "fix", "stacks")


@_help.command(
    examples={
        "Check the keystore": "pqsec check",
        "Check files of any origin for two stacks": (
            "pqsec check robots/enclaves/talker --target cyclonedds,fastdds"
        ),
        "Explain a rule": "pqsec check --explain PQS231",
        "Accept one kind of finding, and fail on all other warnings": (
            "pqsec check --strict --ignore PQS707='the keys are on an encrypted disk'"
        ),
        "Report only what `pqsec check --json > baseline.json` did not find": (
            "pqsec check --baseline baseline.json"
        ),
    },
    exit_codes={
        0: "no errors; with --strict, no warnings either",
        1: "there are errors; with --strict, also for warnings",
        3: "incomplete: a file or folder cannot be read, or a change was interrupted",
    },
)
@click.argument("paths", nargs=-1, type=_settings.PATH, metavar="[PATH]...")
@_targets.option("Report only findings for these stacks")
@click.option("--strict", is_flag=True, help="Exit with 1 on warnings too.")
@_formats.option(_GITLAB, _SARIF)
@click.option("--sarif", is_flag=True, help="The same as --format sarif: print SARIF 2.1.0.")
@click.option(
    "--explain",
    metavar="ID",
    help="Explain one rule: why it exists, and how to fix a finding.",
    shell_complete=_completion.among(RULES),
)
@click.option(
    "--ignore",
    "ignored",
    multiple=True,
    metavar="ID=REASON",
    help="Suppress the findings of a rule, with a reason. Also in .pqsec-check.yaml.",
)
@click.option(
    "--baseline",
    type=_settings.FILE,
    metavar="FILE",
    help="Ignore the findings in FILE, which an earlier `pqsec check --json` printed.",
)
@click.option(
    "--proofs", is_flag=True, help="Of a robot: demand a proof that the ledger has its documents."
)
@_pager.option
@_settings.command_options
def check(  # noqa: PLR0913 -- one for each option
    paths: tuple[Path, ...],
    targets: tuple[Stack, ...],
    ignored: tuple[str, ...],
    explain: str | None,
    form: str,
    *,
    baseline: Path | None,
    proofs: bool,
    strict: bool,
    sarif: bool,
) -> None:
    """Report errors and risks in keystores, folders and files.

    PATH is a keystore, a folder, or a certificate, key or document; without it, the
    keystore of -k is checked. Nothing is changed, and no private key is decrypted. An
    error fails on some stack or is a security hole; a warning is a risk; an info may be
    intended.
    """
    if explain:
        _explain(rule_named(explain))
        return
    if sarif and _formats.chosen(form) not in {_formats.TABLE, _SARIF}:
        option = "json" if form in {_formats.TABLE, _formats.JSON} else "format"
        raise UsageError(f"--{option} and --sarif exclude each other")
    known = Baseline.read(baseline) if baseline else None
    report = check_all(
        paths or (_settings.keystore_path(),),
        now=_settings.now(),
        targets=targets,
        ignore=map(_suppression, ignored),
        proofs=proofs,
        compare=problems_where_installed,
    )
    if known:
        report = _without_known(report, known)
    if sarif or _formats.chosen(form) == _SARIF:
        _printing.emit(None, [json.dumps(to_sarif(report), indent=2)], verbatim=True)
    elif _formats.chosen(form) == _GITLAB:
        issues = to_code_quality(report)
        _printing.emit(None, [json.dumps(issues, indent=2)], verbatim=True)
    else:
        _formats.emit(
            form,
            report.to_json(strict=strict),
            [*report_lines(report), *_more(report)],
            columns=_COLUMNS,
            items=(
                each.to_json() | {"stacks": stacks_text(each.stacks)} for each in report.findings
            ),
        )
    if code := _exit_code(report, strict=strict):
        click.get_current_context().exit(code)


def _without_known(report: LintReport, known: Baseline) -> LintReport:
    rest, gone = known.apart(report)
    if gone:
        found = _printing.counted(gone, "finding")
        _printing.note(f"{found} of the baseline no longer found: write it again")
    return rest


def _suppression(text: str) -> Suppression:
    suppression = from_option(text)
    suppression.rule = rule_named(suppression.rule).id
    return suppression


def _exit_code(report: LintReport, *, strict: bool) -> int:
    """1 if there are findings that fail the check; else 3 if a file could not be read; else 0.

    3 in any case if a change was interrupted: then files are from before and after it.
    """
    if report.inventory.interrupted_change:
        return 3
    unread = report.unread
    left = set(map(id, unread))
    known = replace(
        report, findings=tuple(each for each in report.findings if id(each) not in left)
    )
    if not known.is_clean(strict=strict):
        return 1
    return 3 if unread else 0


def report_lines(report: LintReport) -> list[str]:
    """The report as lines."""
    counts = [
        f"{number} {severity}" if severity is Severity.INFO else _printing.counted(number, severity)
        for severity in Severity
        if (number := report.count(severity))
    ]
    checked = f"{_printing.counted(report.files_read, 'file')} checked"
    ignored = [f"{len(report.ignored)} ignored"] if report.ignored else []
    summary = f"{checked}: {', '.join([*(counts or ['no findings']), *ignored])}"
    if unread := len(report.unread):
        summary += f"; incomplete: {unread} could not be read"
    return [*_grouped(report.findings), summary]


def _grouped(findings: Sequence[Finding]) -> Iterator[str]:
    """The findings; of many with the same rule and words, the others' places below the first."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for each in findings:
        alike.setdefault((each.rule.id, each.message), []).append(each)
    for each in findings:
        first, *others = alike[each.rule.id, each.message]
        if len(others) < _GROUPED:
            yield str(each)
        elif each is first:
            yield str(first)
            yield f"  also {_printing.few(other.place for other in others)}"


def _more(report: LintReport) -> list[str]:
    """The commands that explain the first of the worst findings, and that list all."""
    lines = [
        f"`pqsec check --explain {each.rule.id}` explains a finding, and how to fix it"
        for each in sorted(report.findings, key=lambda each: _WORST.index(each.severity))[:1]
    ]
    if len(list(_grouped(report.findings))) < len(report.findings):
        lines.append("`--format csv` lists each finding in a line")
    return lines


def _explain(rule: Rule) -> None:
    lines = [f"{rule.id} ({rule.severity}, {rule.family}): {rule.title}", "", rule.why, ""]
    lines += ["Found here:", "", *_indented(rule.bad), "", f"To fix it: {rule.fix}", ""]
    lines += _indented(rule.good)
    stacks = stacks_text(rule.stacks)
    more = [f"Stacks: {stacks}"] if stacks else []
    more += [f"Known from: {rule.measured}"] if rule.measured not in {"", stacks} else []
    if rule.only_when_asked:
        more.append(f"Checked only with --target {' or '.join(sorted(rule.stacks))}")
    lines += ["", *more] if more else []
    _printing.emit(rule.to_json(), lines)


def _indented(example: str) -> list[str]:
    return [f"    {line}".rstrip() for line in example.splitlines()]
