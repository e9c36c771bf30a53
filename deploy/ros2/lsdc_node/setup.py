from setuptools import setup

NAME = "lsdc_node"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/node.launch.py"]),
        (f"share/{NAME}/config", ["config/node.yaml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="Starts `lsdc node`",
    license="MIT OR Apache-2.0",
    entry_points={"console_scripts": ["node = lsdc_node.node:main"]},
)
