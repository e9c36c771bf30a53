"""`lsdc node` with the arguments of ROS 2: `ros2 run lsdc_node node --ros-args --params-file robot.yaml`."""

import os
import shutil
import sys


def arguments(given):
    """The arguments of `lsdc node` for those of a node of ROS 2."""
    ours, given = [], list(given)
    while given:
        argument = given.pop(0)
        if argument in ("--ros-args", "--"):
            continue
        if argument == "--params-file" and given:
            ours += ["--params-file", given.pop(0)]
        elif argument in ("-r", "--remap") and given:
            name, _, value = given.pop(0).partition(":=")
            if name == "__node":
                ours += ["--name", value]
            elif name != "__ns" or value != "/":
                sys.exit(f"`{name}:={value}` is not supported: name topics by parameters, `image`, `points` and others")
        elif argument in ("-p", "--param") and given:
            name, _, value = given.pop(0).partition(":=")
            option = "--" + name.replace("_", "-")
            if value != "false":
                ours += [option] if value == "true" else [option, value]
        else:
            ours.append(argument)
    return ours


def main():
    program = os.environ.get("LSDC") or shutil.which("lsdc")
    if program is None:
        sys.exit("the program `lsdc` is not in PATH: install it, or set LSDC to its place")
    os.execv(program, [program, "node", *arguments(sys.argv[1:])])


if __name__ == "__main__":
    main()
