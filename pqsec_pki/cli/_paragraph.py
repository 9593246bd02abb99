"""Text in lines that fit a terminal, behind what it is about."""

import re
from textwrap import wrap

WIDTH = 96
"""Characters of a line, where no word or command is longer."""
_COMMAND = re.compile(r"`[^`]*`")


def paragraph(front: str, text: str) -> list[str]:
    """`front`, then `text`: lines below each other that break no command in two.

    Commands stand in backticks; they are there to be copied.
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
