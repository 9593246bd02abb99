"""Texts in the form in which pqsec writes most permissions."""

import re

from pqsec_pki.documents._plain import BETWEEN, HEAD, TAIL

SHORT = re.compile(re.escape(HEAD) + re.sub(rb"\)\+", b"){1,3}", BETWEEN.pattern) + re.escape(TAIL))
"""With at most three domains, and topics for publishing and for subscribing."""
