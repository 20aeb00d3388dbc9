from setuptools import find_packages, setup

setup(
    name="fss_link",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_link": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_link"]),
        ("share/fss_link", ["package.xml"]),
    ],
    description="Sessions with electronics over an unreliable network: frames, arming, clocks.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
)
