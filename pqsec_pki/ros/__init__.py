"""pqsec inside ROS 2's own tools: `ros2 pqsec` (`command`), and actions of launch files (`launch`).

Only the Python of ROS 2 has what these two modules import, `ros2cli` and `launch`; entry points of
the package name them. `environment` needs neither.
"""

from pqsec_pki.ros.environment import secured_variables

__all__ = ["secured_variables"]
