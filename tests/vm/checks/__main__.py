"""All checks, in the guest, as root: ``python -m tests.vm.checks CELL_FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.vm.checks.report import Report, say
from tests.vm.checks.service import Service
from tests.vm.checks.usb import UsbCameraProcess, check_usb
from tests.vm.checks.vivid import check_vivid


def main(cell: Path) -> int:
    """Run every check; return the exit code.

    Args:
        cell: folder with what the simulated robot cell is like and where it listens.
    """
    report = Report()
    with UsbCameraProcess() as camera:
        service = Service(camera, cell)
        serves = service.check_start(report)
        check_vivid(report)
        check_usb(report, camera)
        if serves:
            service.check_work(report)
    say(f"{report.passed} checks passed, {report.failed} failed")
    return 0 if report.failed == 0 else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
