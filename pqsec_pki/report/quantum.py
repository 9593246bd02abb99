"""What a quantum computer would break, by the keys in use and the protection of topics."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping

from pqsec_pki.access import Protection
from pqsec_pki.algorithms import STOCK_AGREEMENT, KeyAgreement, Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Governance
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore, State, Status, layout
from pqsec_pki.lint import LintReport
from pqsec_pki.policy import Fleet
from pqsec_pki.report.dates import KINDS
from pqsec_pki.report.values import Exposure, Strength

_NO_KEY = "a key that pqsec does not know"


def exposures_of(
    keystore: Keystore,
    authorities: Mapping[tuple[str, str], Certificate] | None,
    checked: LintReport | None,
    status: Status | None,
    fleet: Fleet | None,
) -> tuple[Exposure, ...]:
    """The exposures of CAs and participants in use, of key agreements, and of the topics' traffic.

    `authorities` are the CAs' certificates by their sets and kinds. What could not be read is
    None, and left out. Each set of credentials has exposures of its own: with a stock stack, a
    participant uses the first one, and with the plugin the strongest that its peer has.
    """
    return tuple(
        exposure
        for view in keystore.sets
        for exposure in _exposures_of_set(view, authorities or {}, checked, status, fleet)
    )


def _exposures_of_set(
    view: Keystore,
    authorities: Mapping[tuple[str, str], Certificate],
    checked: LintReport | None,
    status: Status | None,
    fleet: Fleet | None,
) -> Iterator[Exposure]:
    everyone = [
        each
        for person in (status.participants if status else ())
        if person.state not in {State.REVOKED, State.GONE, State.ELSEWHERE}
        for each in (person, *person.further)
    ]
    profiles = {
        each.name: each.profile or "" for each in everyone if each.set_name == view.set_name
    }
    enclaves = {each.folder: each for each in (checked.inventory.enclaves if checked else ())}
    participants = {
        name: certificate
        for name in profiles
        if (enclave := enclaves.get(view.folder / layout.enclave_folder(name)))
        and (certificate := enclave.certificate())
    }
    roles = {
        KINDS[kind]: each for (name, kind), each in authorities.items() if name == view.set_name
    }
    of_cas = view.profile.name if view.sets[1:] else ""
    yield from _exposed_signatures(roles, participants, profiles, of_cas)
    yield from _exposed_agreements(view.profile)
    if fleet:
        yield from _exposed_traffic(fleet.governance, view.profile)


def _exposed_signatures(
    authorities: Mapping[str, Certificate],
    participants: Mapping[str, Certificate],
    profiles: Mapping[str, str],
    of_cas: str,
) -> Iterator[Exposure]:
    """The exposures of the CAs, by their roles, and of participants, by their names, with their
    profiles. `of_cas` is the profile of the CAs, if there are those of others."""
    for role, certificate in authorities.items():
        second = authorities.get("countersigner") if role == "permissions CA" else None
        use = f"signatures of the {role}"
        yield _signature(use, certificate, of_cas, (certificate.subject_name,), second)
    alike: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name, certificate in participants.items():
        alike[algorithm_of(certificate), profiles.get(name, "")].append(name)
    for (_, profile), names in alike.items():
        use = "participants' signatures in handshakes"
        yield _signature(use, participants[names[0]], profile, tuple(names))


def _exposed_agreements(profile: Profile) -> Iterator[Exposure]:
    """The exposures of the key agreements that participants of the profile use."""
    peers = "key agreement of pqsec's plugin"
    yield _agreement(peers, profile.key_agreement, profile)
    if profile.runs_in_stock:
        yield _agreement("key agreement of stock stacks", STOCK_AGREEMENT, profile)


def _exposed_traffic(governance: Governance, profile: Profile) -> Iterator[Exposure]:
    """The exposures of topics, by their protection: traffic that an attacker records today."""
    for rule in governance.domain_rules:
        for topics in rule.topic_rules:
            protection = Protection.of(rule, topics)
            kinds = (protection.data, protection.metadata, protection.rtps)
            encrypted = any(kind is not None and kind.encrypts for kind in kinds)
            strength, consequence = _of_traffic(profile) if encrypted else _IN_THE_CLEAR
            yield Exposure(
                use="traffic recorded today",
                algorithm="encrypted" if encrypted else "not encrypted",
                profile=profile.name,
                strength=strength,
                consequence=consequence,
                names=(f"{topics.topic_expression} on {rule.domains.words}",),
            )


def algorithm_of(certificate: Certificate) -> str:
    """The names of its keys' algorithms."""
    try:
        second = certificate.alternative_key
        keys = (certificate.public_key, *filter(None, (second,)))
    except PqsecError:
        return _NO_KEY
    return " and ".join(each.algorithm.name for each in keys)


_IN_THE_CLEAR = (
    Strength.BROKEN,
    "anyone on the network can read it today, without a quantum computer",
)


def _of_traffic(profile: Profile) -> tuple[Strength, str]:
    if not profile.key_agreement.level:
        return Strength.BROKEN, "can be decrypted later: the key agreement is broken"
    if profile.runs_in_stock:
        words = "stays secret between participants with pqsec's plugin; traffic of stock stacks"
        return Strength.PARTLY, f"{words} can be decrypted later"
    return Strength.HOLDS, "stays secret: the key agreement holds"


def _agreement(use: str, row: KeyAgreement, profile: Profile) -> Exposure:
    broken = not row.level
    words = "every session key of recorded traffic can be computed later"
    return Exposure(
        use=use,
        algorithm=row.name,
        profile=profile.name,
        strength=Strength.BROKEN if broken else Strength.HOLDS,
        consequence=words if broken else f"holds, NIST category {row.level}",
        names=(),
    )


def _signature(
    use: str,
    certificate: Certificate,
    profile: str,
    names: Iterable[str],
    countersigner: Certificate | None = None,
) -> Exposure:
    strength, words = _of_signature(certificate, countersigner)
    return Exposure(
        use=use,
        algorithm=algorithm_of(certificate),
        profile=profile,
        strength=strength,
        consequence=words,
        names=tuple(names),
    )


def _of_signature(
    certificate: Certificate, countersigner: Certificate | None
) -> tuple[Strength, str]:
    try:
        first, second = certificate.public_key.algorithm, certificate.alternative_key
        second = countersigner.public_key if countersigner else second
    except PqsecError as error:
        return Strength.UNKNOWN, str(error)
    if first.level:
        return Strength.HOLDS, f"holds, NIST category {first.level}"
    if second is None:
        return Strength.BROKEN, "can be forged"
    other = second.algorithm
    return Strength.PARTLY, (
        f"{first.name} can be forged; {other.name} (NIST category {other.level}) holds where it is"
        " checked: by pqsec and its plugin, not by stock stacks"
    )
