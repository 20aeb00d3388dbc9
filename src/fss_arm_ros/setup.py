from setuptools import find_packages, setup

setup(
    name="fss_arm_ros",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_ros": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_ros"]),
        ("share/fss_arm_ros", ["package.xml"]),
    ],
    description="What every node needs and no node owns: parameters, QoS, conversions.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
