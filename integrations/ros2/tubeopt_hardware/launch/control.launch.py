"""The controllers of a robot: ros2 launch tubeopt_hardware control.launch.py"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("tubeopt_hardware"))


def generate_launch_description() -> LaunchDescription:
    """Controller manager, description and two controllers."""
    description = {"robot_description": (SHARE / "tubeopt_robot.urdf").read_text()}
    manager = {"package": "controller_manager", "output": "screen"}
    controllers = str(SHARE / "config" / "controllers.yaml")
    return LaunchDescription(
        [
            Node(executable="ros2_control_node", parameters=[description, controllers], **manager),
            Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[description]),
            Node(executable="spawner", arguments=["joint_state_broadcaster"], **manager),
            Node(executable="spawner", arguments=["positions"], **manager),
        ]
    )
