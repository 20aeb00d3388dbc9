from setuptools import setup

setup(
    name="fss_arm_ros",
    version="0.1.0",
    packages=["fss_arm_ros"],
    package_data={"fss_arm_ros": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_ros"]),
        ("share/fss_arm_ros", ["package.xml"]),
    ],
    description="What every node needs and no node owns: settings, QoS, conversions, bags.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "record = fss_arm_ros.record_node:main",
            "replay = fss_arm_ros.replay_node:main",
            "doctor = fss_arm_ros.doctor:main",
        ],
    },
)
