"""``srvs-cell plan PROBLEM.json``: plan the problems of a file (design.md section 9)."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer reads the annotation at run time
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from srvs_cell.planning import Problem
    from srvs_cell.scene import RelocationPlan


def register(app: typer.Typer) -> None:
    """Add the command to an app."""
    app.command("plan")(plan_command)


def plan_command(
    problem_file: Annotated[
        Path, typer.Argument(metavar="PROBLEM.json", help="A planning-problem/1 file: one problem, or many.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per problem on stdout.")] = False,
    explained: Annotated[
        bool, typer.Option("--explain", help="Say why so many moves, what each object does, and what would help.")
    ] = False,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", metavar="FILE.svg", help="Draw the plan; for a file of many problems the last one."),
    ] = None,
) -> None:
    """Plan a relocation with the fewest moves and the least travel; infeasible is an answer."""
    import json  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - as above
    from srvs_cell.planning import explain, has_plan, plan, plan_svg, plan_to_json, read_problems, validate  # noqa: PLC0415 - as above

    try:
        data = json.loads(problem_file.read_text(encoding="utf-8"))
    except OSError as error:
        raise AlarmError(Alarm.FILE_INVALID, f"{problem_file}: {error.strerror}.") from error
    except (ValueError, RecursionError) as error:
        raise AlarmError(Alarm.PROBLEM_INVALID, f"{problem_file}: not JSON: {error}.") from error
    for problem in read_problems(data, str(problem_file)):
        answer = plan(problem)
        refusal = validate(problem, answer.moves) if has_plan(answer) else []
        if refusal:
            raise AlarmError(Alarm.PLAN_INVALID, f"{problem_file}: {problem.id}: {'; '.join(refusal)}.")
        lines = explain(problem, answer) if explained else ()
        if as_json:
            told = {"explanation": list(lines)} if explained else {}
            typer.echo(json.dumps(plan_to_json(problem, answer) | told))
        else:
            _show(problem, answer)
            for line in lines:
                typer.echo(f"  {line}")
        if picture is not None:
            try:
                picture.write_text(plan_svg(problem, answer.moves, problem.id), encoding="utf-8")
            except OSError as error:
                raise AlarmError(Alarm.FILE_INVALID, f"{picture}: {error.strerror}.") from error


def _show(problem: Problem, answer: RelocationPlan) -> None:
    """Print a plan for people."""
    from srvs_cell.planning import has_plan  # noqa: PLC0415 - the command line starts lazily
    from srvs_cell.scene import PlanStatus  # noqa: PLC0415 - as above

    headline = f"{problem.id}: {answer.status.value.replace('_', ' ')}"
    if has_plan(answer):
        headline += f", {len(answer.moves)} moves, {answer.travel_mm:.1f} mm of travel"
    if answer.status is PlanStatus.NOT_PROVEN:
        headline += f" (at least {answer.bound_moves} moves, {answer.bound_travel_mm:.1f} mm)"
    typer.echo(headline)
    for number, move in enumerate(answer.moves, start=1):
        origin, target = problem.places[move.from_place], problem.places[move.to_place]
        typer.echo(
            f"  {number:2d}. {problem.objects[move.object].name}: "
            f"{origin.kind.value} {origin.id} ({origin.x_mm:.1f}, {origin.y_mm:.1f}) -> "
            f"{target.kind.value} {target.id} ({target.x_mm:.1f}, {target.y_mm:.1f})"
        )
    for reason in answer.reasons:
        typer.echo(f"  {reason}")
