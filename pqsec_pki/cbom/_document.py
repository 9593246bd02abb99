"""Assets as a CycloneDX 1.7 document in JSON, the same bytes for the same assets."""

import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.component_evidence import ComponentEvidence, Occurrence
from cyclonedx.output import make_outputter
from cyclonedx.schema import OutputFormat, SchemaVersion

from pqsec_pki import __version__
from pqsec_pki.cbom._assets import Asset, Assets

_SUBJECT = "subject"
"""The bom-ref of what the bill is about."""
_AT_ONCE = 100
"""Components in one call of the library, whose time grows with the square of their number."""
_PREFIX = "pqsec:"
"""The prefix of properties that CycloneDX does not define."""


def written(assets: Assets, subject: str, timestamp: datetime | None) -> str:
    """The document about `subject`. Its serial number is derived from all but `timestamp`."""
    document = _as_json(_head(subject))
    del document["metadata"]["timestamp"], document["serialNumber"]
    every = list(assets)
    document["components"] = [
        component
        for start in range(0, len(every), _AT_ONCE)
        for component in _as_json(Bom(components=map(_component, every[start : start + _AT_ONCE])))[
            "components"
        ]
    ]
    document["dependencies"] = [
        {"ref": _SUBJECT, "dependsOn": [each.ref for each in every]},
        *({"ref": each.ref, "dependsOn": list(each.needs)} for each in every),
    ]
    _add_fields(document, {each.ref: each.added for each in every})
    document = _in_order(document)
    content = json.dumps(document, sort_keys=True)
    document["serialNumber"] = uuid5(NAMESPACE_URL, content).urn
    if timestamp is not None:
        document["metadata"]["timestamp"] = timestamp.isoformat()
    return json.dumps(document, indent=2, sort_keys=True) + "\n"


def _as_json(bom: Bom) -> dict[str, Any]:
    text = make_outputter(bom, OutputFormat.JSON, SchemaVersion.V1_7).output_as_string()
    parsed: dict[str, Any] = json.loads(text)
    return parsed


def _head(subject: str) -> Bom:
    bom = Bom()
    bom.metadata.component = Component(name=subject, type=ComponentType.DATA, bom_ref=_SUBJECT)
    bom.metadata.tools.components.add(
        Component(name="pqsec", version=__version__, type=ComponentType.APPLICATION)
    )
    return bom


def _component(asset: Asset) -> Component:
    hashes = [HashType(alg=HashAlgorithm.SHA_256, content=asset.sha256)] if asset.sha256 else []
    places = [Occurrence(location=place) for place in sorted(asset.places)]
    return Component(
        name=asset.name,
        type=ComponentType.CRYPTOGRAPHIC_ASSET,
        bom_ref=asset.ref,
        hashes=hashes,
        crypto_properties=asset.crypto,
        properties=[Property(name=_PREFIX + name, value=value) for name, value in asset.details],
        evidence=ComponentEvidence(occurrences=places) if places else None,
    )


def _add_fields(document: dict[str, Any], added: Mapping[str, Mapping[str, Any]]) -> None:
    """Add the fields of 1.7 that cyclonedx-python-lib does not have yet, by bom-ref."""
    kinds = {"algorithm": "algorithmProperties", "certificate": "certificateProperties"}
    for component in document["components"]:
        if fields := added[component["bom-ref"]]:
            crypto = component["cryptoProperties"]
            crypto[kinds[crypto["assetType"]]].update(fields)


def _in_order(value: Any) -> Any:
    """`value` with all lists sorted: none has an order that means something, or a stable one."""
    if isinstance(value, dict):
        return {key: _in_order(each) for key, each in value.items()}
    if isinstance(value, list):
        return sorted(map(_in_order, value), key=lambda each: json.dumps(each, sort_keys=True))
    return value
