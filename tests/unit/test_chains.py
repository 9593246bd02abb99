"""Chains and lists of other tools: pqsec gives the verdict of every stack."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.certificates import (
    Certificate,
    RevocationList,
    verify_chain,
    verify_not_revoked,
)
from pqsec_pki.errors import PqsecError
from tests.unit.chains import CASES


def takes(case):
    now = datetime.now(UTC)
    try:
        ca, leaf = map(Certificate.from_der, (case.ca, case.leaf))
        verify_chain(leaf, ca, now=now)
        if case.crl:
            verify_not_revoked(leaf, RevocationList.from_der(case.crl), ca, now=now)
    except PqsecError as error:
        print(error)
        return False
    return True


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_chain_is_judged_as_every_stack_judges_it(case):
    assert takes(case) == case.accepted
