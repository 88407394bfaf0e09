"""The sensor: blur, vignetting, shot and read noise, 8 bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_WHITE: Final = 255.0


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A monochrome 8-bit sensor.

    Attributes:
        blur_px: standard deviation of lens and sensor blur.
        vignette: loss of light in the corners, as a share.
        full_well_e: electrons of a white pixel; sets the shot noise.
        read_noise: standard deviation in grey levels.
    """

    blur_px: float = 0.0
    vignette: float = 0.0
    full_well_e: float | None = None
    read_noise: float = 0.0

    def expose(self, irradiance: Array, random: np.random.Generator) -> NDArray[np.uint8]:
        """Return the 8-bit picture of an irradiance (0 to 1), shape (H, W); rounding is dithered by one level."""
        image = np.asarray(irradiance, dtype=np.float64)
        if self.blur_px > 0.0:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.blur_px, borderType=cv2.BORDER_REPLICATE))
        height, width = image.shape
        y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
        image = image * (1.0 - self.vignette * (x * x + y * y) / 2.0)
        if self.full_well_e is not None:
            image = random.poisson(np.clip(image, 0.0, None) * self.full_well_e) / self.full_well_e
        grey = image * _WHITE + self.read_noise * random.standard_normal(image.shape)
        grey += random.random(image.shape)
        return np.asarray(np.clip(np.floor(grey), 0.0, _WHITE), dtype=np.uint8)
