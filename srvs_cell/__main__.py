"""``python -m srvs_cell``: the command line where its script is not on the path."""

from srvs_cell.cli.main import main

if __name__ == "__main__":
    main()
