"""The other two goal rules through the whole cell: the paper's last sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivers.sim.doubles import Block
from srvs_cell.cell import Command
from srvs_cell.planning import PlanningParameters
from tests.cell.support import Cell, build, connected, running

if TYPE_CHECKING:
    from pathlib import Path


def _cell(tmp_path: Path, blocks: list[Block], rule: str, settings: dict[str, Any]) -> Cell:
    return build(tmp_path, blocks, planning=PlanningParameters(rule=rule, rule_settings=settings))


def _places(cell: Cell) -> dict[str, tuple[float, float]]:
    return {block.name: (round(block.x_mm, 1), round(block.y_mm, 1)) for block in cell.world.blocks}


async def _job(cell: Cell) -> list[Any]:
    """Do a job to its end; return its plan."""
    await cell.reaches("Complete", "Held", "Aborted", "Stopped")
    assert (cell.state, cell.alarms) == ("Complete", [])
    plan: list[Any] = cell.unit.snapshot()["plan"]
    return plan


async def test_displaced_parts_are_put_back_on_their_taught_places(tmp_path: Path) -> None:
    blocks = [Block("right", 300.0, -120.0, 40.0), Block("off", 330.0, 15.0, 40.0), Block("far", 420.0, 120.0, 50.0)]
    places = [{"kind": "cuboid", "x_mm": 300.0, "y_mm": y_mm} for y_mm in (-120.0, 0.0, 120.0)]
    async with running(_cell(tmp_path, blocks, "position_correction", {"places": places, "tolerance_mm": 3.0})) as cell:
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 2
        assert _places(cell) == {"right": (300.0, -120.0), "off": (300.0, 0.0), "far": (300.0, 120.0)}


async def test_a_wrong_part_goes_to_the_bin_and_a_right_one_takes_its_place(tmp_path: Path) -> None:
    blocks = [Block("good", 300.0, -120.0, 40.0), Block("low", 300.0, 0.0, 20.0), Block("spare", 500.0, 200.0, 40.0)]
    settings = {
        "height_mm": [30.0, 100.0],
        "bin_mm": [100.0, 0.0],
        "stock_mm": [[500.0, 200.0]],
        "substitute_kind": "cuboid",
    }
    async with running(_cell(tmp_path, blocks, "element_change", settings)) as cell:
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 2
        assert _places(cell) == {"good": (300.0, -120.0), "low": (100.0, 0.0), "spare": (300.0, 0.0)}
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        await cell.give(Command.START)
        assert await _job(cell) == []


async def test_what_fell_into_the_bin_is_not_looked_for(tmp_path: Path) -> None:
    blocks = [Block("low", 300.0, 0.0, 20.0), Block("spare", 500.0, 200.0, 40.0)]
    settings = {
        "height_mm": [30.0, 100.0],
        "bin_mm": [100.0, 0.0],
        "stock_mm": [[500.0, 200.0]],
        "substitute_kind": "cuboid",
    }
    cell = _cell(tmp_path, blocks, "element_change", settings)
    release = cell.world.release

    def into_the_bin() -> None:
        release()
        cell.world.blocks = [block for block in cell.world.blocks if block.x_mm > 150.0]

    cell.world.release = into_the_bin  # type: ignore[method-assign]
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 2
        assert _places(cell) == {"spare": (300.0, 0.0)}


def _yaws(cell: Cell) -> dict[str, float]:
    return {block.name: round(block.yaw_deg % 180.0, 1) for block in cell.world.blocks}


async def test_parts_are_turned_to_the_yaw_of_their_taught_places(tmp_path: Path) -> None:
    blocks = [
        Block("turned", 300.0, -120.0, 40.0, yaw_deg=35.0),
        Block("off", 330.0, 15.0, 40.0, yaw_deg=170.0),
        Block("right", 300.0, 120.0, 50.0, yaw_deg=2.0),
    ]
    places = [{"kind": "cuboid", "x_mm": 300.0, "y_mm": y_mm, "yaw_deg": 0.0} for y_mm in (-120.0, 0.0, 120.0)]
    async with running(_cell(tmp_path, blocks, "position_correction", {"places": places, "tolerance_mm": 3.0})) as cell:
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 2
        assert _places(cell) == {"turned": (300.0, -120.0), "off": (300.0, 0.0), "right": (300.0, 120.0)}
        assert _yaws(cell) == {"turned": 0.0, "off": 0.0, "right": 2.0}
        detail = cell.unit.snapshot()["plan_detail"]
        assert sorted(move["turn_deg"] for move in detail["moves"]) == [-35.0, 10.0]


async def test_parts_in_order_of_height_stand_at_the_rules_yaw(tmp_path: Path) -> None:
    blocks = [
        Block("low", 300.0, 120.0, 30.0, yaw_deg=20.0),
        Block("middle", 300.0, 0.0, 45.0, yaw_deg=75.0),
        Block("tall", 300.0, -120.0, 60.0, yaw_deg=91.0),
    ]
    async with running(_cell(tmp_path, blocks, "height_order", {"yaw_deg": 90.0})) as cell:
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 4
        assert _places(cell) == {"low": (300.0, -120.0), "middle": (300.0, 0.0), "tall": (300.0, 120.0)}
        assert _yaws(cell) == {"low": 90.0, "middle": 90.0, "tall": 90.0}


async def test_a_substitute_is_put_down_at_the_yaw_of_the_places(tmp_path: Path) -> None:
    blocks = [Block("low", 300.0, 0.0, 20.0), Block("spare", 500.0, 200.0, 40.0, yaw_deg=30.0)]
    settings = {
        "height_mm": [30.0, 100.0],
        "bin_mm": [100.0, 0.0],
        "stock_mm": [[500.0, 200.0]],
        "substitute_kind": "cuboid",
        "place_yaw_deg": 60.0,
        "bin_yaw_deg": 45.0,
    }
    async with running(_cell(tmp_path, blocks, "element_change", settings)) as cell:
        await connected(cell)
        await cell.start()
        assert len(await _job(cell)) == 2
        assert _yaws(cell) == {"low": 45.0, "spare": 60.0}


async def test_a_part_that_was_not_turned_is_noticed_and_turned_then(tmp_path: Path) -> None:
    blocks = [Block("turned", 300.0, 0.0, 40.0, yaw_deg=40.0)]
    places = [{"kind": "cuboid", "x_mm": 300.0, "y_mm": 0.0, "yaw_deg": 0.0}]
    cell = _cell(tmp_path, blocks, "position_correction", {"places": places})
    release = cell.world.release
    releases = []

    def slipped_once() -> None:
        release()
        releases.append(blocks[0].yaw_deg)
        if len(releases) == 1:
            blocks[0].yaw_deg = 30.0

    cell.world.release = slipped_once  # type: ignore[method-assign]
    async with running(cell):
        await connected(cell)
        await cell.start()
        await cell.reaches("Complete", "Held", "Aborted", "Stopped")
        assert (cell.state, cell.alarms) == ("Complete", ["SCENE_CHANGED"])
        assert "turned by 30 deg" in cell.unit.snapshot()["alarms"][0]["detail"]
        assert len(releases) == 2
        assert _yaws(cell) == {"turned": 0.0}
