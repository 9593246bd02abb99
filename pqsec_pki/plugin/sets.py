"""The sets of credentials of a local participant: those that its `pqsec.toml` names, all of them.

The stack's configuration names the files of one set; the others have the same names in folders of
their own. Which sets there must be is what `pqsec.toml` says, never which folders there are: one
that lacks a file, or a revocation list that another has, is refused, as are sets that could be
taken for each other.
"""

from collections.abc import Iterator
from datetime import datetime
from itertools import combinations
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki.algorithms import Family, profile_named
from pqsec_pki.credentials import CERTIFICATE, IDENTITY_CA, PERMISSIONS_CA, REVOCATION_LIST
from pqsec_pki.errors import MissingError, UsageError, VerificationError
from pqsec_pki.handshake import StockPeers
from pqsec_pki.plugin.credentials import PASSWORD, Properties, Source
from pqsec_pki.plugin.settings import HERE, SETTINGS, SettingsFile
from pqsec_pki.plugin.trust import PROPERTIES, TRUSTED, ParticipantTrust
from pqsec_pki.problems import Code, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustedSets:
    """The certificates and trust anchors of all sets, that of stock stacks first."""

    sets: tuple[ParticipantTrust, ...]
    profiles: tuple[str, ...] = ()
    """The profile of each; empty if there is one set, whose profile is not known."""
    configured: int = 0
    """The number of the set whose files the stack's configuration names."""
    stock: StockPeers | None = None
    """Who may be met with the first set; None if there is one set, which is for everybody."""

    @classmethod
    def of(cls, properties: Properties, now: datetime) -> Self:
        """The sets that `pqsec.toml` beside the certificate names, or the one of the properties.

        Errors as of `ParticipantTrust.of`; VerificationError for sets that do not belong together.
        """
        source = properties.source(PROPERTIES[CERTIFICATE])
        file = SettingsFile.beside(source)
        if not file.sets:
            return cls(sets=(ParticipantTrust.of(properties, now, file),))
        if properties.optional(TRUSTED):
            raise UsageError(
                f"a folder of trusted CAs and several sets exclude each other: {SETTINGS} does not"
                " say of which set its CAs are"
            )
        found = tuple(_read(properties, source, file, now))
        profiles = tuple(file.sets)
        if problems := [*_mixed(found), *_of_other_profiles(found, profiles)]:
            raise VerificationError(*problems)
        return cls(
            sets=found,
            profiles=profiles,
            configured=list(file.sets.values()).index(HERE),
            stock=StockPeers(file.stock),
        )


def _read(
    properties: Properties, source: Source, file: SettingsFile, now: datetime
) -> Iterator[ParticipantTrust]:
    strongest = list(file.sets)[-1]
    for profile, folder in file.sets.items():
        own = properties if folder == HERE else _beside(properties, source, folder)
        try:
            yield ParticipantTrust.of(own, now, file, strongest=profile == strongest)
        except MissingError as error:
            error.hint = error.hint or f"{SETTINGS} names the set {profile}: install all of it"
            raise


def _beside(properties: Properties, source: Source, folder: str) -> Properties:
    """The properties of the set in `folder`, which is relative to that of the certificate."""
    if source.path is None:
        raise UsageError("the certificate of a participant with several sets must be a file")
    place = source.path.parent / folder
    pairs = [(name, f"file:{each}") for each, name in PROPERTIES.items() if each != REVOCATION_LIST]
    if properties.optional(PASSWORD):
        pairs.append((PASSWORD, properties.optional(PASSWORD)))
    path = place / REVOCATION_LIST
    if properties.optional(PROPERTIES[REVOCATION_LIST]):
        pairs.append((PROPERTIES[REVOCATION_LIST], f"file:{REVOCATION_LIST}"))
    elif exists(path):
        words = "the configuration names no revocation list, and this set has one"
        raise UsageError(f"{path}: {words}", hint="name the revocation list in the configuration")
    return Properties(pairs, str(place))


def _mixed(sets: tuple[ParticipantTrust, ...]) -> Iterator[Problem]:
    """What makes two sets different participants, or lets one be taken for another."""
    for one, other in combinations(sets, 2):
        if one.certificate.subject_der != other.certificate.subject_der:
            names = f"{one.certificate.subject_name} and {other.certificate.subject_name}"
            yield Problem(f"the sets are of different participants: {names}", Code.WRONG_SUBJECT)
        cas = one.anchors.identity_cas, other.anchors.identity_cas
        if {each.subject_der for each in cas[0]} & {each.subject_der for each in cas[1]}:
            words = f"two sets have an identity CA of the same name, {cas[0][0].subject_name}"
            yield Problem(words, Code.CA_DOUBLED, IDENTITY_CA)
        if _keys(one) & _keys(other):
            yield Problem("two sets have the same key", Code.ONE_KEY_TWO_ROLES)


def _keys(found: ParticipantTrust) -> set[bytes]:
    anchors = found.anchors
    return {each.spki for each in (found.certificate, *anchors.identity_cas, *anchors.signers)}


def _of_other_profiles(
    sets: tuple[ParticipantTrust, ...], profiles: tuple[str, ...]
) -> Iterator[Problem]:
    """Keys that are not of the kind of their set's profile: another set in its folder."""
    for found, name in zip(sets, profiles, strict=True):
        profile = profile_named(name)
        for file, each, wanted in (
            (CERTIFICATE, found.certificate, profile.participant_key),
            (IDENTITY_CA, found.anchors.identity_ca, profile.identity_key),
            (PERMISSIONS_CA, found.anchors.permissions_ca, profile.permissions_key),
        ):
            row = each.public_key.algorithm
            if row.family is not wanted.family:
                words = f"a key of {row.name}, which is not for the set {name}"
                yield Problem(words, Code.PROFILE_MISMATCH, file)
        if found is sets[-1] and profile.participant_key.family is Family.CLASSICAL:
            words = f"the last set is the strongest, and {name} is classical"
            yield Problem(words, Code.PROFILE_MISMATCH, SETTINGS)
