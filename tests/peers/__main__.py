"""Print the table "wire, what judged it, result": ``make wire-peers``, or ``python -m tests.peers [FOLDER]``.

FOLDER takes the peers' environments. Ends with 1 where a judgement fails, with 0 where peers could not be had.
"""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from tests.peers import karel, modbus, rmi, robotiq
from tests.peers.bench import Judgement, SkippedError

if TYPE_CHECKING:
    from collections.abc import Callable


def main() -> int:
    """Run every judgement."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".benchmarks/wire-peers").resolve()
    judges: tuple[tuple[str, str, Callable[[], Judgement]], ...] = (
        ("Modbus TCP, controller double", "Debian mbpoll", modbus.mbpoll),
        ("Modbus TCP, driver", "npm modbus-serial", lambda: modbus.modbus_serial(folder / "node")),
        ("RMI, controller double", "PyPI fanuc-rmi", lambda: rmi.fanuc_rmi(folder)),
        ("RMI, driver", "PyPI airo-fanuc", lambda: rmi.airo_fanuc(folder)),
        (karel.WIRE, "PyPI fanex", lambda: karel.fanex(folder)),
        (robotiq.WIRE, "PyPI robotiq2f", lambda: robotiq.robotiq2f(folder)),
        (robotiq.WIRE, "Debian mbpoll", robotiq.mbpoll),
    )
    failed = False
    sys.stdout.write("| wire | what judged it | result |\n|---|---|---|\n")
    for wire, peer, judge in judges:
        try:
            row = judge()
        except SkippedError as error:
            row = Judgement(wire, peer, f"not judged: {error}", None)
        except Exception:  # noqa: BLE001 - one peer's failure does not hide the others' results
            traceback.print_exc()
            row = Judgement(wire, peer, "FAILED, see above", passed=False)
        failed = failed or row.passed is False
        sys.stdout.write(f"| {row.wire} | {row.peer} | {row.result} |\n")
        sys.stdout.flush()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
