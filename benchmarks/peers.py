"""Our planes beside OpenCV's matchers and CNES' pandora, on the Middlebury 2001 pairs, in one process, on one thread.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 .benchmarks/peers/bin/python -m benchmarks.peers [DATA] [--tune]

`make bench-peers` makes the environment that has opencv-contrib and pandora, and runs this so. Scores are defined in
`benchmarks/stereo_truth.py`. Pairs are sawtooth, venus and poster; every matcher has one setting for all three.

How the peers are tuned (``--tune`` repeats it): every setting of the grids below is run on the very pairs that are
scored, and for each peer two are kept: the one of the least mean bad-1.0 and the one of the least mean rms per plane.
Peers get the left border padded, so that the full width is matched. Holes that a peer leaves by its own checks are
counted as bad; settings that switch the checks off are in the grids. SGBM+WLS is matched left to right and right to
left and filtered with the left colour picture for its guide. Our own setting is the
default one with `dense.enabled`; what that step alone uses (superpixels' size, smoothness, the votes along borders, the
least share of a surface, the roughness) was chosen on these pairs too, among about a hundred settings.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import itertools
import json
import logging
import os
import statistics
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from benchmarks.stereo_truth import MAX_DISPARITY_PX, SETS, Score, StereoPair, read_pair, score
from srvs_cell.vision import VisionParameters, perceive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Disparity = NDArray[np.float32]
    Setting = dict[str, Any]
    Matcher = Callable[[Image, Image, Setting], Disparity]

SUBPIXELS = 16.0
RMS_AIM_PX = 0.10
RMS_BEHIND_PX = 0.02
_PANDORA_INVALID = 0b0000_0011_1100_0111
"""The bits of pandora's validity mask that make a pixel invalid."""
MODES = {"sgbm": cv2.STEREO_SGBM_MODE_SGBM, "hh": cv2.STEREO_SGBM_MODE_HH, "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY}
_CHANNELS = 3


@dataclass(frozen=True)
class Peer:
    """A matcher, the settings that are tried, and those that were found best on the three pairs."""

    name: str
    match: Matcher
    grid: dict[str, tuple[Any, ...]]
    least_bad: Setting
    least_rms: Setting

    def settings(self) -> Iterator[Setting]:
        """Return every setting of the grid."""
        for values in itertools.product(*self.grid.values()):
            yield dict(zip(self.grid, values, strict=True))


def _grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _padded(image: Image, pixels: int) -> Image:
    return np.asarray(cv2.copyMakeBorder(image, 0, 0, pixels, 0, cv2.BORDER_REPLICATE), dtype=np.uint8)


def _unpadded(raw: NDArray[np.int16], pixels: int) -> Disparity:
    disparity = raw[:, pixels:].astype(np.float32) / SUBPIXELS
    return np.where(disparity < 0.0, np.float32(np.nan), disparity)


def match_bm(left: Image, right: Image, setting: Setting) -> Disparity:
    """OpenCV's block matching."""
    matcher = cv2.StereoBM.create(MAX_DISPARITY_PX, setting["block"])
    matcher.setUniquenessRatio(setting["unique"])
    matcher.setTextureThreshold(setting["texture"])
    matcher.setPreFilterCap(setting["cap"])
    pad = MAX_DISPARITY_PX + setting["block"]
    raw = matcher.compute(_padded(_grey(left), pad), _padded(_grey(right), pad))
    return _unpadded(np.asarray(raw, dtype=np.int16), pad)


def _sgbm(setting: Setting) -> cv2.StereoSGBM:
    block, channels = setting["block"], _CHANNELS if setting["colour"] else 1
    return cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=MAX_DISPARITY_PX,
        blockSize=block,
        P1=setting["p1"] * channels * block**2,
        P2=setting["p2"] * channels * block**2,
        disp12MaxDiff=setting["check"],
        preFilterCap=setting["cap"],
        uniquenessRatio=setting["unique"],
        mode=MODES[setting["mode"]],
    )


def match_sgbm(left: Image, right: Image, setting: Setting) -> Disparity:
    """OpenCV's semi-global matching."""
    pictures = [
        _padded(image if setting["colour"] else _grey(image), MAX_DISPARITY_PX + setting["block"])
        for image in (left, right)
    ]
    raw = _sgbm(setting).compute(pictures[0], pictures[1])
    return _unpadded(np.asarray(raw, dtype=np.int16), MAX_DISPARITY_PX + setting["block"])


def match_wls(left: Image, right: Image, setting: Setting) -> Disparity:
    """Semi-global matching in both directions and OpenCV contrib's weighted least squares filter."""
    extended = importlib.import_module("cv2.ximgproc")
    pad = MAX_DISPARITY_PX + setting["block"]
    guide = _padded(left, pad)
    pictures = [_padded(image if setting["colour"] else _grey(image), pad) for image in (left, right)]
    matcher = _sgbm(setting)
    other = extended.createRightMatcher(matcher)
    wls = extended.createDisparityWLSFilter(matcher)
    wls.setLambda(setting["lambda"])
    wls.setSigmaColor(setting["sigma"])
    forth, back = matcher.compute(pictures[0], pictures[1]), other.compute(pictures[1], pictures[0])
    return _unpadded(wls.filter(forth, guide, disparity_map_right=back), pad)


