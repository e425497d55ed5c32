from setuptools import setup

setup(
    name="tubeopt_ros",
    version="0.1.0",
    packages=["tubeopt_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/tubeopt_ros"]),
        ("share/tubeopt_ros", ["package.xml"]),
    ],
    install_requires=["setuptools", "tubeopt"],
    entry_points={"console_scripts": ["robot = tubeopt_ros.node:main"]},
)
