"""Run one target under atheris: python -m tests.fuzz.fuzz TARGET CORPUS [libFuzzer's options].

Only pqsec_pki is instrumented; what its libraries do shows in what comes out of it. With a
file for CORPUS, that file is run and nothing else.
"""

import sys
from pathlib import Path
from random import Random

import atheris

with atheris.instrument_imports(include=["pqsec_pki"]):
    from tests.fuzz.targets import TARGETS


def main() -> None:
    program, name, corpus, *options = sys.argv
    target = TARGETS[name]
    seeds = target.seeds()
    if Path(corpus).is_dir():
        for number, seed in enumerate(seeds):
            (Path(corpus) / f"seed-{number}").write_bytes(seed)

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        rng = Random(seed)  # noqa: S311 -- reproducible, not secret

        def spoil(part: bytes) -> bytes:
            return bytes(atheris.Mutate(part, most))

        form = target.spoilt if rng.randint(0, 3) else lambda part, _, spoil: spoil(part)
        return form(data, rng, spoil)[:most]

    atheris.Setup([program, corpus, *options], target.run, custom_mutator=mutate)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
