"""Package definition for colcon and pip."""

from pathlib import Path

from setuptools import setup

NODES = ("pose_estimator", "image_publisher", "mission_bridge", "fix_bridge", "visualizer")

setup(
    name="expmap_ros",
    version="1.0.0",
    description="ROS 2 nodes of Experience Map",
    license="MIT",
    packages=["expmap_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/expmap_ros"]),
        ("share/expmap_ros", ["package.xml"]),
        ("share/expmap_ros/launch", [str(path) for path in sorted(Path("launch").glob("*.launch.xml"))]),
    ],
    python_requires=">=3.11",
    install_requires=["numpy"],
    entry_points={"console_scripts": [f"{node} = expmap_ros.{node}:main" for node in NODES]},
)
