"""Drive a gripper with PyPI's robotiq2f; runs in the peers' environment, not in ours.

Usage: robotiq_client.py PORT. Prints one JSON line: what the client made of every step.
"""

import json
import sys
import time

from robotiq2f import robotiq2f  # type: ignore[import-not-found]

SETTLED_S = 1.0
WAIT_S = 1.0


def main() -> None:
    port = sys.argv[1]
    robotiq2f.LinuxFindTTYWithSerialNumber.find = lambda *_: port  # it would look for a USB converter
    gripper = robotiq2f.Robotiq2F85("double", async_control=False)
    gripper.client.serial.timeout = WAIT_S
    found = {"reset": gripper.is_reset}
    gripper.deactivate()
    gripper.activate()
    found["activated"] = gripper.is_activated
    for name, opening_mm in (("closed", 0.0), ("open", 85.0)):
        gripper.go_to(opening_mm, 150.0, 50.0)
        time.sleep(SETTLED_S)
        status = gripper.read_status()
        found[name] = {"detected": status.obj_detected, "opening_mm": status.opening, "moving": status.moving}
    found["fault"] = gripper.in_fault
    gripper.close()
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
