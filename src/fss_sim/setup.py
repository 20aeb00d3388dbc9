from setuptools import find_packages, setup

setup(
    name="fss_sim",
    version="0.1.0",
    packages=find_packages(),
    package_data={"fss_sim": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_sim"]),
        ("share/fss_sim", ["package.xml"]),
    ],
    description="The free-floating test bed, simulated: plant, sensors, link electronics.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "testbed = fss_sim.testbed_node:main",
        ],
    },
)
