"""pqsec agent: the process that holds the keys of participants that use the plugin."""

import os
import signal

import click

from pqsec_pki._files import is_there, read
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import ExistsError, FileError
from pqsec_pki.plugin import AgentFolder, Status, agent_status, stop_agent

_NOBODY = "no agent runs; the first participant that uses the plugin starts one"


@click.group()
def agent() -> None:
    """Look after the agent, which holds the keys for the plugin.

    One agent serves all participants of a user. The first that uses the plugin starts it,
    and it ends when nobody has needed it for five minutes.
    """


@agent.command("status")
@_settings.command_options
def status() -> int:
    """Tell whether an agent runs, and for whom. Exit code 1 if none does."""
    found = agent_status(_place())
    if found is None:
        _printing.emit({"running": False}, [_NOBODY])
        return 1
    value = {
        "running": True,
        "process": found.process,
        "agent_version": found.version,
        "socket": found.socket,
        "connections": list(found.connections),
    }
    _printing.emit(value, _lines(found))
    return 0


@agent.command("stop")
@_settings.command_options
def stop() -> None:
    """Let the agent end.

    Participants that are matched go on exchanging data; for new ones another agent
    starts. A participant that was made before can meet nobody new, and learns of no
    revocation: make it again.
    """
    stopped = stop_agent(_place())
    _printing.emit({"stopped": stopped}, ["stopped" if stopped else _NOBODY])


@agent.command("log")
@_settings.command_options
def log() -> None:
    """Print what the agent wrote: whom it refused, and why."""
    place = _place()
    path = place.log
    if not place.is_there() or not is_there(path):
        raise FileError(f"there is no log at {path}", hint=_NOBODY)
    lines = read(path).decode(errors="replace").splitlines()
    _printing.emit({"lines": lines}, lines)


@agent.command("run")
@_settings.command_options
def run() -> None:
    """Run the agent here, until it is interrupted; its log goes to stderr.

    For systemd and containers. It does not end when it is idle. At a socket that systemd
    listens at, it goes on where that is (`pqsec plugin install --systemd`).
    """
    from pqsec_pki.plugin import listening  # noqa: PLC0415 -- only here
    from pqsec_pki.plugin.server import Agent  # noqa: PLC0415 -- likewise

    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # a host that goes does not end it
    os.umask(0o077)
    place = _place()
    given = listening.given(os.environ, place)
    if not Agent(place, float("inf"), _settings.now, _printing.note).run(given=given):
        raise ExistsError(f"an agent listens at {place.socket} already", hint="pqsec agent stop")


def _place() -> AgentFolder:
    return AgentFolder.of(os.environ)


def _lines(found: Status) -> list[str]:
    heads = [
        f"process   {found.process}",
        f"version   {found.version}",
        f"socket    {found.socket}",
    ]
    rows = [(each["process"], each["plugin"], str(each["objects"])) for each in found.connections]
    return heads + (["", *_printing.table(("HOST", "PLUGIN", "OBJECTS"), rows)] if rows else [])
