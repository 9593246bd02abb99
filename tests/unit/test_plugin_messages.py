"""What the table of messages knows of pqsec's plugin is what the plugin says."""

import re
from itertools import chain
from pathlib import Path

import pytest

import pqsec_pki
from pqsec_pki.vendors.messages import messages, recognise

ROOT = Path(pqsec_pki.__file__).parent
ROOMS = ("plugin", "handshake", "certificates", "smime")
OURS = [row for row in messages("cyclonedds") if row.evidence.endswith("the plugin")]
BY_OTHERS = re.compile(r"pqsec: |permissions\.p7s: |pqsec\.toml: ")
"""What stands before the words: the library puts it there, or the error's place."""


def said() -> str:
    """All that stands in the sources, with strings that go on in the next line in one."""
    files = chain.from_iterable((ROOT / room).rglob("*.[cp]*") for room in ROOMS)
    text = "\n".join(path.read_text() for path in files if path.suffix in {".c", ".py"})
    return re.sub(r'"\s*f?"', "", text)


def test_the_table_knows_the_plugin():
    assert len(OURS) >= 10


@pytest.mark.parametrize("text", [text for row in OURS for text in row.texts])
def test_the_words_of_a_message_stand_in_the_source(text):
    pieces = [piece for piece in re.split(r"\{\w+\}|'", BY_OTHERS.sub("", text)) if piece]
    source = said()
    assert [piece for piece in pieces if piece not in source] == []


@pytest.mark.parametrize(
    ("log", "best"),
    [
        (
            "reply failed: pqsec: the peer asks for 'MLKEM1024'; allowed here: MLKEM768(code: 200)",
            "the peer asks for 'MLKEM1024'; allowed here: MLKEM768",
        ),
        (
            "local permission: pqsec: the certificate of CN=/a expired on 2026-11-01(code: 200)",
            "the certificate of CN=/a expired on",
        ),
        (
            "pqsec: the agent does not answer within 1000 ms; `pqsec agent log` may show why",
            "the agent does not answer within 1000 ms",
        ),
        (
            "pqsec: the agent is gone (Connection reset by peer); `pqsec agent log` may show why",
            "the agent is gone (",
        ),
    ],
)
def test_a_message_of_the_plugin_comes_before_what_cyclone_makes_of_it(log, best):
    assert recognise(log)[0].said == f"pqsec: {best}"
