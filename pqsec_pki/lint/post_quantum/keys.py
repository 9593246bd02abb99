"""Rules about post-quantum keys and signatures, and how stock stacks handle them."""

from collections.abc import Iterator

from pqsec_pki.algorithms import Family as Strength
from pqsec_pki.algorithms import Profile, SignatureAlgorithm
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint._keys import alternative_key_of, family_of, key_kind
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile, Inventory
from pqsec_pki.stacks import Stack

STOCK = (Stack.CYCLONEDDS, Stack.FASTDDS, Stack.OPENDDS, Stack.CONNEXT, Stack.ROS2)


@lint_rule(
    "PQS601", Severity.ERROR, "no stock stack accepts a post-quantum identity",
    why="Every stack refused ML-DSA and composite keys for identity CA and participant, also with"
    " OpenSSL 3.5. The code of the stacks supports only RSA and ECDSA.",
    fix="Use the transition profile: classical keys that stacks accept, with ML-DSA keys next to"
    " them.",
    stacks=STOCK, only_when_asked=True,
    rows=("identity all ML-DSA-65", "ML-DSA CA, EC leaf", "EC CA, ML-DSA leaf"),
    measured=SIX_STACKS + "; OpenDDS by source",
    bad="""
        $ pqsec -k quantum ca init --no-passphrase --profile pq
    """,
    good="""
        $ mv quantum elsewhere/
        $ pqsec -k both ca init --no-passphrase --profile transition
    """,
)  # fmt: skip
def post_quantum_identity(file: CertificateFile) -> Iterator[Violation]:
    role = file.role
    if file.first and role.identifies and family_of(file.first) is not Strength.CLASSICAL:
        yield Violation(
            f"the {role} has a key of kind {key_kind(file.first)}, for pqsec peers only"
        )


@lint_rule(
    "PQS602", Severity.ERROR, "no stock stack can verify these documents",
    why="Stacks verify with PKCS7_verify, which supports only RSA and ECDSA, also in OpenSSL 3.5"
    " and 4.0: 'provider signature not supported'.",
    fix="Use the transition profile: an ECDSA signature, and an ML-DSA signature over it.",
    stacks=STOCK, only_when_asked=True,
    rows=("governance/permissions CMS-signed ML-DSA-65",),
    measured=SIX_STACKS + "; OpenDDS by source",
    bad="""
        $ pqsec -k quantum ca init --no-passphrase --profile pq
    """,
    good="""
        $ mv quantum elsewhere/
        $ pqsec -k both ca init --no-passphrase --profile transition
    """,
)  # fmt: skip
def post_quantum_documents(file: CertificateFile) -> Iterator[Violation]:
    role = file.role
    if file.first and role.signs_documents and family_of(file.first) is not Strength.CLASSICAL:
        yield Violation(
            f"the {role} signs documents with {key_kind(file.first)}, for pqsec peers only"
        )


@lint_rule(
    "PQS609", Severity.WARNING, "a key is weaker than the profile requires",
    why="The profile of a keystore sets the security level for all its keys.",
    fix="Issue the participant again, or create the keystore again with the profile that you want.",
    bad=r"""
        $ openssl req -x509 -key k/enclaves/talker/key.pem -subj '/CN=\/talker' -days 365 \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem \
          -addext basicConstraints=critical,CA:FALSE -out k/enclaves/talker/cert.pem
    """,
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def below_profile(inventory: Inventory) -> Iterator[Violation]:
    for file in inventory.certificates:
        if profile := inventory.profile_of(file.path):
            yield from _below(profile, file)


def _below(profile: Profile, file: CertificateFile) -> Iterator[Violation]:
    """The keys of the file that are weaker than those of the profile of its set."""
    wanted = {
        CertificateRole.PARTICIPANT: (profile.participant_key, profile.alternative_key),
        CertificateRole.IDENTITY_CA: (profile.identity_key, profile.alternative_key),
        CertificateRole.PERMISSIONS_CA: (profile.permissions_key, None),
        CertificateRole.COUNTERSIGNER: (profile.alternative_key, None),
    }
    role = file.role
    rows = wanted.get(role, (None, None))
    for what, found, row in zip(("key", "alternative key"), _keys(file), rows, strict=True):
        if row and (level := _level(found)) < row.level:
            words = f"the {role}'s {what} is of security level {level}, not {row.level}"
            yield Violation(f"{words} as in profile {profile.name} ({row.name})", path=file.path)


@lint_rule(
    "PQS610", Severity.INFO, "no key here resists a quantum computer",
    why="An attacker who records the traffic now can read it when ECDH is broken (harvest now,"
    " decrypt later). This is not reported for a keystore created with `--profile classical`.",
    fix="For data that is still sensitive in ten years, use profile transition. It works with stock"
    " stacks, and between pqsec peers the key agreement is hybrid.",
    bad="""
        $ pqsec -k c ca init --no-passphrase --profile classical
        $ pqsec -k c issue --publish chatter /talker
        $ cp -rL c/enclaves/talker robot
    """,
    good="""
        $ mv robot elsewhere/
        $ cp -rL k/enclaves/talker robot
    """,
)  # fmt: skip
def classical_only(inventory: Inventory) -> Iterator[Violation]:
    certificates = [each.first for each in inventory.certificates if each.first]
    if inventory.keystore or not inventory.enclaves or not certificates:
        return
    if all(family_of(each) is Strength.CLASSICAL and not each.alternative for each in certificates):
        yield Violation("all keys here are classical")


def _keys(file: CertificateFile) -> tuple[SignatureAlgorithm | None, SignatureAlgorithm | None]:
    if file.first is None:
        return None, None
    second = alternative_key_of(file.first)
    try:
        return file.first.public_key.algorithm, second.algorithm if second else None
    except PqsecError:
        return None, second.algorithm if second else None


def _level(row: SignatureAlgorithm | None) -> int:
    return row.level if row else 0
