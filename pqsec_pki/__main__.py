"""The program `pqsec`, also as `python -m pqsec_pki`."""

import gc

# Most commands end before a collection finds anything; importing alone would cause dozens of them.
gc.set_threshold(100_000)

from pqsec_pki.cli import main  # noqa: E402 -- after that

if __name__ == "__main__":
    main()
