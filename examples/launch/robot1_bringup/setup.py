"""What `colcon build` installs: the launch files, and the scripts of `pqsec export ros2`."""

from pathlib import Path

from setuptools import setup

NAME = "robot1_bringup"
SHARE = Path("share", NAME)
FOLDERS = {path.parent for kind in ("launch/*", "pqsec/**/ros2.sh") for path in Path().glob(kind)}

setup(
    name=NAME,
    version="1.0.0",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (str(SHARE), ["package.xml"]),
        *((str(SHARE / each), [str(p) for p in each.iterdir()]) for each in FOLDERS),
    ],
    zip_safe=True,
)
