"""pqsec explain --stock: what can be decrypted later because stock participants get keys."""

import pytest


@pytest.fixture
def k(pqsec):
    """A keystore with two sets: /old and /robot/new read what /talker writes, /old alone `own`."""
    pqsec("-k k ca init --profile classical,hybrid --no-passphrase").done()
    pqsec("-k k issue /talker --publish rt/chatter --publish rt/own --publish 'rt/log/*'").done()
    pqsec("-k k issue /old --subscribe rt/chatter --subscribe rt/own").done()
    pqsec("-k k issue /robot/new --subscribe rt/chatter --subscribe 'rt/log/*'").done()


LATER = (
    "later /talker: /chatter, domain 0, can be decrypted later for all readers (/old, /robot/new)"
)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("/talker --publish rt/chatter --stock /old", "stock /old gets the keys under ECDH"),
        ("/talker --publish rt/chatter --stock '/o*'", "stock /old gets the keys under ECDH"),
        (
            "/robot/new --subscribe rt/chatter --stock /old",
            "stock /old gets the keys under ECDH",
        ),
        (
            "/old --ros-subscribe /chatter --stock /talker",
            "stock senders give the keys under ECDH",
        ),
        (
            "/talker --publish rt/chatter --stock /old --stock '/robot/**'",
            "stock /old, /robot/new gets the keys under ECDH",
        ),
    ],
)
def test_a_topic_with_a_stock_participant_can_be_decrypted_later(pqsec, k, line, words):
    del k
    out = pqsec(f"-k k explain {line}").done().out
    assert out.splitlines()[-1] == f"{LATER}: {words}"


@pytest.mark.parametrize(
    "line",
    [
        "/talker --publish rt/chatter",
        "/talker --publish rt/own --stock /robot/new",
        "/talker --publish rt/log/x --stock /old",
        "/old --subscribe rt/own --stock /robot/new",
    ],
)
def test_a_topic_without_one_cannot(pqsec, k, line):
    del k
    done = pqsec(f"-k k explain {line} --json").done().json
    assert done["decryptable_later"] == []


def test_a_topic_that_only_a_pattern_covers_is_named_itself(pqsec, k):
    del k
    line = "-k k explain /talker --publish rt/log/x --stock /robot/new --json"
    [found] = pqsec(line).done().json["decryptable_later"]
    assert found == {
        "from": ["/talker"],
        "to": ["/robot/new"],
        "stock": ["/robot/new"],
        "domains": "0",
        "partitions": "",
        "topics": ["rt/log/x"],
    }


def test_several_participants_are_told_together(pqsec, k):
    del k
    found = pqsec("-k k explain '/**' --join --stock /old --json").done().json["decryptable_later"]
    assert [(each["from"], each["topics"]) for each in found] == [
        (["/talker"], ["rt/chatter"]),
        (["/talker"], ["rt/own"]),
    ]


def test_what_a_right_of_several_topics_opens_is_told(pqsec, k):
    del k
    pqsec("-k k issue /serves --ros-service /reset").done()
    pqsec("-k k issue /calls --ros-client /reset").done()
    told = pqsec("-k k explain /serves --ros-service /reset --stock /calls").done().out
    assert "later /serves: " in told
    assert "later /calls: " in told


def test_the_domain_that_is_asked_about_counts(pqsec, k):
    del k
    pqsec("-k k explain /talker --publish rt/chatter --stock /old --domain 0").done()
    denied = pqsec("-k k explain /talker --publish rt/chatter --stock /old --domain 5 --json")
    assert denied.json["decryptable_later"] == []


def test_a_name_of_nobody_opens_nothing_silently(pqsec, k):
    del k
    pqsec("-k k explain /talker --join --stock /odl").refused(3, "no participant /odl")


def test_stock_is_for_a_keystore_that_stock_stacks_can_use(pqsec, k):
    del k
    files = "--governance k/enclaves/governance.xml --permissions k/enclaves/old/permissions.xml"
    pqsec(f"explain {files} --join --stock /old").refused(2, "--stock is for a keystore")
    pqsec("-k pq ca init --profile pq,classical --no-passphrase").done()
    pqsec("-k pq issue /a /b --publish x").done()
    pqsec("-k pq explain /a --join --stock /b").refused(2, "no stock stack can have")
