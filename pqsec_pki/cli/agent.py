"""pqsec agent: control the process that holds the keys of participants with the plugin."""

import os

from pqsec_pki._files import is_there, read
from pqsec_pki.cli import _help, _output, _printing, _progress, _settings
from pqsec_pki.errors import ExistsError, FileError
from pqsec_pki.plugin import AgentFolder, AgentStatus, agent_status, retired_agents, stop_agent

_NOT_RUNNING = "no agent runs: the first participant that uses the plugin starts one"


@_help.group()
def agent() -> None:
    """Control the agent, which holds the keys for the plugin.

    One agent serves all participants of a user. The first participant that uses the plugin
    starts it. It keeps running until it is stopped or pqsec is installed again.
    """


@agent.command(
    "status",
    examples={
        "Show the processes that use the agent": "pqsec agent status",
    },
    exit_codes={
        0: "an agent runs",
        1: "no agent runs",
        3: "the agent cannot be asked",
    },
)
@_settings.command_options
def status() -> int:
    """Show whether the plugin's agent runs, and which processes use it.

    Older agents, which serve no new processes, as after an update, follow while processes use them.
    """
    folder = _agent_folder()
    found, retired = agent_status(folder), retired_agents(folder)
    lines = _lines(found) if found else [_NOT_RUNNING]
    for each in retired:
        lines += ["", *_lines(each)]
    own = found.to_json() if found else {}
    _printing.emit({"running": found is not None, **own, "retired": retired}, lines)
    return 0 if found else 1


@agent.command(
    "stop",
    examples={
        "Stop the agent": "pqsec agent stop",
    },
    exit_codes={
        0: "stopped, or no agent was running",
        3: "the agent cannot be asked",
    },
)
@_settings.command_options
def stop() -> None:
    """Stop the agent, and older agents that processes still use.

    Matched participants continue to exchange data. New participants start a new agent. A
    participant that was created earlier cannot authenticate new peers and is not informed
    of revocations: restart it.
    """
    # It does not ask, as `revoke` does: it destroys nothing, and a new agent starts by itself.
    stopped = stop_agent(_agent_folder())
    _printing.emit({"stopped": stopped}, ["stopped" if stopped else _NOT_RUNNING])


@agent.command(
    "log",
    examples={
        "Show why the agent refused a process": "pqsec agent log",
    },
    exit_codes={
        0: "the log is printed",
        3: "there is no log",
    },
)
@_settings.command_options
def log() -> None:
    """Print which processes the agent refused, and why."""
    folder = _agent_folder()
    path = folder.log
    if not folder.is_there() or not is_there(path):
        raise FileError(f"there is no log at {path}", hint=_NOT_RUNNING)
    lines = read(path).decode(errors="replace").splitlines()
    _printing.emit({"lines": lines}, lines)


@agent.command(
    "run",
    examples={
        "Run the agent in this terminal, until Ctrl-C": "pqsec agent run",
    },
    exit_codes={
        0: "the agent was stopped",
        3: "another agent runs, or the socket cannot be created",
    },
)
@_settings.command_options
def run() -> None:
    """Run the agent in the foreground, for systemd and containers.

    It runs until it is interrupted, also when idle, and logs to stderr. It uses the socket
    that systemd passes, if there is one (`pqsec plugin install --systemd`).
    """
    from pqsec_pki.plugin import listening  # noqa: PLC0415 -- only here
    from pqsec_pki.plugin.server import Agent  # noqa: PLC0415 -- only here

    _progress.stop()
    _output.stay()
    os.umask(0o077)
    folder = _agent_folder()
    sockets = listening.given(os.environ, folder)
    if not Agent(folder, float("inf"), _settings.now, _printing.note).run(given=sockets):
        raise ExistsError(
            f"an agent already listens at {folder.socket}", hint="stop it: pqsec agent stop"
        )


def _agent_folder() -> AgentFolder:
    return AgentFolder.of(os.environ)


def _lines(found: AgentStatus) -> list[str]:
    lines = [
        f"process   {found.process}",
        f"workers   {' '.join(map(str, found.workers)) or 'none: no host is connected'}",
        f"version   {found.version}",
        f"socket    {found.socket}",
        *([f"notice    {found.notice}"] if found.notice else []),
    ]
    rows = [(each["process"], each["plugin"], str(each["objects"])) for each in found.connections]
    return lines + (["", *_printing.table(("HOST", "PLUGIN", "OBJECTS"), rows)] if rows else [])
