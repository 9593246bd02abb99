"""The JSON Schemas and the readers of the same files agree, about thousands of changed files.

Each file below has every key of its kind. One place of it is changed at a time: removed, given an
unknown key, or another value. What the reader takes, the schema must take. What the reader refuses,
the schema must refuse too, but for the reasons in READER_ONLY, which JSON Schema cannot state.
"""

import copy
import json
import re

import pytest
import yaml

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, pem
from pqsec_pki.documents import governance_from_yaml, permissions_from_yaml
from pqsec_pki.domain.reading import desired_in
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint.suppress import read_suppressions
from pqsec_pki.plugin.settings import SettingsFile
from pqsec_pki.server import read_settings
from tests.json_schemas import schema_of
from tests.longer import seeds
from tests.unit.keystores import NOW

TOPIC = "enable_discovery_protection: true, enable_liveliness_protection: false,"
FILES = {
    "check": [
        "ignore: [{rule: PQS224, path: enclaves/*, reason: a bench, until: '2027-06-30'}]",
    ],
    "plugin": [
        "{peers: stock, key_agreements: [x25519mlkem768], wire_versions: [2, 1], proofs: true}",
        "{stock: [/a, '/r/*'], sets: {classical: ../../../enclaves/a, hybrid: .}}",
    ],
    "serve": [
        """
        {url: 'https://a.example:8443', listen: ['127.0.0.1:8443', '[::1]:8443'],
        status: 'localhost:9180', keystore: k, domain: domain.yaml, state: state,
        tls: [{chain: a.pem, key: a.key}], classical: true, passphrase_file: p, front_user: www,
        factories: {acme: {cas: a.pem, revocation_lists: [a.crl, b.crl], again: true}, b: {cas: c}},
        approval: true, retry_seconds: 60, renew: due, renew_expired: 30d, token_validity: 7d,
        revocation_list: 26w, requests: waiting, proxy_from: [10.0.0.1, 'fd00::/8'],
        limits: {connections: 1,
        connections_of_address: 2, requests_of_address: 3, requests_of_label: 4, seconds: 5,
        body: 6, buffered: 7, waiting: 8}}
        """,
    ],
    "governance": [
        f"""
        {{preset: strict, domains: [0, 2-5, {{min: 7, max: 9}}, {{id: 300}}],
        allow_unauthenticated_participants: false, enable_join_access_control: true,
        discovery_protection_kind: ENCRYPT, liveliness_protection_kind: SIGN,
        rtps_protection_kind: SIGN_WITH_ORIGIN_AUTHENTICATION,
        topics: [{{topic: rt/map, {TOPIC} enable_read_access_control: true,
        enable_write_access_control: true, metadata_protection_kind: SIGN, data_protection_kind:
        ENCRYPT}}, {{ros_topic: /a}}, {{ros_service: /a/b}}, {{ros_action: /c}}, 'rt/x', '*']}}
        """,
        "{preset: migration, rules: [{domains: 1-2, topics: rt/a}, {domains: 5}]}",
    ],
    "permissions": [
        """
        domains: 0-3
        validity: {not_before: '2030-01-01T00:00:00Z', not_after: '2031-01-01T00:00:00+01:00'}
        grants:
        - name: /a
          domains: [1, 2]
          publish: [rt/a, {topics: [rt/b, rt/c], partitions: [p], data_tags: {colour: red}}]
          subscribe: rt/d
          relay: []
          default: DENY
          validity: 90d
          nodes:
          - talker
          - {node: planner, namespace: /robot1, publish: [~/a, /b], subscribe: c, services: [s],
            clients: [s], action_servers: [t], action_clients: [t], parameters_of: [/n],
            lifecycle_of: [/n], lifecycle: true, use_sim_time: true, minimum: false}
        - subject: CN=b
          rules: [{allow: {domains: 1, publish: x, nodes: y}}, {deny: {relay: {topics: z}}}]
        """,
    ],
    "domain": [
        """
        name: Fleet
        profile: pq
        domains: [0, 2-5]
        ca_validity: 10y
        validity: 1y
        renew_before: 30d
        governance: {preset: open-discovery, domains: 0-5, topics: [rt/a]}
        roles:
          robot: {publish: [rt$name/pose, {topics: a, partitions: p}], subscribe: b, relay: c,
            nodes: [$base, {node: d, publish: [e]}], default: DENY, domains: 0, validity: 90d}
          strict: {rules: [{deny: {publish: x}}, {allow: {subscribe: '*'}}], default: ALLOW}
        participants:
        - {name: ['/r{1..2}', /s], role: robot, domains: '0', validity: 26w, request: inbox/,
          values: {site: x}}
        - {list: names.txt, role: robot}
        - {csv: robots.csv}
        - {name: /ordered, role: robot, order: orders/}
        - {name: /own, publish: rt/a, idevid: 'acme:serialNumber=1'}
        groups: {hall: [/s, '/r*'], one: /s}
        approvals: {required: 1, of: {alice: a.pem, bob: b.pem}, for: [revoke, grow]}
        prune: true
        stacks: [cyclonedds, fastdds-3.1]
        migrate_from: transition
        """,
        "{governance: {file: g.yaml}}",
        """
        profile: [classical, hybrid, pq]
        participants: [{name: ['/r{1..2}', /s], publish: x}]
        stock: [/s, '/r*']
        """,
    ],
}
READER_ONLY = {
    "domain": "no participant of the file is|no such file|is a directory|there are no roles"
    "|role: '.*' is not allowed|approvals of 2 approvers are not possible",
    "permissions": "is not a full ROS 2 name",
    "plugin": "no key agreement named",
}
"""What is between two places of a file, in another file, or a name that a package may add; a
namespace, which is a placeholder in domain.yaml."""
MOST = 40
"""Changes of a file in the gate."""
OTHERS = [5, -1, True, "", "word", None, [], ["word"], {}, {"word": "word"}]


