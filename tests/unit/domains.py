"""A domain file beside its keystore, for tests that change the one and look at the other."""

import shutil
from datetime import UTC, datetime, timedelta

from pqsec_pki.documents import Permissions
from pqsec_pki.domain import Plan, apply_plan, create_keystore, plan, read_domain
from pqsec_pki.keystore import Keystore
from pqsec_pki.smime import document_in

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
DAY = timedelta(days=1)
FILE = """
name: Lab
profile: transition
validity: 90d
renew_before: 30d
roles:
  robot: {publish: [rt$name/pose], subscribe: [rt/cmd]}
  monitor: {subscribe: ["rt/*"]}
participants:
  - {name: "/r{1..3}", role: robot}
  - {name: /monitor, role: monitor}
"""
NAMES = ["/monitor", "/r1", "/r2", "/r3"]


class Scene:
    """A domain file beside its keystore."""

    def __init__(self, folder, text=FILE):
        self.file = folder / "domain.yaml"
        self.root = folder / "k"
        if text:
            self.write(text)

    @classmethod
    def at(cls, folder):
        """What is in the folder already."""
        return cls(folder, text=None)

    @classmethod
    def copy(cls, original, folder):
        """The same again in another folder."""
        shutil.copytree(original.file.parent, folder, symlinks=True, dirs_exist_ok=True)
        return cls.at(folder)

    def write(self, text):
        self.file.write_text(text)

    def change(self, old, new):
        text = self.file.read_text()
        assert old in text
        self.write(text.replace(old, new))

    @property
    def keystore(self):
        return Keystore.open(self.root, to_change=True)

    def plan(self, now=NOW, **options) -> Plan:
        keystore = self.keystore if self.root.exists() else None
        return plan(read_domain(self.file), keystore, now=now, **options)

    def steps(self, now=NOW, **options):
        """What is to be done, as (action, name)."""
        return [(step.action, step.name) for step in self.plan(now, **options).steps]

    def whys(self, now=NOW):
        return {step.name: step.why for step in self.plan(now).steps}

    def apply(self, now=NOW, **options):
        found = self.plan(now, **options)
        if not self.root.exists():
            create_keystore(read_domain(self.file), self.root, passphrase=None, now=now)
        assert self.take(found, now) == [(step.action, step.name) for step in found.steps]

    def take(self, found, now=NOW):
        """The steps of a plan that are taken; fewer, if another command was at work since."""
        desired, keystore = read_domain(self.file), self.keystore
        batches = apply_plan(desired, keystore, keystore.unlock(None), found, now=now)
        return [(step.action, step.name) for batch in batches for step in batch]

    def file_of(self, name, file):
        return self.root / f"enclaves{name}" / file

    def allowed(self, name):
        """What its signed permissions let it publish and subscribe to."""
        signed = self.file_of(name, "permissions.p7s").read_bytes()
        [grant] = Permissions.from_xml(document_in(signed)).grants
        [rule] = grant.rules
        sides = (rule.publish, rule.subscribe)
        return [[topic for each in side for topic in each.topics] for side in sides]


def damage(path):
    """One bit in its middle is another."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
