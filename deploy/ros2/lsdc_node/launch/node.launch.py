"""ros2 launch lsdc_node node.launch.py params:=robot.yaml"""

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    usual = get_package_share_directory("lsdc_node") + "/config/node.yaml"
    return LaunchDescription([
        DeclareLaunchArgument("params", default_value=usual, description="Parameters of the node"),
        # The node joins by DDS itself, and is started again if it ends.
        Node(package="lsdc_node", executable="node", name="lsdc", output="screen", respawn=True,
             parameters=[LaunchConfiguration("params")]),
    ])
