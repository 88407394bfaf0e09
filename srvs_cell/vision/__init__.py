"""Vision: two images to workpieces, one file a step, in the order of the paper.

Step 11, planes to objects, is a room of its own (`recognition`), and so is the fit of one top face (`faces`).
"""

from srvs_cell.vision.parameters import Maxima, VisionParameters
from srvs_cell.vision.pfm import encode_pfm
from srvs_cell.vision.pipeline import LeftAnalysis, StereoView, analyse_image, analyse_left, perceive
from srvs_cell.vision.report import perception_to_json, workpiece_to_json

__all__ = [
    "LeftAnalysis",
    "Maxima",
    "StereoView",
    "VisionParameters",
    "analyse_image",
    "analyse_left",
    "encode_pfm",
    "perceive",
    "perception_to_json",
    "workpiece_to_json",
]