def match_pandora(left: Image, right: Image, setting: Setting) -> Disparity:
    """CNES' pandora, with the semi-global optimisation of its plug-in where the setting says so."""
    pandora = importlib.import_module("pandora")
    machine_module = importlib.import_module("pandora.state_machine")
    xarray = importlib.import_module("xarray")
    tools = importlib.import_module("pandora.img_tools")
    pandora.import_plugin()
    pad = MAX_DISPARITY_PX + setting["window"]
    pipeline: dict[str, dict[str, Any]] = {
        "matching_cost": {"matching_cost_method": setting["cost"], "window_size": setting["window"], "subpix": 1}
    }
    if setting["cbca"]:
        pipeline["aggregation"] = {"aggregation_method": "cbca"}
    if setting["sgm"]:
        pipeline["optimization"] = {"optimization_method": "sgm"}
    pipeline["disparity"] = {"disparity_method": "wta", "invalid_disparity": "NaN"}
    pipeline["refinement"] = {"refinement_method": setting["refine"]}
    pipeline["filter"] = {"filter_method": "median", "filter_size": 3}
    if setting["cross"]:
        pipeline["validation"] = {"validation_method": "cross_checking_accurate"}
    datasets = []
    for image, disparity in ((left, [-MAX_DISPARITY_PX, 0]), (right, [0, MAX_DISPARITY_PX])):
        grey = _padded(_grey(image), pad).astype(np.float32)
        height, width = grey.shape
        dataset = xarray.Dataset(
            {"im": (["row", "col"], grey)},
            coords={"row": np.arange(height), "col": np.arange(width)},
            attrs={
                "crs": None,
                "transform": None,
                "valid_pixels": 0,
                "no_data_mask": 1,
                "no_data_img": -9999,
                "segment_mode": None,
            },
        )
        datasets.append(tools.add_disparity(dataset, disparity, None))
    machine = machine_module.PandoraMachine()
    described = [xarray.Dataset(coords={"band_im": [None], **each.coords}, attrs=each.attrs) for each in datasets]
    machine.check_conf({"pipeline": pipeline}, *described)
    configuration = {"pipeline": machine.pipeline_cfg["pipeline"]}
    found, _ = pandora.run(machine, datasets[0], datasets[1], configuration)
    disparity_px = -np.asarray(found["disparity_map"].data, dtype=np.float32)[:, pad:]
    invalid = (np.asarray(found["validity_mask"].data)[:, pad:] & _PANDORA_INVALID) != 0
    return np.where(invalid, np.float32(np.nan), disparity_px)


_SGBM: Setting = {"block": 3, "p2": 32, "check": -1, "cap": 63, "unique": 0, "mode": "3way"}
PEERS = (
    Peer(
        "BM",
        match_bm,
        {"block": (7, 9, 11, 15, 21), "unique": (0, 5, 15), "texture": (0, 10), "cap": (15, 31, 63)},
        {"block": 11, "unique": 0, "texture": 0, "cap": 15},
        {"block": 21, "unique": 5, "texture": 0, "cap": 63},
    ),
    Peer(
        "SGBM",
        match_sgbm,
        {
            "block": (3, 5, 7),
            "p1": (4, 8),
            "p2": (32, 96),
            "check": (-1,),
            "cap": (63,),
            "unique": (0,),
            "colour": (False, True),
            "mode": ("sgbm", "hh", "3way"),
        },
        {**_SGBM, "p1": 8, "colour": False},
        {**_SGBM, "p1": 4, "colour": True},
    ),
    Peer(
        "SGBM+WLS",
        match_wls,
        {
            "block": (3, 5, 7),
            "p1": (8,),
            "p2": (32,),
            "check": (-1,),
            "cap": (63,),
            "unique": (0,),
            "colour": (False, True),
            "mode": ("sgbm", "3way"),
            "lambda": (2000.0, 8000.0),
            "sigma": (0.8, 1.5, 2.5),
        },
        {**_SGBM, "p1": 8, "colour": False, "lambda": 8000.0, "sigma": 1.5},
        {**_SGBM, "p1": 8, "colour": True, "lambda": 2000.0, "sigma": 0.8},
    ),
    Peer(
        "pandora",
        match_pandora,
        {
            "cost": ("zncc", "census"),
            "window": (5, 9),
            "cbca": (False, True),
            "sgm": (False, True),
            "refine": ("quadratic",),
            "cross": (False,),
        },
        {"cost": "census", "window": 5, "cbca": True, "sgm": True, "refine": "quadratic", "cross": False},
        {"cost": "zncc", "window": 9, "cbca": False, "sgm": False, "refine": "quadratic", "cross": False},
    ),
)


