"""The attacks that a domain must withstand: one row each, and the row acts.

For `pqsec verify-handshake --attack`: what is done to two participants of a keystore who
would meet, with their own credentials, and where it has to fail.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial

from pqsec_pki.attacks import _impostors, _insiders, _meddling, _tampering
from pqsec_pki.attacks._scene import Attempt, Scene
from pqsec_pki.errors import UnknownAlgorithmError
from pqsec_pki.selfcheck.encounter import Encounter


class Attacker(StrEnum):
    """Who attacks, by what it has."""

    ON_THE_WAY = "on the way"
    """Reads and changes whatever is sent; has no key."""
    OUTSIDER = "outsider"
    """Has what was ever sent, and keys and certificates of its own making."""
    QUANTUM = "quantum computer"
    """An outsider who has found the classical keys, but not the post-quantum ones."""
    INSIDER = "insider"
    """Is a participant of the domain."""


def _anywhere(encounter: Encounter) -> str | None:
    del encounter
    return None


def _two_keys(encounter: Encounter) -> str | None:
    if encounter.profile.alternative_key:
        return None
    return f"participants of profile {encounter.profile.name} have one key"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """One way to attack two who would meet."""

    name: str
    """What a user types."""
    attacker: Attacker
    title: str
    """What the attacker does, in words for who is no expert."""
    refused_at: tuple[str, ...]
    """Where it has to fail: a word of the name of the step."""
    act: Callable[[Scene], Iterator[Attempt]] = field(repr=False)
    pointless: Callable[[Encounter], str | None] = field(default=_anywhere, repr=False)
    """Why it is none for those two, if it is none."""


ATTACKS = (
    Attack(
        name="change-request",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the request, in each of its fields",
        refused_at=("reply", "final"),
        act=partial(_tampering.change_fields, "request"),
    ),
    Attack(
        name="change-reply",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the reply, in each of its fields",
        refused_at=("final",),
        act=partial(_tampering.change_fields, "reply"),
    ),
    Attack(
        name="change-final",
        attacker=Attacker.ON_THE_WAY,
        title="changes one bit of the final message, in each of its fields",
        refused_at=("authenticated",),
        act=partial(_tampering.change_fields, "final"),
    ),
    Attack(
        name="change-message",
        attacker=Attacker.ON_THE_WAY,
        title="changes what is sent encrypted afterwards, or sends it unencrypted",
        refused_at=("message",),
        act=_tampering.change_message,
    ),
    Attack(
        name="drop-field",
        attacker=Attacker.ON_THE_WAY,
        title="takes a required field out of a message",
        refused_at=("reply", "final", "authenticated"),
        act=_tampering.drop_fields,
    ),
    Attack(
        name="double-field",
        attacker=Attacker.ON_THE_WAY,
        title="gives a field a second value, so that two readers may see different ones",
        refused_at=("reply", "final", "authenticated"),
        act=_tampering.double_fields,
    ),
    Attack(
        name="smuggle-field",
        attacker=Attacker.ON_THE_WAY,
        title="adds a field that some stacks sign and others do not",
        refused_at=("reply", "final", "authenticated"),
        act=_tampering.smuggle_fields,
    ),
    Attack(
        name="mislabel",
        attacker=Attacker.ON_THE_WAY,
        title="readdresses a message, or says it is of another kind or version",
        refused_at=("auth", "reply", "final", "authenticated"),
        act=_tampering.mislabel,
    ),
    Attack(
        name="reorder",
        attacker=Attacker.ON_THE_WAY,
        title="delivers a message where another one is due",
        refused_at=("reply", "final", "authenticated"),
        act=_tampering.reorder,
    ),
    Attack(
        name="truncate",
        attacker=Attacker.ON_THE_WAY,
        title="cuts messages short",
        refused_at=("auth", "reply", "final", "authenticated"),
        act=_tampering.truncate,
    ),
    Attack(
        name="oversize",
        attacker=Attacker.ON_THE_WAY,
        title="sends messages of 1 MiB, of 10,000 fields, or that claim 4 GiB, to exhaust memory",
        refused_at=("reply", "final", "authenticated"),
        act=_tampering.oversize,
    ),
    Attack(
        name="swap-challenge",
        attacker=Attacker.ON_THE_WAY,
        title="puts its own challenge in the place of a fresh one, to have an answer ready",
        refused_at=("reply", "final"),
        act=_meddling.swap_challenges,
    ),
    Attack(
        name="strip-hash",
        attacker=Attacker.ON_THE_WAY,
        title="changes the permissions in a message and takes out the hash that would show it",
        refused_at=("final",),
        act=_meddling.strip_hashes,
    ),
    Attack(
        name="key-in-the-middle",
        attacker=Attacker.ON_THE_WAY,
        title="agrees on a key with each side in the other's name, to read along",
        refused_at=("final",),
        act=_meddling.sit_in_the_middle,
    ),
    Attack(
        name="downgrade",
        attacker=Attacker.ON_THE_WAY,
        title="asks for another key agreement than the profile's, a weaker one say",
        refused_at=("reply", "final"),
        act=_meddling.downgrade,
    ),
    Attack(
        name="name-other-signature",
        attacker=Attacker.ON_THE_WAY,
        title="names another signature algorithm than the certificate's",
        refused_at=("reply", "final"),
        act=_meddling.name_other_signatures,
    ),
    Attack(
        name="name-unknown-algorithm",
        attacker=Attacker.ON_THE_WAY,
        title="names an algorithm that does not exist",
        refused_at=("reply", "final"),
        act=_meddling.name_unknown_algorithms,
    ),
    Attack(
        name="reflect",
        attacker=Attacker.ON_THE_WAY,
        title="sends a participant its own certificate back, so that it meets itself",
        refused_at=("reply", "final"),
        act=_meddling.reflect,
    ),
    Attack(
        name="replay",
        attacker=Attacker.ON_THE_WAY,
        title="repeats what it recorded of an earlier handshake, piece by piece or all of it",
        refused_at=("reply", "final", "authenticated", "message"),
        act=_meddling.replay,
    ),
    Attack(
        name="copied-certificate",
        attacker=Attacker.OUTSIDER,
        title="shows the certificate of a participant, without having its key",
        refused_at=("final", "authenticated"),
        act=_impostors.copy_certificate,
    ),
    Attack(
        name="own-ca",
        attacker=Attacker.OUTSIDER,
        title="makes a CA of the same name, and certificates with it",
        refused_at=("reply", "final"),
        act=_impostors.found_a_ca,
    ),
    Attack(
        name="self-signed",
        attacker=Attacker.OUTSIDER,
        title="shows a certificate that it signed itself",
        refused_at=("reply", "final"),
        act=_impostors.vouch_for_itself,
    ),
    Attack(
        name="expired",
        attacker=Attacker.INSIDER,
        title="still uses its certificate after that has ended",
        refused_at=("reply", "final"),
        act=_impostors.come_late,
    ),
    Attack(
        name="not-yet-valid",
        attacker=Attacker.INSIDER,
        title="uses its certificate before that begins",
        refused_at=("reply", "final"),
        act=_impostors.come_early,
    ),
    Attack(
        name="plain-signature",
        attacker=Attacker.QUANTUM,
        title="signs with the classical key alone, as a stock stack does",
        refused_at=("reply", "final"),
        act=_impostors.sign_plainly,
        pointless=_two_keys,
    ),
    Attack(
        name="half-signature",
        attacker=Attacker.QUANTUM,
        title="signs with one of the two keys, and has nothing or another key for the other",
        refused_at=("final", "authenticated"),
        act=_impostors.sign_half,
        pointless=_two_keys,
    ),
    Attack(
        name="stripped-certificate",
        attacker=Attacker.QUANTUM,
        title="takes the CA's post-quantum signature out of the certificate",
        refused_at=("reply", "final"),
        act=_impostors.strip_certificate,
        pointless=_two_keys,
    ),
    Attack(
        name="broken-ca",
        attacker=Attacker.QUANTUM,
        title="issues itself certificates with the classical key of the CA",
        refused_at=("reply", "final"),
        act=_impostors.break_the_ca,
        pointless=_two_keys,
    ),
    Attack(
        name="participant-as-ca",
        attacker=Attacker.INSIDER,
        title="issues a certificate with its own key, as if it were a CA",
        refused_at=("reply", "final"),
        act=_insiders.issue_certificates,
    ),
    Attack(
        name="claimed-guid",
        attacker=Attacker.INSIDER,
        title="claims a GUID that belongs to another participant",
        refused_at=("reply", "final"),
        act=_insiders.claim_guid,
    ),
    Attack(
        name="borrowed-permissions",
        attacker=Attacker.INSIDER,
        title="shows the permissions of another participant",
        refused_at=("admits",),
        act=_insiders.borrow_permissions,
        pointless=_insiders.shared_permissions,
    ),
    Attack(
        name="forged-permissions",
        attacker=Attacker.INSIDER,
        title="shows permissions that the permissions CA never signed",
        refused_at=("admits",),
        act=_insiders.forge_permissions,
    ),
    Attack(
        name="stripped-permissions",
        attacker=Attacker.QUANTUM,
        title="takes the post-quantum signature off its permissions",
        refused_at=("admits",),
        act=_insiders.strip_countersignature,
        pointless=_two_keys,
    ),
    Attack(
        name="bad-public-key",
        attacker=Attacker.INSIDER,
        title="sends key-agreement keys that are none: of a wrong size, off the curve, all zero",
        refused_at=("reply", "message"),
        act=_insiders.send_bad_public_keys,
    ),
    Attack(
        name="bad-ciphertext",
        attacker=Attacker.INSIDER,
        title="answers with a secret that was changed, and signs that",
        refused_at=("final", "message"),
        act=_insiders.sign_bad_ciphertexts,
    ),
)


def attack_named(name: str) -> Attack:
    """The attack a user means; UnknownAlgorithmError, with those there are, if it is none."""
    for row in ATTACKS:
        if row.name == name.lower():
            return row
    known = ", ".join(row.name for row in ATTACKS)
    raise UnknownAlgorithmError(f"no attack named {name!r}", hint=f"known: all, {known}")
