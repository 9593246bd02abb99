"""The stacks that credentials are exported for: pqsec's own, and those of other packages."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError
from pqsec_pki.lint import Finding, Severity
from pqsec_pki.plugin import LIBRARY, NAMES
from pqsec_pki.stacks import OtherStack, Stack
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import Export, Options, Version
from pqsec_pki.vendors.own_plugin import OPENDDS, PRELOAD

Writer = Callable[[StackEnclave, Options], Export]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exporter:
    """A stack, and what writes its configuration: `writer`, or the module of this room.

    The module has `export(enclave, options) -> Export`, and may have
    `severity(finding, options) -> Severity | None`: the severity of a finding for the chosen
    version, None if it does not apply. Otherwise the severity is that of its rule, except for
    findings that do not apply when our own plugin runs.
    """

    stack: Stack | OtherStack
    writer: Writer | None = None
    """The writer of another package's stack."""
    versions: str
    """The versions whose configuration is known, in words."""
    first: Version = ()
    end: Version | None = None
    """The first version after them, if there is a limit."""
    has_numbers: bool = True
    """Whether its versions have numbers; those of ROS 2 have names."""
    knows_loopback: bool = False
    """Whether it is known how to restrict it to one machine."""
    loads_plugins: bool = False
    """Whether its configuration names the security plugins."""
    loads_ours: tuple[str, ...] = ()
    """The files of pqsec's own plugin that it can load in place of its own."""
    takes_key_uris: bool = False
    """Whether its own plugin is known to take a private key in a token."""
    evidence: str
    """How it is known that the stack accepts the export."""

    def make(self, enclave: StackEnclave, options: Options) -> Export:
        """The export, unchecked; UsageError for an option that the stack cannot have."""
        if options.loopback and not self.knows_loopback:
            able = ", ".join(each.stack for each in EXPORTERS if each.knows_loopback)
            raise UsageError(
                f"pqsec does not know how to restrict {self.stack.product} to one machine",
                hint=f"--loopback is for {able}",
            )
        write: Writer = self.writer or self._module.export
        return write(enclave, options)

    def refuse_unknown(self, options: Options) -> None:
        """UsageError for a version whose configuration is not known."""
        hint = f"exports are for {self.versions}"
        if options.version is not None and not self.has_numbers:
            raise UsageError(f"versions of {self.stack.product} have no numbers", hint=hint)
        meant = options.release
        if meant and (meant < self.first or (self.end and meant >= self.end)):
            raise UsageError(
                f"pqsec does not know the configuration of {self.stack.product} {options.version}",
                hint=hint,
            )

    def severity(self, finding: Finding, options: Options) -> Severity | None:
        """The severity for this stack; None if the finding does not apply to it."""
        judge = getattr(self._module, "severity", own_plugin.severity)
        judged: Severity | None = judge(finding, options)
        return judged

    @property
    def _module(self) -> Any:
        return None if self.writer else import_module(f"pqsec_pki.vendors.{self.stack}")


EXPORTERS = (
    Exporter(
        stack=Stack.CYCLONEDDS,
        versions="0.10 and later",
        first=(0, 10),
        knows_loopback=True,
        loads_plugins=True,
        loads_ours=(LIBRARY,),
        evidence="run",
    ),
    Exporter(
        stack=Stack.FASTDDS,
        versions="2.x and 3.x",
        first=(2,),
        end=(4,),
        knows_loopback=True,
        loads_ours=(PRELOAD,),
        takes_key_uris=True,
        evidence="run",
    ),
    Exporter(
        stack=Stack.OPENDDS,
        versions="3.x",
        first=(3,),
        end=(4,),
        loads_ours=(OPENDDS,),
        evidence="run with 3.13.3; later ones by their source",
    ),
    Exporter(
        stack=Stack.CONNEXT,
        versions="7.x",
        first=(7,),
        end=(8,),
        evidence="its documents; not run",
    ),
    Exporter(
        stack=Stack.ROS2,
        versions="Jazzy",
        has_numbers=False,
        knows_loopback=True,
        loads_ours=NAMES,
        evidence="run",
    ),
)


def exporter_of(stack: str) -> Exporter:
    """The row of that name: pqsec's own, else that of an installed package.

    UsageError, with all names, if there is none; ForeignPackageError if the package is broken.
    """
    name = stack.lower()
    if own := next((each for each in EXPORTERS if each.stack == name), None):
        return own
    from pqsec_pki.vendors import foreign  # noqa: PLC0415 -- few ask for such stacks

    return foreign.exporter_of(name)
