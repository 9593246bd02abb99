"""Actions for launch files: run nodes secured as a participant (examples/launch).

The enclave is a variable (ROS_SECURITY_ENCLAVE_OVERRIDE), not an argument: so it holds for every
process of a group, also for containers and for the nodes of included launch files.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Self

from pqsec_pki.errors import PqsecError
from pqsec_pki.ros.environment import missing, secured_variables
from pqsec_pki.vendors import ENCLAVE_OVERRIDE

try:
    from launch import LaunchContext
    from launch.action import Action
    from launch.actions import (
        GroupAction,
        OpaqueFunction,
        RegisterEventHandler,
        SetEnvironmentVariable,
        TimerAction,
    )
    from launch.frontend import expose_action
    from launch.utilities import normalize_to_list_of_substitutions, perform_substitutions
except ModuleNotFoundError as error:
    raise missing("launch", error) from error

_OF_THE_LOADER = "LD_"


@expose_action("secured_group")
class SecuredGroup(GroupAction):
    """Actions whose processes run secured, with the enclave of one participant.

    Their environment is that of `script`, a file that `pqsec export ros2` wrote; without one, what
    `pqsec export ros2` prints here, with `options`, such as "-k robots --plugin". If there is none,
    or it does not secure nodes, PqsecError ends the launch, and nothing of the group starts.
    """

    def __init__(
        self,
        enclave: Any,
        actions: Iterable[Action],
        *,
        script: Any = "",
        options: Any = "",
        **more: Any,
    ) -> None:
        actions = list(actions)
        for each in actions:
            _refuse_unsecured(each)
        self._words = {
            name: normalize_to_list_of_substitutions(value)
            for name, value in (("enclave", enclave), ("script", script), ("options", options))
        }
        super().__init__([OpaqueFunction(function=self._secure), *actions], scoped=True, **more)

    @classmethod
    def parse(cls, entity: Any, parser: Any) -> tuple[type[Self], dict[str, Any]]:
        """The arguments from a launch file in XML or YAML."""
        _, found = super().parse(entity, parser)
        for name in ("enclave", "script", "options"):
            if value := entity.get_attr(name, optional=name != "enclave"):
                found[name] = parser.parse_substitution(value)
        return cls, found

    def _secure(self, context: LaunchContext) -> list[Action]:
        words = {k: perform_substitutions(context, v) for k, v in self._words.items()}
        found = secured_variables(**words, present=context.environment)
        self._refuse_variables(found)
        return [SetEnvironmentVariable(name, value) for name, value in found.items()]

    def _refuse_variables(self, found: Mapping[str, str]) -> None:
        """PqsecError for variables that would come too late; none does for a new process."""


@expose_action("secured_launch_node")
class SecuredLaunchNode(SecuredGroup):
    """The node of the launch process itself, secured as a participant.

    It loads composed nodes and changes the states of lifecycle nodes. launch_ros starts it when it
    first needs it, in the environment of that moment; so this action must be before such nodes.
    """

    def __init__(self, enclave: Any, **more: Any) -> None:
        super().__init__(enclave, [OpaqueFunction(function=_start_node)], **more)

    @classmethod
    def parse(cls, entity: Any, parser: Any) -> tuple[type[Self], dict[str, Any]]:
        """The arguments from a launch file in XML or YAML."""
        _, found = super().parse(entity, parser)
        del found["actions"]
        return cls, found

    def _refuse_variables(self, found: Mapping[str, str]) -> None:
        if late := [name for name in found if name.startswith(_OF_THE_LOADER)]:
            raise PqsecError(
                f"{late[0]} is read when a process starts, and the launch process runs already",
                hint=f"set its script, and {ENCLAVE_OVERRIDE}, in the shell that runs `ros2 launch`"
                f", in place of {SecuredLaunchNode.__name__}",
            )


def _refuse_unsecured(action: Action) -> None:
    """ValueError for an action whose processes would not get the group's environment."""
    kind = type(action).__name__
    if isinstance(action, (RegisterEventHandler, TimerAction)):
        raise ValueError(  # noqa: TRY004 -- it is of the right type, in the wrong place
            f"{kind} starts nodes after the group, unsecured: put a {SecuredGroup.__name__} into it"
        )
    if getattr(action, "env", None) is not None:
        raise ValueError(f"{kind} with env gets no other variables: give it additional_env")


def _start_node(context: LaunchContext) -> None:
    from launch_ros.ros_adapters import get_ros_adapter  # noqa: PLC0415 -- not every launch has ROS

    get_ros_adapter(context)