def ours(left: Image, right: Image, _: Setting) -> Disparity:
    """Planes of this project, with every pixel its surface."""
    parameters = VisionParameters(max_disparity_px=float(MAX_DISPARITY_PX))
    return perceive(left, right, replace(parameters, dense=replace(parameters.dense, enabled=True))).disparity_px


def holes_left(left: Image, right: Image, _: Setting) -> Disparity:
    """Planes of this project, holes left where no plane was matched."""
    return perceive(left, right, VisionParameters(max_disparity_px=float(MAX_DISPARITY_PX))).disparity_px


def tune(peer: Peer, pairs: Sequence[StereoPair]) -> None:
    """Run every setting of a peer and print the two best."""
    settings = list(peer.settings())
    bad, rms = [], []
    for setting in settings:
        scores = [score(pair, peer.match(pair.left, pair.right, setting)) for pair in pairs]
        bad.append(float(np.mean([each.bad_1 for each in scores])))
        rms.append(float(np.mean([each.rms_mean_px for each in scores])))
    for name, column in (("least bad-1.0", bad), ("least rms", rms)):
        k = int(np.argmin(column))
        found = f"{bad[k]:.2f} % {rms[k]:.3f} px {json.dumps(settings[k])}"
        print(f"{peer.name} {name} of {len(settings)}: {found}", flush=True)


def measure(name: str, match: Matcher, setting: Setting, run: tuple[Sequence[StereoPair], int]) -> dict[str, Score]:
    """Print a row for each pair; returns the scores by the pair's name."""
    pairs, repeats = run
    scores = {}
    for pair in pairs:
        milliseconds = []
        for _ in range(repeats):
            since = time.process_time()
            disparity = match(pair.left, pair.right, setting)
            milliseconds.append(1000.0 * (time.process_time() - since))
        scores[pair.name] = result = score(pair, disparity)
        planes = " ".join(f"{each:.3f}" for each in result.rms_px)
        print(
            f"{pair.name:<10}{name:<20}{statistics.median(milliseconds):>7.0f}{result.bad_1:>9.2f}{result.bad_half:>9.2f}"
            f"{result.rms_mean_px:>8.3f}{max(result.rms_px):>8.3f}  {planes}",
            flush=True,
        )
    return scores


def verdict(own: dict[str, Score], others: dict[str, dict[str, Score]]) -> None:
    """Print whether the aims are met on each pair."""
    for name, mine in own.items():
        best = min(others, key=lambda each: others[each][name].rms_mean_px)
        least = others[best][name].rms_mean_px
        filtered = min(scores[name].bad_1 for each, scores in others.items() if each.startswith("SGBM+WLS"))
        print(
            f"{name:<10}rms {mine.rms_mean_px:.3f} px, aim 0.10: {_met(mine.rms_mean_px <= RMS_AIM_PX)}; "
            f"best peer {best} {least:.3f}, aim within 0.02: {_met(mine.rms_mean_px <= least + RMS_BEHIND_PX)}; "
            f"bad-1.0 {mine.bad_1:.2f} %, aim at most SGBM+WLS {filtered:.2f}: {_met(mine.bad_1 <= filtered)}"
        )


def _met(yes: bool) -> str:
    return "met" if yes else "NOT met"


def main() -> None:
    """Print the table, or with ``--tune`` the search."""
    parser = argparse.ArgumentParser(description="Our planes beside other stereo matchers.")
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=Path(root), help="$SRVS_DATA, or ../shared/data")
    parser.add_argument("--tune", action="store_true", help="search the peers' settings instead")
    parser.add_argument("--peers", nargs="*", default=[peer.name for peer in PEERS])
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    cv2.setNumThreads(1)
    pairs = [read_pair(options.data / "middlebury2001" / name) for name in SETS]
    here = [peer for peer in PEERS if peer.name in options.peers and _installed(peer)]
    if options.tune:
        for peer in here:
            tune(peer, pairs)
        return
    print(f"{'pair':<10}{'matcher':<20}{'ms':>7}{'bad-1.0':>9}{'bad-0.5':>9}{'rms px':>8}{'max':>8}  each plane")
    run = (pairs, options.repeats)
    own = measure("planes", ours, {}, run)
    measure("planes, with holes", holes_left, {}, run)
    others = {}
    for peer in here:
        for name, setting in ((peer.name, peer.least_bad), (f"{peer.name} for rms", peer.least_rms)):
            others[name] = measure(name, peer.match, setting, run)
    if any(name.startswith("SGBM+WLS") for name in others):
        verdict(own, others)


def _installed(peer: Peer) -> bool:
    """Whether a peer can run here; says so where it cannot."""
    needed = {"SGBM+WLS": "cv2.ximgproc", "pandora": "pandora"}.get(peer.name)
    if needed is None or importlib.util.find_spec(needed) is not None:
        return True
    print(f"{peer.name} is left out: {needed} is not installed; see `make bench-peers`")
    return False


if __name__ == "__main__":
    main()
