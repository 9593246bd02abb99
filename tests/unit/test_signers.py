"""Whoever looks for the signer of a document finds the one that OpenSSL finds."""

import pytest

from pqsec_pki.cbom._material import Issuers
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint.signed import is_by
from pqsec_pki.smime import signers_in
from tests.unit import signers
from tests.unit.chains import ca, common


def listed(case):
    try:
        [found] = signers_in(case.message).signers
    except PqsecError:
        return None
    return found


@pytest.mark.parametrize("case", signers.CASES, ids=str)
def test_rules_find_the_signer_that_openssl_finds(case):
    found = listed(case)
    assert (found is not None and is_by(found, Certificate.from_der(case.ca))) == case.accepted


@pytest.mark.parametrize("case", signers.CASES, ids=str)
def test_a_bill_of_materials_has_the_signer_that_openssl_finds(case):
    found, known = listed(case), Issuers([Certificate.from_der(case.ca)])
    assert (found is not None and known.of(found) is not None) == case.accepted


def test_a_bill_of_materials_finds_an_issuer_in_another_case():
    known = Issuers([Certificate.from_der(ca())])
    assert known.named(common("IDENTITY  ca"))
    assert known.named(common("Identity CB")) is None
