from setuptools import find_packages, setup

setup(
    name="fss_arm_driver",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_driver": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_driver"]),
        ("share/fss_arm_driver", ["package.xml"]),
    ],
    description="The link's wire protocol, its transports, and the nodes that drive the arm.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "link = fss_arm_driver.programs:link",
            "arm = fss_arm_driver.programs:arm",
            "driver = fss_arm_driver.programs:driver",
            "check = fss_arm_driver.check:main",
            "urdf = fss_arm_driver.urdf_command:main",
        ],
    },
)
