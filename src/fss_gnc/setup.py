from setuptools import find_packages, setup

setup(
    name="fss_gnc",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_gnc": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_gnc"]),
        ("share/fss_gnc", ["package.xml"]),
    ],
    description="Navigation and control of the floating base: pose and twist, wrenches by valves.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "control = fss_gnc.programs:control",
            "controller = fss_gnc.programs:controller",
            "guidance = fss_gnc.programs:guidance",
            "navigation = fss_gnc.programs:navigation",
        ],
    },
)
