"""A handshake, both sides, against the primitives it cannot do without, in the same run.

Every message passes as bytes, and every peer is read and checked as if never met before.
The floor is the raw calls of `cryptography` for a key agreement (to generate, encapsulate
and decapsulate; for Diffie-Hellman twice to generate and exchange), for two signatures
and their verification, and for the verification of both certificates (twice each, where
they have two signatures): all keys loaded, no encoding, nothing else. The last column counts
as floor also the library's calls for what is on the wire: keys written and read, certificates
out of base64, digests. Classical P-256 and RSA also run against Cyclone DDS's own plugin,
both sides, if it is installed.

The two take turns, in CPU time of the thread. Machines are shared, and who shares the caches
costs Python more than it costs the primitives: of the times the lower quartile counts.
ML-DSA signs in a random number of tries: of its signatures the mean counts, the same for
both. The margin is two standard errors, from BLOCKS parts of the run.
Run: python bench/handshake.py [--seconds 3] [--all] [--json FILE] [WORDS...]
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from suites import NOW, YEAR, floor, handshake, participants, suites, target, wire
from tries import Spent

from pqsec_pki.algorithms import KEY_AGREEMENTS, profile_named
from pqsec_pki.benchmark import HandshakeSuite
from pqsec_pki.documents import DomainSet
from pqsec_pki.handshake import Identity, adjusted_guid
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue

BLOCKS = 20
CHECKOUT = Path(__file__).parents[1]
CYCLONE_TARGET = 0.9


@dataclass(frozen=True)
class Compared:
    """Times are in milliseconds; `margin` is two standard errors of `ratio`.

    `wire` is the ratio where the calls for what is on the wire count as floor too.
    """

    name: str
    pqsec: float
    other: float
    ratio: float
    margin: float
    rounds: int
    target: float | None
    wire: float | None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only suites whose name has all of these")
    parser.add_argument("--seconds", type=float, default=3, help="for each suite")
    parser.add_argument("--all", action="store_true", help="every key with every key agreement")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there too")
    options = parser.parse_args()
    chosen = [
        suite
        for suite in suites(everything=options.all)
        if all(word in str(suite) for word in options.words)
    ]
    print(__doc__.split("Run:")[0])
    print(f"{'suite':<52} {'ms':>7} {'floor':>7} {'over':>6}  x floor           x floor and wire")
    floors = [shown(against_floor(suite, options.seconds)) for suite in chosen]
    print(f"\n{'against Cyclone DDS':<52} {'ms':>7} {'its ms':>7} {'':>6}  x its")
    peers = [shown(each) for each in against_cyclone(options.seconds)]
    if options.json:
        report = {"floor": floors, "cyclone": peers}
        text = json.dumps({k: [asdict(each) for each in v] for k, v in report.items()}, indent=1)
        options.json.write_text(text + "\n")


def shown(found: Compared) -> Compared:
    over = found.pqsec - found.other
    wire = f"  {found.wire:4.2f}" if found.wire else ""
    target = f"  target <= {found.target}" if found.target else ""
    print(
        f"{found.name:<52} {found.pqsec:7.3f} {found.other:7.3f} {over:6.3f}"
        f"  {found.ratio:4.2f} ± {found.margin:4.2f}{target}{wire}",
        flush=True,
    )
    return found


def against_floor(suite: HandshakeSuite, seconds: float) -> Compared:
    both = participants(suite)
    ours = handshake(both.initiator, both.responder, suite.agreement)
    return compare(str(suite), [ours, floor(suite), wire(suite)], seconds, target(suite))


def against_cyclone(seconds: float) -> Iterator[Compared]:
    sys.path.append(str(CHECKOUT))
    try:
        from cyclone import find_plugins
    except ImportError as error:
        print(f"SKIPPED: the tests' side of Cyclone DDS cannot be imported ({error})")
        return
    plugins = find_plugins()
    if plugins is None:
        print("SKIPPED: its plugins are not on this machine: apt-get install libddsc0debian")
        return
    for key, most in (("ecdsa-p256", CYCLONE_TARGET), ("rsa-2048", None)):
        with tempfile.TemporaryDirectory() as folder:
            yield _against_cyclone(plugins, Path(folder), key, seconds, most)


def _against_cyclone(
    plugins: Path, folder: Path, key: str, seconds: float, target: float | None
) -> Compared:
    from cyclone import both_sides

    names = ("/bench/alice", "/bench/bob")
    keystore = enrol(folder / "keystore", key, names)
    one, other = (identity(keystore, name) for name in names)
    ours = handshake(one, other, KEY_AGREEMENTS.named("ecdh-p256"))
    folders = [keystore.root / f"enclaves{name}" for name in names]
    with both_sides(plugins, *folders) as theirs:
        return compare(f"{key}, ecdh-p256", [ours, theirs], seconds, target)


def enrol(root: Path, key: str, names: tuple[str, ...]) -> Keystore:
    """A keystore with participants of these names, whose files Cyclone DDS can read."""
    keys = dict.fromkeys(("identity_key", "permissions_key", "participant_key"), key)
    profile = profile_named("classical").changed(keys)
    domains, validity = DomainSet.of(0), 10 * YEAR
    keystore = Keystore.create(
        root, profile, name="Bench", domains=domains, validity=validity, passphrase=None, now=NOW
    )
    may = {"publish": ("rt/chatter",), "subscribe": ("rt/cmd",), "domains": domains}
    specs = [ParticipantSpec(name=name, validity=YEAR, **may) for name in names]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    return keystore


def identity(keystore: Keystore, name: str) -> Identity:
    found = keystore.participant(name)
    return Identity(
        certificate=found.certificate,
        key=found.key,
        ca=found.identity_ca,
        guid=adjusted_guid(found.certificate.subject_der, bytes(16)),
        permissions=found.permissions,
    )


def compare(
    name: str, sides: list[Callable[[], Spent]], seconds: float, target: float | None
) -> Compared:
    """Ours, theirs, and what the wire needs if given, in turn until `seconds` are over."""
    for side in sides * 3:
        side()
    taken, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end or len(taken) < 2 * BLOCKS:
        taken.append([side() for side in sides])
    one, other, *needed = typical(taken)
    parts = [typical(taken[start::BLOCKS])[:2] for start in range(BLOCKS)]
    margin = 2 * statistics.stdev(one / other for one, other in parts) / BLOCKS**0.5
    over_wire = one / (other + needed[0]) if needed else None
    times = 1000 * one, 1000 * other, one / other
    return Compared(name, *times, margin, len(taken), target, over_wire)


def typical(taken: list[list[Spent]]) -> list[float]:
    """Seconds of each side, undisturbed; of the first two with ML-DSA's tries averaged."""
    tries = statistics.fmean(each.tries for sides in taken for each in sides[:2])
    rest = [
        statistics.quantiles((each.rest for each in side), n=4)[0]
        for side in zip(*taken, strict=True)
    ]
    return [tries + rest[0], tries + rest[1], *rest[2:]]


if __name__ == "__main__":
    main()
