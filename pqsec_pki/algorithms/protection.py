"""What a profile protects less against quantum computers than another."""

from pqsec_pki.algorithms.profile import Profile


def protection_lost(before: Profile, after: Profile) -> tuple[str, ...]:
    """What is protected less after a change from one profile to the other, a text for each."""
    parts = (
        (
            "certificates and documents",
            "forge them",
            before.signature_level,
            after.signature_level,
        ),
        (
            "traffic between robots with pqsec's plugin",
            "decrypt recordings of it",
            before.key_agreement.level,
            after.key_agreement.level,
        ),
    )
    return tuple(
        f"{what}: NIST level {new} instead of {old}"
        if new
        else f"{what}: no protection against quantum computers, which can {threat}"
        f" (before: NIST level {old})"
        for what, threat, old, new in parts
        if new < old
    )
