"""Rules about the security properties in profiles of Fast DDS.

Each was run with Fast DDS 2.9.1 and 3.1.2: two participants with the same profile, and a third
without credentials. Fast DDS logs none of it as an error, except where it makes no participant.
"""

from collections.abc import Iterator
from difflib import get_close_matches

from pqsec_pki.errors import shown
from pqsec_pki.lint.profile import ParticipantProfile, ProfileFile
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

_FAST = {Stack.FASTDDS: "2.9.1, 3.1.2"}
_RUN = "Fast DDS 2.9.1, 3.1.2"
_AUTH, _ACCESS, _CRYPTO = (f"dds.sec.{each}.plugin" for each in ("auth", "access", "crypto"))
_PLUGINS = {
    _AUTH: "builtin.PKI-DH",
    _ACCESS: "builtin.Access-Permissions",
    _CRYPTO: "builtin.AES-GCM-GMAC",
}
_WITHOUT = {
    _AUTH: "runs without security",
    _ACCESS: "sends all samples unencrypted, and checks no permissions",
    _CRYPTO: "exchanges no samples",
}
_NEEDED = {
    _AUTH: ("identity_ca", "identity_certificate", "private_key"),
    _ACCESS: ("permissions_ca", "governance", "permissions"),
}
_OPTIONAL = {
    _AUTH: (
        *("identity_crl", "password", "preferred_key_agreement", "transmit_algorithms_as_legacy"),
        *("max_handshake_requests", "initial_handshake_resend_period"),
        "handshake_resend_period_gain",
    )
}
_OTHERS = (
    *("dds.sec.crypto.keysize", "dds.sec.crypto.maxblockspersession", "dds.sec.log.plugin"),
    *(f"dds.sec.log.builtin.DDS_LogTopic.{each}"
      for each in ("distribute", "logging_level", "log_file")),
)  # fmt: skip
_CLOSE = 0.8
"""The least similarity, as difflib measures it."""


def _full(plugin: str, name: str) -> str:
    """The name of a plugin's property: dds.sec.auth.builtin.PKI-DH.private_key."""
    return f"{plugin.removesuffix('plugin')}{_PLUGINS[plugin]}.{name}"


_KNOWN = frozenset(
    (
        *_PLUGINS,
        *_OTHERS,
        *(_full(plugin, name) for plugin, names in _NEEDED.items() for name in names),
        *(_full(plugin, name) for plugin, names in _OPTIONAL.items() for name in names),
    )
)
"""All that Fast DDS 2.6 to 3.6 read."""


@lint_rule(
    "PQS801", Severity.ERROR, "a plugin that Fast DDS does not know",
    why="Fast DDS continues without it, and reports nothing. Without `dds.sec.auth.plugin` the"
    " participant is unsecured; without `dds.sec.access.plugin` it sends its samples unencrypted."
    " White space around the name counts too.",
    fix="Write the names of Fast DDS's own plugins. pqsec's plugin replaces them under the same"
    " names.",
    stacks=_FAST, measured=_RUN,
    bad="""
        $ pqsec -k k export fastdds /talker -o fastdds
        $ sed -i 's/>builtin.PKI-DH</>pqsec</' fastdds/fastdds.xml
    """,
    good="$ sed -i 's/>pqsec</>builtin.PKI-DH</' fastdds/fastdds.xml",
)  # fmt: skip
def unknown_plugin(file: ProfileFile) -> Iterator[Violation]:
    for profile in file.secured:
        for plugin, name in _PLUGINS.items():
            for each in profile.named(plugin):
                if each.value != name and each.value.strip():
                    yield file.at(
                        each,
                        f"{plugin} is {each.value[:40]!a}: Fast DDS knows only {name}, and"
                        f" {_WITHOUT[plugin]}",
                    )


