"""The program `pqsec`, also as `python -m pqsec_pki`."""

import atexit
import gc

# Most commands end before a collection finds anything. Importing alone would cause dozens of them;
# those of a report of 2,000 participants took 6 % of it, and left it as large.
gc.set_threshold(1_000_000)
atexit.register(gc.freeze)  # what is there at the end is not searched for garbage

from pqsec_pki.cli import main  # noqa: E402 -- after that

if __name__ == "__main__":
    main()
