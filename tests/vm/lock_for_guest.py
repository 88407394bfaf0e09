"""Print what a requirements file locks for the guest's Python: pip applies markers to the Python that it runs in.

``lock_for_guest.py 3.11 requirements.txt``
"""

import re
import sys
from pathlib import Path

from packaging.requirements import Requirement


def lock_for(python: str, text: str) -> str:
    """Return the entries of a locked requirements file that apply to ``python`` on Linux, without their markers."""
    environment = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": "linux"}
    kept = []
    for entry in re.split(r"\n(?=\w)", text):
        head, *hashes = (part.strip() for part in entry.split("\\\n"))
        if head and not head.startswith("#"):
            requirement = Requirement(head)
            if requirement.marker is None or requirement.marker.evaluate(environment):
                kept.append(" \\\n    ".join([f"{requirement.name}{requirement.specifier}", *hashes]))
    return "\n".join(kept) + "\n"


if __name__ == "__main__":
    sys.stdout.write(lock_for(sys.argv[1], Path(sys.argv[2]).read_text(encoding="utf-8")))