@lint_rule(
    "PQS802", Severity.ERROR, "a profile with only some of the three plugins",
    why="Fast DDS continues without it, and reports nothing. Without `dds.sec.auth.plugin` the"
    " participant is unsecured, whatever else is configured; without `dds.sec.access.plugin` it"
    " sends its samples unencrypted; without `dds.sec.crypto.plugin` nothing is received.",
    fix="Name all three plugins: `pqsec export fastdds` does.",
    stacks=_FAST, measured=_RUN,
    bad="""
        $ pqsec -k k export fastdds /talker -o fastdds
        $ sed -i 's/dds.sec.access.plugin/dds.sec.access_control.plugin/' fastdds/fastdds.xml
    """,
    good="$ sed -i 's/dds.sec.access_control.plugin/dds.sec.access.plugin/' fastdds/fastdds.xml",
)  # fmt: skip
def missing_plugin(file: ProfileFile) -> Iterator[Violation]:
    for profile in file.secured:
        for plugin in _PLUGINS:
            if not profile.has(plugin):
                yield file.at(
                    profile,
                    f"{_called(profile)} has no {plugin}: Fast DDS {_WITHOUT[plugin]}",
                )


@lint_rule(
    "PQS803", Severity.ERROR, "a property that a plugin of Fast DDS needs is missing",
    why="Fast DDS creates no participant.",
    fix="Add the property, with the file as its value: file:///path.",
    stacks=_FAST, measured=_RUN,
    bad="""
        $ pqsec -k k export fastdds /talker -o fastdds
        $ sed -i 's/Permissions.governance/Permissions.Governance/' fastdds/fastdds.xml
    """,
    good="$ sed -i 's/Permissions.Governance/Permissions.governance/' fastdds/fastdds.xml",
)  # fmt: skip
def missing_property(file: ProfileFile) -> Iterator[Violation]:
    for profile in file.secured:
        for plugin, names in _NEEDED.items():
            for name in names if profile.has(plugin) else ():
                if not profile.has(_full(plugin, name)):
                    yield file.at(profile, f"{_called(profile)} has no {_full(plugin, name)}")


@lint_rule(
    "PQS804", Severity.ERROR, "a security property that Fast DDS ignores",
    why="Fast DDS does not know its name, and reports nothing. A misspelt revocation list revokes"
    " nobody; with a misspelt plugin the participant is unsecured.",
    fix="Correct the name, or remove the property. Capitals and white space count.",
    stacks=_FAST, measured=f"{_RUN}; names read in 2.6.10 to 3.6.2",
    bad="""
        $ pqsec -k k ca crl
        $ pqsec -k k export fastdds /talker -o fastdds
        $ sed -i 's/identity_crl/crl/' fastdds/fastdds.xml
    """,
    good="$ sed -i 's/PKI-DH.crl/PKI-DH.identity_crl/' fastdds/fastdds.xml",
)  # fmt: skip
def ignored_property(file: ProfileFile) -> Iterator[Violation]:
    for profile in file.secured:
        for each in profile.properties:
            if each.is_of_security and each.name not in _KNOWN:
                lower = {name.lower(): name for name in sorted(_KNOWN)}
                near = get_close_matches(each.name.strip().lower(), lower, n=1, cutoff=_CLOSE)
                meant = f": did you mean {lower[near[0]]}?" if near else ""
                yield file.at(each, f"Fast DDS ignores the property {shown(each.name)!r}{meant}")


@lint_rule(
    "PQS805", Severity.ERROR, "a property without a value",
    why="Fast DDS drops the whole profile, and its participant runs without security.",
    fix="Write a value, or remove the property.",
    stacks=_FAST, measured=_RUN,
    bad="""
        $ pqsec -k k export fastdds /talker -o fastdds
        $ sed -i 's/>builtin.AES-GCM-GMAC</> </' fastdds/fastdds.xml
    """,
    good="$ sed -i 's/> </>builtin.AES-GCM-GMAC</' fastdds/fastdds.xml",
)  # fmt: skip
def blank_value(file: ProfileFile) -> Iterator[Violation]:
    for profile in file.secured:
        for each in profile.properties:
            if not each.value.strip():
                yield file.at(
                    each,
                    f"{shown(each.name)} has no value: Fast DDS drops {_called(profile)}, and runs"
                    " without security",
                )


def _called(profile: ParticipantProfile) -> str:
    return f"the profile {shown(profile.name)!r}"
