"""The robot and its description; with rviz:=true a window.

ros2 launch tubeopt_ros robot.launch.py robot:=thesis_ctr
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

import tubeopt
from tubeopt.control.c_library import robot_description

SHARE = Path(get_package_share_directory("tubeopt_ros"))
ARGUMENTS = {
    "robot": ("thesis_ctr", "name or YAML file of the robot"),
    "params": (str(SHARE / "config" / "robot.yaml"), "parameter file"),
    "namespace": ("", "namespace of the topics"),
    "autostart": ("true", "configure and activate the node at once"),
    "rviz": ("false", "start RViz"),
}


def nodes(context):
    """The nodes, once the arguments are known."""
    at = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    own = {"robot": at["robot"], "autostart": at["autostart"].lower() == "true"}
    description = {"robot_description": robot_description(tubeopt.load_robot(at["robot"]))}
    place = {"namespace": at["namespace"], "output": "screen"}
    return [
        Node(package="tubeopt_ros", executable="robot", name="tubeopt_robot", parameters=[at["params"], own], **place),
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            parameters=[description],
            remappings=[("joint_states", "measured_js")],
            **place,
        ),
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(SHARE / "config" / "robot.rviz")],
            condition=IfCondition(at["rviz"]),
            **place,
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` starts."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
