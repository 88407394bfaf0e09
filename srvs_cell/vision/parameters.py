"""The parameters of the vision, one dataclass a step; the paper's thresholds under the paper's names.

The defaults are for 640x480 images of a table with parts on it. `VisionParameters.faithful` switches off every step
that is not in the paper.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from srvs_cell.vision.edges import EdgeParameters
from srvs_cell.vision.limit_pairs import check_pairs
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.table_alignment import TableParameters

_CONFIG = ConfigDict(extra="forbid")


class Maxima(StrEnum):
    """The two readings of MAX_L and MAX_R in the paper."""

    ALL_PLANES = "all_planes"
    """Over all planes, before the gates, as the text is written."""

    ADMISSIBLE = "admissible"
    """Over the candidates that pass the gates."""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class FilterParameters:
    """Step 3, cutting peaks and filling holes of the edge regions."""

    passes: Annotated[int, Field(ge=0, le=10, description="how often peaks are cut and holes filled; 0: no filter")] = 2
    peak_neighbours: Annotated[
        int, Field(ge=0, le=4, description="an edge pixel with no more edge pixels among its 8 neighbours is a peak")
    ] = 1
    hole_neighbours: Annotated[
        int, Field(ge=5, le=8, description="a pixel with at least so many edge pixels around it is a hole")
    ] = 6


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class TrackingParameters:
    """Step 5, following the thinned edges."""

    min_chain_px: Annotated[int, Field(ge=1, le=200, description="chains of fewer pixels are dropped")] = 5
    max_gap_px: Annotated[
        int, Field(ge=0, le=30, description="an open end is prolonged this far to meet another edge; 0: never")
    ] = 8


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class PlaneParameters:
    """Steps 6 and 7, region growing and the limits of a plane."""

    min_open_share: Annotated[
        float, Field(gt=0.0, le=1.0, description="regions are joined where so much of their border lies on no edge")
    ] = 0.55
    max_brightness_step: Annotated[
        float, Field(gt=0.0, le=255.0, description="regions are not joined where their mean brightness differs by more")
    ] = 25.0
    min_area_px: Annotated[int, Field(ge=1, le=100_000, description="a smaller region is degenerate")] = 30
    min_thickness_px: Annotated[
        float, Field(ge=0.0, le=100.0, description="a region whose 4 area / perimeter is less is degenerate")
    ] = 2.0
    max_area_share: Annotated[
        float, Field(gt=0.0, le=1.0, description="a region that covers more of the image is degenerate")
    ] = 1.0


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class MatchingParameters:
    """Step 8, the paper's rule with the paper's thresholds."""

    max_row_distance_px: Annotated[
        float, Field(ge=0.0, le=1000.0, description="the paper's maximum row distance, between centres along y")
    ] = 3.0
    max_column_margin_px: Annotated[
        float, Field(ge=0.0, le=1000.0, description="added to the disparity range for the maximum column distance")
    ] = 4.0
    weight_area: Annotated[float, Field(ge=0.0, le=1.0, description="the paper's w of the area")] = 0.3
    weight_short_cut: Annotated[float, Field(ge=0.0, le=1.0, description="the paper's w of the short cut")] = 0.3
    weight_long_cut: Annotated[float, Field(ge=0.0, le=1.0, description="the paper's w of the long cut")] = 0.3
    weight_perimeter: Annotated[float, Field(ge=0.0, le=1.0, description="the paper's w of the perimeter")] = 0.3
    match_threshold: Annotated[float, Field(ge=0.0, le=1.0, description="the paper's match threshold")] = 0.7
    maxima: Annotated[Maxima, Field(description="the maxima run over all planes or over admissible candidates")] = (
        Maxima.ADMISSIBLE
    )
    ordered: Annotated[
        bool, Field(description="beyond the paper: matches that cross others or have equal rivals are ambiguous")
    ] = True


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class InterpolationParameters:
    """Step 10, linear interpolation between the ends of a plane's rows."""

    sub_pixel: Annotated[bool, Field(description="measure the ends by the grey values' steepest place")] = True
    max_residual_px: Annotated[
        float, Field(gt=0.0, le=20.0, description="a row's end farther from the fitted plane is an outlier")
    ] = 1.0


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class RefinementParameters:
    """Beyond the paper: photometric alignment of each matched plane."""

    enabled: Annotated[bool, Field(description="align each matched plane photometrically")] = True
    iterations: Annotated[int, Field(ge=1, le=50, description="Gauss-Newton steps")] = 8
    band_px: Annotated[
        int, Field(ge=0, le=10, description="how far beyond the region's border grey values are compared")
    ] = 2
    max_shift_px: Annotated[
        float, Field(gt=0.0, le=20.0, description="an alignment that moves the plane farther is refused")
    ] = 3.0
    max_pixels: Annotated[int, Field(ge=50, le=1_000_000, description="pixels of a plane that are used")] = 2000
    min_correlation: Annotated[
        float, Field(ge=-1.0, le=1.0, description="a match whose aligned grey values correlate less is dropped")
    ] = 0.95


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class GroupingParameters:
    """Beyond the paper: regions cut up by print and texture become one surface again."""

    enabled: Annotated[bool, Field(description="merge neighbouring regions that lie on one plane")] = True
    max_step_px: Annotated[
        float, Field(gt=0.0, le=5.0, description="greatest difference of two regions' disparities on one surface")
    ] = 0.4
    max_cost: Annotated[
        float, Field(gt=0.0, le=100.0, description="mean grey difference up to which a plane explains a region")
    ] = 6.0
    distinctness: Annotated[
        float, Field(ge=1.0, le=10.0, description="the cost beside a surface, and a region's own one, in the surface's")
    ] = 1.15
    min_enclosure: Annotated[
        float, Field(gt=0.0, le=1.0, description="share of its border with a surface that makes a region print on it")
    ] = 0.9
    min_share: Annotated[
        float,
        Field(gt=0.0, lt=0.5, description="what a surface must lower the mean photometric cost, 0 to 0.5, by to count"),
    ] = 0.0015


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class DenseParameters:
    """Beyond the paper: a disparity for every pixel, of the surface that explains it best.

    Off unless asked for: workpieces need no more than their own surfaces, and what lies on none, a bare table, would
    get the disparity of one.
    """

    enabled: Annotated[bool, Field(description="fill the disparity map: every pixel takes a surface's disparity")] = (
        False
    )
    cell_px: Annotated[int, Field(ge=4, le=64, description="side of a superpixel")] = 8
    smoothness: Annotated[
        float, Field(ge=0.0, le=100.0, description="weight of a pixel of border between surfaces, in greatest costs")
    ] = 5.0
    contrast_grey: Annotated[
        float, Field(gt=0.0, le=255.0, description="step of grey values that lowers a border's weight to 1/e")
    ] = 8.0
    iterations: Annotated[int, Field(ge=1, le=1000, description="greatest number of rounds of messages")] = 80
    roughness_px: Annotated[
        float, Field(ge=0.0, le=5.0, description="standard deviation of real surfaces' disparities from planes")
    ] = 0.3
    row_sigma_px: Annotated[
        float, Field(ge=0.0, le=1.0, description="standard deviation of what a surface's rows are apart in the images")
    ] = 0.1


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class VisionParameters:
    """All parameters of the vision."""

    min_disparity_px: Annotated[
        float, Field(ge=0.0, le=4000.0, description="least disparity where no calibration tells it")
    ] = 0.0
    max_disparity_px: Annotated[
        float, Field(gt=0.0, le=4000.0, description="greatest disparity where no calibration tells it")
    ] = 64.0
    edges: EdgeParameters = Field(default_factory=EdgeParameters)
    filtering: FilterParameters = Field(default_factory=FilterParameters)
    tracking: TrackingParameters = Field(default_factory=TrackingParameters)
    planes: PlaneParameters = Field(default_factory=PlaneParameters)
    matching: MatchingParameters = Field(default_factory=MatchingParameters)
    interpolation: InterpolationParameters = Field(default_factory=InterpolationParameters)
    refinement: RefinementParameters = Field(default_factory=RefinementParameters)
    grouping: GroupingParameters = Field(default_factory=GroupingParameters)
    table: TableParameters = Field(default_factory=TableParameters)
    dense: DenseParameters = Field(default_factory=DenseParameters)
    recognition: RecognitionParameters = Field(default_factory=RecognitionParameters)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        check_pairs(self, ("min_disparity_px", "max_disparity_px"))
        return self

    @classmethod
    def faithful(cls) -> VisionParameters:
        """Return the paper's own algorithm: whole-pixel ends, maxima over all planes, nothing beyond the paper."""
        return cls().as_the_paper()

    def as_the_paper(self) -> VisionParameters:
        """Return these parameters with every step beyond the paper switched off; limits stay as they are."""
        return replace(
            self,
            matching=replace(self.matching, maxima=Maxima.ALL_PLANES, ordered=False),
            interpolation=replace(self.interpolation, sub_pixel=False),
            refinement=replace(self.refinement, enabled=False),
            grouping=replace(self.grouping, enabled=False),
            dense=replace(self.dense, enabled=False),
            table=replace(self.table, enabled=False),
            recognition=replace(self.recognition, recover=False),
        )
