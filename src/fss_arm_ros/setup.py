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
    description="What every node needs and no node owns: parameters, QoS, conversions.",
    license="Apache-2.0",
)
