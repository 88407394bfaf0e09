"""The documents tell the truth: generated pages are current, links lead somewhere, commands exist and work."""

import importlib.util
import json
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import cv2
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli import main
from tests.planning.problems import wire_problem
from tests.vision.pictures import render, square

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]

_spec = importlib.util.spec_from_file_location("docs_generate", ROOT / "docs" / "generate.py")
assert _spec is not None
assert _spec.loader is not None
generate = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(generate)


@pytest.mark.parametrize("name", sorted(generate.PAGES))
def test_generated_pages_are_current(name: str) -> None:
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == generate.PAGES[name](), "run python docs/generate.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert not missing


# -- the shell commands of README, tutorial and how-to ----------------------------------------------------------------

SHELL_PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("tutorial/*.md")),
    *sorted((ROOT / "docs").glob("how-to/*.md")),
]
PROGRAM = "srvs-cell"
ENDLESS = {
    "run": "srvs_cell.service.daemon.run_daemon",
    "sim": "srvs_cell.cli.sim.start_simulator",
    "demo": "srvs_cell.cli.demo_run.run_demo",
}
"""Commands that are only begun here, and the function at which they are stopped; tests/system goes on from there."""
WITHOUT_CELL = frozenset({"perceive", "plan", "config", "calibrate"})


@dataclass(frozen=True)
class Documented:
    """A command line of a page: in a block of shell, or between two backticks."""

    page: Path
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page.name}: {shlex.join(self.words)}"


def documented() -> list[Documented]:
    found: list[Documented] = []
    for page in SHELL_PAGES:
        text = page.read_text(encoding="utf-8")
        lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
        inline = [code for code in re.findall(r"`([^`\n]+)`", text) if code.startswith((f"{PROGRAM} ", "make "))]
        for line in lines + inline:
            command = Documented(page, tuple(shlex.split(line, comments=True)))
            if command.words and command not in found:
                found.append(command)
    return found


DOCUMENTED = documented()
OURS = [command for command in DOCUMENTED if Path(command.words[0]).name == PROGRAM]


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The present folder, with what the pages' commands name: a checkout's files, a demo's images, a problem."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    (tmp_path / "my-cell").mkdir()
    for config in ("cell.yaml", "my-cell/cell.yaml"):
        (tmp_path / config).write_bytes((ROOT / "configs" / "cell.sim.yaml").read_bytes())
    pictures = tmp_path / "srvs-cell-demo" / "state" / "runs" / "000001"
    pictures.mkdir(parents=True)
    pair = render([square(80.0, 60.0, 50.0, 160.0, 28.4), square(150.0, 110.0, 40.0, 120.0, 26.0)])
    for name, image in zip(("left", "right"), pair, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
        cv2.imwrite(str(pictures / f"{name}_0.png"), image)
    (tmp_path / "problem.json").write_text(json.dumps(wire_problem()), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", OURS, ids=str)
def test_documented_commands_work(
    command: Documented, checkout: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = list(command.words[1:])
    if words[0] in ENDLESS:

        def reached(*_: object, **__: object) -> NoReturn:
            raise AlarmError(Alarm.SIMULATION_FAILED, "here the test ends.")

        monkeypatch.setattr(ENDLESS[words[0]], reached)
        assert main.run(words) == 1, capsys.readouterr().err
        assert "here the test ends" in capsys.readouterr().err
    elif words[0] in WITHOUT_CELL:
        assert main.run(words) == 0, capsys.readouterr().err
        assert capsys.readouterr().out
        named = [words[words.index(option) + 1] for option in ("--overlay", "--disparity") if option in words]
        assert all((checkout / name).stat().st_size for name in named)
    elif words[0] == "doctor":  # the cell of these pages is simulated, and its simulator does not run here
        assert main.run(words) == 1
        printed = capsys.readouterr()
        assert "checks failed" in printed.err
        assert "CLOCK_LOST" in printed.out
    else:  # an operator's command: known and well-formed, and here is no cell that it could move
        assert main.run([*words, "--socket", str(checkout / "none.sock")]) == 1, capsys.readouterr().err
        assert "5006 NO_DAEMON" in capsys.readouterr().err


def test_the_pages_show_the_commands_that_an_operator_needs() -> None:
    shown = {command.words[1] for command in OURS}
    assert {"status", "clear", "reset", "start", "hold", "unhold", "stop", "abort", "resolve", "alarms"} <= shown


def test_documented_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    wanted = {target for command in DOCUMENTED if command.words[0] == "make" for target in command.words[1:]}
    assert {"demo", "test"} <= wanted <= targets


def test_files_of_the_checkout_that_commands_name_exist() -> None:
    pattern = re.compile(r"(configs|systemd)/.+|requirements.*\.txt")
    named = {word for command in DOCUMENTED for word in command.words if pattern.fullmatch(word)}
    assert {"requirements.txt", "systemd/srvs-cell.service"} <= named
    assert not [name for name in named if not (ROOT / name).is_file()]
