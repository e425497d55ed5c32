from setuptools import setup

setup(
    name="tubeopt_ros",
    version="0.2.0",
    packages=["tubeopt_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/tubeopt_ros"]),
        ("share/tubeopt_ros", ["package.xml"]),
        ("share/tubeopt_ros/launch", ["launch/robot.launch.py"]),
        ("share/tubeopt_ros/config", ["config/robot.yaml", "config/robot.rviz"]),
    ],
    install_requires=["setuptools", "tubeopt"],
    entry_points={"console_scripts": ["robot = tubeopt_ros.node:main"]},
)
