from setuptools import find_packages, setup

setup(
    name="fss_arm_bags",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_arm_bags": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_arm_bags"]),
        ("share/fss_arm_bags", ["package.xml"]),
    ],
    description="Bags: reading, recording, replaying and repairing them.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "record = fss_arm_bags.programs:record",
            "replay = fss_arm_bags.programs:replay",
            "doctor = fss_arm_bags.programs:doctor",
        ],
    },
)
