"""May a participant join a domain?"""

from datetime import datetime

from pqsec_pki.access.decision import Decision, no, yes
from pqsec_pki.documents import (
    DefaultAction,
    DomainRule,
    Governance,
    Grant,
    Permissions,
    Subject,
    parse_subject,
    same_subject,
)
from pqsec_pki.errors import MalformedError, UsageError


def may_join(
    governance: Governance, permissions: Permissions, subject: str, domain: int, now: datetime
) -> Decision:
    """Whether the others on `domain` will have the participant with this certificate subject.

    This is what a peer asks, validate_remote_permissions and check_remote_participant
    (DDS-Security 1.1, table 63). The participant's own check_create_participant also
    passes if any topic rule has read or write access open; its peers then still refuse
    it, so that counts as no here.

    An allow_rule for the domain suffices, even one without topics. Where there is none,
    the default of the grant decides, as in Cyclone DDS and OpenDDS (OMG issue
    DDSSEC12-85); Fast DDS refuses then, and for its own participant wants an
    allow_rule even without join access control.

    MalformedError if `subject` is not a name, UsageError if `now` has no time zone.
    """
    if now.utcoffset() is None:
        raise UsageError(f"the time {now} has no time zone")
    # validate_remote_permissions, 1: a governance rule for the domain (9.4.1.2.7).
    rule = governance.rule_for(domain)
    if rule is None:
        return no(f"no governance rule names domain {domain}")
    # 2: a grant for the subject (9.4.1.3.2.1).
    grant = _grant_for(permissions, parse_subject(subject))
    if grant is None:
        return no(f"no grant is for {subject}")
    # 3: the grant is in force (9.4.1.3.2.2).
    if now < grant.not_before:
        return no(f"grant '{grant.name}' starts at {grant.not_before}", grant)
    if now > grant.not_after:
        return no(f"grant '{grant.name}' ended at {grant.not_after}", grant)
    return _check_remote_participant(rule, grant, domain)


def _check_remote_participant(rule: DomainRule, grant: Grant, domain: int) -> Decision:
    # 1: is_access_protected is false.
    if not rule.enable_join_access_control:
        return yes(f"join access control is off on domain {domain}", rule)
    # 2, the plugin names in the permissions tokens, is for the handshake to compare.
    # 3: the grant has an allow rule for the domain.
    for candidate in grant.rules:
        if candidate.allow and domain in candidate.domains:
            return yes(f"grant '{grant.name}' has an allow_rule for domain {domain}", candidate)
    # 4: otherwise no, but for the default.
    if grant.default is DefaultAction.ALLOW:
        return yes(f"the default of grant '{grant.name}' is ALLOW", grant)
    return no(f"grant '{grant.name}' has no allow_rule for domain {domain}", grant)


def _grant_for(permissions: Permissions, wanted: Subject) -> Grant | None:
    """The grant for that subject. Each should have one; of several the first counts.

    So in Cyclone DDS and OpenDDS; Fast DDS takes the first that is in force.
    """
    return next((grant for grant in permissions.grants if _is_for(grant, wanted)), None)


def _is_for(grant: Grant, wanted: Subject) -> bool:
    try:
        return same_subject(parse_subject(grant.subject_name), wanted)
    except MalformedError:
        return False  # what is no name names nobody
