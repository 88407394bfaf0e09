"""The files that travel in the wheel: example configurations."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

DEFAULT_CONFIG = "cell.sim.yaml"


def embedded_config(name: str = DEFAULT_CONFIG) -> str:
    """Return the text of a configuration of ``configs/``, installed or in a checkout; `FileNotFoundError` if none."""
    installed = files("srvs_cell") / "_data" / "configs" / name
    if installed.is_file():
        return installed.read_text(encoding="utf-8")
    return (Path(__file__).parents[2] / "configs" / name).read_text(encoding="utf-8")
