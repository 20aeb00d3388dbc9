from setuptools import find_packages, setup

setup(
    name="fss_base_driver",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_base_driver": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_base_driver"]),
        ("share/fss_base_driver", ["package.xml"]),
    ],
    description="The base's hardware: its board's valves and gyro, motion capture to poses.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "base = fss_base_driver.programs:base",
            "check = fss_base_driver.programs:check",
            "fog = fss_base_driver.programs:fog",
            "mocap = fss_base_driver.programs:mocap",
            "subjects = fss_base_driver.programs:subjects",
        ],
    },
)
