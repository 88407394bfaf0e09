"""Serve PyPI airo-fanuc's fake controller until stdin ends; runs in the peers' environment.

Usage: rmi_server.py STARTUP_PORT SESSION_PORT
"""

import sys

from airo_fanuc.testing import FakeCRXController  # type: ignore[import-not-found]


def main() -> None:
    startup, session = map(int, sys.argv[1:])
    FakeCRXController(rmi_bootstrap_port=startup, rmi_redirect_port=session).start()
    sys.stdout.write("listening\n")
    sys.stdout.flush()
    sys.stdin.read()


if __name__ == "__main__":
    main()
