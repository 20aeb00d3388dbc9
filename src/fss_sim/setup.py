from setuptools import find_packages, setup

setup(
    name="fss_sim",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_sim": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_sim"]),
        ("share/fss_sim", ["package.xml"]),
    ],
    description="The free-floating test bed, simulated: plant, sensors, link electronics.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={
        "console_scripts": [
            "testbed = fss_sim.programs:testbed",
        ],
    },
)
