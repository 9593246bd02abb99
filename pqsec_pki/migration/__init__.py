"""Plans the way of a keystore to a post-quantum profile, and rehearses it on a copy.

Either its profile is replaced, or sets of credentials of others are added beside it.

What works in each step is not written down: it is found by handshakes between participants of
the profiles and stacks in question. The keystore itself is only read.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.migration.additions import plan_addition
    from pqsec_pki.migration.deadlines import DEADLINES, Deadline
    from pqsec_pki.migration.domain_files import StepFile, step_files
    from pqsec_pki.migration.planning import plan_migration
    from pqsec_pki.migration.rehearsal import Rehearsal, rehearse, rehearse_addition
    from pqsec_pki.migration.steps import MigrationPlan, MigrationStep, StackNeeds
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "DEADLINES",
    "Deadline",
    "MigrationPlan",
    "MigrationStep",
    "Rehearsal",
    "StackNeeds",
    "StepFile",
    "plan_addition",
    "plan_migration",
    "rehearse",
    "rehearse_addition",
    "step_files",
]
