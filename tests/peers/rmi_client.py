"""Drive a controller with PyPI's fanuc-rmi; runs in the peers' environment, not in ours.

Usage: rmi_client.py STARTUP_PORT MAIN_PORT. Prints one JSON line: what was read; the client prints replies above it.
"""

import json
import sys
import tempfile
from pathlib import Path

from fanuc_rmi import RobotClient  # type: ignore[import-not-found]

HOME = {"X": 500.0, "Y": 0.0, "Z": 400.0, "W": 180.0, "P": 0.0, "R": 0.0}


def main() -> None:
    startup, session = map(int, sys.argv[1:])
    robot = RobotClient("127.0.0.1", startup_port=startup, main_port=session, socket_timeout=20.0, reader_timeout=20.0)
    robot.connect()
    robot.initialize(uframe=1, utool=1)
    frames = robot.get_uframe_utool()
    robot.speed_override(50)
    robot.linear_absolute({**HOME, "X": 520.0}, 200, sequence_id=1, uframe=1, utool=1)
    robot.linear_relative({**dict.fromkeys(HOME, 0.0), "Z": -10.0}, 200, sequence_id=2, uframe=1, utool=1)
    robot.wait_time(0.1, sequence_id=3)
    written = robot.write_dout(5, "ON")
    read = robot.read_din(1)
    with tempfile.TemporaryDirectory() as folder:
        place = robot.read_cartesian_coordinates(str(Path(folder) / "pose.jsonl"))
        joints = robot.read_joint_coordinates(str(Path(folder) / "joints.jsonl"))["JointAngle"]
    robot.joint_relative({**dict.fromkeys(joints, 0.0), "J3": 5.0}, 20, sequence_id=4)
    robot.joint_absolute(joints, 20, sequence_id=5)
    aborted = robot.abort()
    robot.close()
    found = {"frames": frames, "written": written, "read": read, "place": place, "joints": joints, "aborted": aborted}
    sys.stdout.write("\n" + json.dumps(found, default=str) + "\n")


if __name__ == "__main__":
    main()
