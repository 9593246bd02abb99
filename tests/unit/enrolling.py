"""A robot that asks, CAs that answer, and bundles with one thing wrong."""

from dataclasses import replace
from datetime import timedelta

from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import Bundle, install, request, validate_csrs
from pqsec_pki.lifecycle import ParticipantSpec, issue
from tests.unit.killing import NOW, YEAR

ROBOT = "/fleet/robot1"
DAY = timedelta(days=1)
LATER = NOW + 2 * DAY


def asked_of(keystore, root, name=ROBOT):
    """The request for `name` that the robot at `root` makes."""
    return request(name, keystore.profile, root, force=True).request


def answered(keystore, *requests, now=NOW, **spec):
    """The bundle that answers these requests; `wish` says what is allowed."""
    names = [each.common_name for each in requests]
    keys = validate_csrs(requests, keystore.profiles, names=names)
    specs = [
        ParticipantSpec(
            **{"domains": DomainSet.of(0), "publish": ("t",), "validity": YEAR, **spec},
            name=name,
            keys=keys[name],
        )
        for name in names
    ]
    issue(keystore, keystore.unlock(None), specs, now=now, force=True)
    return Bundle.of(keystore, names, now=now)


def put(robot, bundle, now=LATER, **options):
    """Install the bundle on the robot."""
    return install(bundle.to_bytes(), robot, bundle.roles, now=now, **options)


def with_files(bundle, name=ROBOT, **files):
    """The bundle with other files; None leaves one out. `cert_pem` stands for cert.pem."""
    named = {key.replace("_pem", ".pem").replace("_p7s", ".p7s"): v for key, v in files.items()}
    named = {{"alt.key": "alt.key.pem"}.get(key, key): data for key, data in named.items()}
    changed = {k: v for k, v in {**bundle.enclaves[name], **named}.items() if v is not None}
    return replace(bundle, enclaves={**bundle.enclaves, name: changed}, proof=None)
