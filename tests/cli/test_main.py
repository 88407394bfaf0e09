from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import pytest
import typer

from srvs_cell import __version__
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import Command
from srvs_cell.cli import main, operate


def run_with(monkeypatch: pytest.MonkeyPatch, work: Any, *arguments: str) -> int:
    """Run the command line with a table of one command, ``work``."""

    class Module:
        @staticmethod
        def register(app: typer.Typer) -> None:
            app.command("work")(work)

    monkeypatch.setattr(main, "MODULES", {"work": "a.module"})
    monkeypatch.setattr(main, "import_module", lambda _: Module)
    return main.run(list(arguments or ["work"]))


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (AlarmError(Alarm.GRIP_EMPTY, "At place 3."), 1),
        (AlarmError(Alarm.NO_DAEMON, "No socket."), 1),
        (AlarmError(Alarm.CONFIG_INVALID, "cell.yaml: speed = -1."), 2),
        (AlarmError(Alarm.DRIVER_UNKNOWN, "No driver."), 2),
    ],
)
def test_alarm_is_told_with_cause_and_remedy(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: AlarmError, code: int
) -> None:
    def work() -> None:
        raise error

    assert run_with(monkeypatch, work) == code
    out, err = capsys.readouterr()
    assert out == ""
    row = error.alarm.value
    for part in (str(row.code), error.detail, row.cause, row.remedy):
        assert part in err


def test_done_is_zero_and_interrupted_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    assert run_with(monkeypatch, lambda: None) == 0
    assert run_with(monkeypatch, interrupted) == 130


@pytest.mark.parametrize("arguments", [("work", "--nonsense"), ("no-such-command",), ("--nonsense",)])
def test_misuse_is_two(monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]) -> None:
    assert run_with(monkeypatch, lambda: None, *arguments) == 2


def test_version_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_with(monkeypatch, lambda: None, "--version") == 0
    assert capsys.readouterr().out == f"{__version__}\n"


def test_every_module_of_the_table_has_its_commands() -> None:
    for command, module in main.MODULES.items():
        app = typer.Typer()
        app.callback()(lambda: None)
        import_module(module).register(app)
        names = set(typer.main.get_group(app).commands)
        assert command in names, f"{module} does not register {command!r}"
        assert names <= set(main.MODULES), f"{module} registers a command that the table does not name"


def test_operators_commands_are_the_packml_commands() -> None:
    assert set(operate.COMMANDS) == {command.title for command in Command}


def test_status_imports_nothing_heavy() -> None:
    program = (
        "import sys; from srvs_cell.cli.main import run; code = run(['status', '--socket', '/nonexistent/api.sock']);"
        "heavy = {'numpy', 'cv2', 'scipy', 'fastapi', 'yaml', 'rich', 'mujoco', 'srvs_cell.cell'};"
        "print(code, sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1 []"
    assert "5006 NO_DAEMON" in done.stderr
    assert find_spec("numpy"), "the check means something only where numpy is installed"
