"""Participant specs in a sign request: values for JSON, with the policy in its own file."""

from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from pqsec_pki.certificates import common_name
from pqsec_pki.documents import DomainSet, Permissions
from pqsec_pki.enrolment.bundle import flat_name
from pqsec_pki.keystore import regular_name
from pqsec_pki.lifecycle import ParticipantSpec


def spec_value(spec: ParticipantSpec) -> dict[str, Any]:
    """The spec as JSON values; its grants, if any, are in the file `policy_file` names."""
    return {
        "name": spec.name,
        "domains": str(spec.domains),
        "publish": list(spec.publish),
        "subscribe": list(spec.subscribe),
        "validity_hours": spec.validity // timedelta(hours=1),
    }


def read_spec(value: Mapping[str, Any], files: Mapping[str, bytes]) -> ParticipantSpec:
    """The spec in `value`; the grants of its policy are in one of `files`.

    KeyError, TypeError, ValueError, AttributeError, OverflowError or PqsecError if it is
    not valid.
    """
    name = str(value["name"])
    if regular_name(name) != name:
        raise ValueError(f"{name!r} is not a participant's name")
    common_name(name)  # refuses names that do not fit into a certificate
    policy = files.get(policy_file(name))
    return ParticipantSpec(
        name=name,
        domains=DomainSet.parse(str(value["domains"])),
        publish=_texts(value["publish"]),
        subscribe=_texts(value["subscribe"]),
        validity=timedelta(hours=int(value["validity_hours"])),
        grants=Permissions.from_xml(policy).grants if policy else (),
    )


def policy_file(name: str) -> str:
    """The file name of the grants of a policy."""
    return f"policies/{flat_name(name)}.xml"


def _texts(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise TypeError(f"{value!r} is not a list")
    return tuple(map(str, value))
