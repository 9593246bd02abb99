"""`python -m pqsec_pki` is `pqsec`."""

from pqsec_pki.cli import main

main()
