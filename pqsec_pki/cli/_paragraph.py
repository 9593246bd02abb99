"""Wrap text to the width of a terminal, after a label."""

import re
from textwrap import wrap

WIDTH = 96
"""Characters in a line; more if one word or command is longer."""
_COMMAND = re.compile(r"`[^`]*`")


def paragraph(front: str, text: str) -> list[str]:
    """`front` and `text` as lines; following lines are indented by the width of `front`.

    Commands in backticks are never split, so that they can be copied.
    """
    whole = _COMMAND.sub(lambda command: command[0].replace(" ", "\0"), text)
    lines = wrap(
        whole,
        WIDTH,
        initial_indent=front,
        subsequent_indent=" " * len(front),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace("\0", " ") for line in lines]
