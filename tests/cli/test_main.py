from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import typer
from typer.core import TyperCommand

from srvs_cell import __version__
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import Command
from srvs_cell.cli import main, operate
from srvs_cell.cli.quick import QuickCommand


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
        "heavy = {'numpy', 'cv2', 'scipy', 'fastapi', 'yaml', 'rich', 'mujoco', 'pydantic', 'ssl', 'srvs_cell.cell'};"
        "print(code, sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1 []"
    assert "5006 NO_DAEMON" in done.stderr
    assert find_spec("numpy"), "the check means something only where numpy is installed"


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (["--path", "a/b"], Path("a/b")),
        ([], Path("default")),
        (["--number", "7"], 7),
        (["--word", "x"], "x"),
        (["--choice", "two"], "two"),
        (["--flag"], True),
    ],
)
def test_a_quick_command_passes_what_a_plain_one_passes(arguments: list[str], value: object) -> None:
    taken = []
    for cls in (TyperCommand, QuickCommand):
        app = typer.Typer()

        def work(
            path: Annotated[Path, typer.Option()] = Path("default"),
            number: Annotated[int, typer.Option(min=1, max=9)] = 3,
            word: Annotated[str | None, typer.Option()] = None,
            choice: Annotated[Literal["one", "two"], typer.Option()] = "one",
            flag: Annotated[bool, typer.Option("--flag")] = False,
        ) -> None:
            taken.append((path, number, word, choice, flag))

        app.command(cls=cls)(work)
        app(arguments, standalone_mode=False)
    assert taken[0] == taken[1]
    assert [type(one) for one in taken[0]] == [type(one) for one in taken[1]]
    assert value in taken[1]


@pytest.mark.parametrize("arguments", [["--limit", "0"], ["--limit", "x"], ["--limit"], ["--sock", "x"], ["extra"]])
def test_a_quick_command_refuses_what_a_plain_one_refuses(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    assert main.run(["alarms", *arguments]) == 2
    quick = capsys.readouterr().err
    monkeypatch.setattr(operate, "QuickCommand", TyperCommand)
    assert main.run(["alarms", *arguments]) == 2
    assert capsys.readouterr().err == quick


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "srvs_cell", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == __version__