def read_check(data, path):
    """Refuses what `pqsec check` reports about its own file by PQS002 and PQS005."""
    path.write_bytes(data)
    entries, broken = read_suppressions(path)
    known = all(re.fullmatch("[A-Z]{2,8}[0-9]{3}", each.rule) for each in entries)
    if broken or not known or not all(each.reason for each in entries):
        raise PqsecError(str(broken))


def read_serve(data, path):
    path.write_bytes(data)
    read_settings(path)


def read_plugin(data, _path):
    settings = json.loads(data)
    text = "\n".join(f"{key} = {toml(each)}" for key, each in settings.items())
    SettingsFile.parsed(text.encode())


def toml(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(each)}" for key, each in value.items()) + "}"
    return json.dumps(value)


READERS = {
    "plugin": read_plugin,
    "check": read_check,
    "serve": read_serve,
    "governance": lambda data, _: governance_from_yaml(data),
    "permissions": lambda data, _: permissions_from_yaml(data, now=NOW),
    "domain": desired_in,
}


def places(value, path=()):
    yield path
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*path, key))


def changes(document):
    """Where, what, and the changed document."""
    for path in places(document):
        for other in OTHERS:
            yield path, other, changed(document, path, lambda _, other=other: other)
        if path:
            removed = changed(document, path[:-1], lambda at, key=path[-1]: without(at, key))
            yield path, "removed", removed
        yield path, "unknown", changed(document, path, unknown_in)


def changed(document, path, change):
    if not path:
        return change(copy.deepcopy(document))
    whole = copy.deepcopy(document)
    at = whole
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = change(at[path[-1]])
    return whole


def without(at, key):
    del at[key]
    return at


def unknown_in(at):
    return {**at, "unknown_key": "x"} if isinstance(at, dict) else at


def refusal(kind, document, folder):
    """Why the reader refuses the document; None if it takes it."""
    data = b"" if document is None else json.dumps(document).encode()  # which is YAML
    try:
        READERS[kind](data, folder / f"{kind}.yaml")
    except PqsecError as error:
        return str(error)
    return None


def is_toml(document):
    return isinstance(document, dict) and None not in document.values()


@pytest.fixture
def folder(tmp_path):
    """One with the files that the domain file names."""
    (tmp_path / "names.txt").write_text("/t\n")
    (tmp_path / "robots.csv").write_text("name,role\n/u,robot\n")
    (tmp_path / "g.yaml").write_text("{}")
    (tmp_path / "inbox").mkdir()
    for name in ("a", "b"):
        public = SIGNATURES.named("ecdsa-p256").generate().public_key
        (tmp_path / f"{name}.pem").write_bytes(pem("PUBLIC KEY", public.spki))
    return tmp_path


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("kind", FILES)
def test_the_schema_takes_what_the_reader_takes_and_nothing_else(kind, folder):
    schema = schema_of(kind)
    for text in FILES[kind]:
        document = yaml.safe_load(text)
        assert refusal(kind, document, folder) is None
        assert [each.message for each in schema.iter_errors(document)] == []
        every = [each for each in changes(document) if kind != "plugin" or is_toml(each[2])]
        for number in seeds(len(every), min(MOST, len(every))):
            where, what, other = every[number]
            refused, known = refusal(kind, other, folder), schema.is_valid(other)
            reason = refused and re.search(READER_ONLY.get(kind, "$."), refused)
            assert known == (refused is None) or (known and reason), (where, what, refused)


@pytest.mark.parametrize("kind", FILES)
def test_every_key_of_a_schema_is_in_a_file_above(kind):
    every = [text for texts in FILES.values() for text in texts]  # domain.yaml has parts of others
    found = {key for text in every for key in keys_in(yaml.safe_load(text))}
    assert set(keys_of(schema_of(kind).schema)) - found == set()


def keys_in(value):
    if isinstance(value, dict):
        yield from value
        value = list(value.values())
    for each in value if isinstance(value, list) else ():
        yield from keys_in(each)


def keys_of(schema):
    for word, part in schema.items() if isinstance(schema, dict) else enumerate(schema):
        if word == "properties":
            yield from part
        if isinstance(part, dict | list):
            yield from keys_of(part)


def test_the_schema_of_the_plugin_offers_every_key_agreement():
    names = schema_of("plugin").schema["properties"]["key_agreements"]["items"]
    offered, any_other = names["anyOf"]
    own = [*KEY_AGREEMENTS, *KEY_AGREEMENTS.experimental]
    assert offered["enum"] == [each.name for each in own]
    assert any_other == {"type": "string"}
