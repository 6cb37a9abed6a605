# SPDX-License-Identifier: MIT
"""Start the controller with a simulated arm: ros2 launch stiffgen_ros2 mock.launch.py."""

from pathlib import Path
from xml.etree import ElementTree

PACKAGE = "stiffgen_ros2"
URDF = "iiwa14.urdf"
JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6", "A7")
"""The robot's joints from base to tip."""


def description(path: Path) -> str:
    """Return the robot's URDF with a ros2_control element for the mock system."""
    robot = ElementTree.parse(path).getroot()
    for element in robot.findall("ros2_control"):
        robot.remove(element)
    control = ElementTree.SubElement(robot, "ros2_control", name="mock", type="system")
    hardware = ElementTree.SubElement(control, "hardware")
    ElementTree.SubElement(hardware, "plugin").text = f"{PACKAGE}/MockSystem"
    for name in JOINTS:
        joint = ElementTree.SubElement(control, "joint", name=name)
        ElementTree.SubElement(joint, "command_interface", name="effort")
        for kind in ("position", "velocity", "effort"):
            ElementTree.SubElement(joint, "state_interface", name=kind)
    return ElementTree.tostring(robot, encoding="unicode")


def generate_launch_description():
    """Return the nodes: state publisher, controller manager, and a spawner."""
    from ament_index_python.packages import get_package_share_directory
    from launch import LaunchDescription
    from launch_ros.actions import Node

    share = Path(get_package_share_directory(PACKAGE))
    robot = {"robot_description": description(share / "urdf" / URDF)}
    return LaunchDescription(
        [
            Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[robot]),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                parameters=[str(share / "config" / "controllers.yaml")],
                remappings=[("~/robot_description", "/robot_description")],
                output="screen",
            ),
            Node(
                package="controller_manager",
                executable="spawner",
                arguments=["joint_state_broadcaster", "stiffness_controller"],
            ),
        ]
    )
