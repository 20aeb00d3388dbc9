from setuptools import find_packages, setup

setup(
    name="fss_rehearsal",
    version="0.2.0",
    packages=find_packages(),
    package_data={"fss_rehearsal": ["py.typed", "dataset/data_sheet.md"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fss_rehearsal"]),
        ("share/fss_rehearsal", ["package.xml"]),
    ],
    description="Rehearsals of the test bed: simulator, drivers and applications, judged.",
    url="https://fss-arm.example.org",
    maintainer="FSS Arm maintainers",
    maintainer_email="fss-arm@example.org",
    license="Apache-2.0",
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["campaign = fss_rehearsal.programs:campaign"]},
)
