"""All checks, in the guest, as root: ``python -m tests.vm.checks CELL_FOLDER``.

Python takes half a minute to start the service on an emulated processor: meanwhile the driver is checked.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.vm.checks.report import Report, say
from tests.vm.checks.service import Service
from tests.vm.checks.usb import DEVICE, UsbCameraProcess, check_usb
from tests.vm.checks.vivid import check_vivid


def main(cell: Path) -> int:
    """Run every check; return the exit code.

    Args:
        cell: folder with what the simulated robot cell is like and where it listens.
    """
    report = Report()
    with UsbCameraProcess() as camera:
        service = Service(camera, cell)
        report.check("service: systemd-analyze verify", service.verify)
        report.check("service: starting on a machine that has never seen a camera", service.begin_start)
        check_vivid(report)  # while the service comes up
        serves = service.check_start(report)
        report.check("usb: plugged in, found by id", lambda: f"{DEVICE.name} after {camera.plug():.1f} s")
        if serves:
            service.check_work(report)
        report.check("service: starting with a wrong config", service.begin_wrong_start)
        check_usb(report, camera)  # while the service does not hold it
        report.check("service: wrong config is not tried again", service.wrong_start)
    say(f"{report.passed} checks passed, {report.failed} failed")
    return 0 if report.failed == 0 else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
