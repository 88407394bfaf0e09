"""What the simulated USB camera says it is: descriptors of a USB video class 1.1 camera, bulk transfer, YUYV."""

from __future__ import annotations

import struct
from typing import Final

SIZES_PX: Final = ((640, 480), (320, 240))
"""Frame descriptors 1, 2, ..."""

INTERVALS_100NS: Final = (333333, 666666, 1000000, 2000000)
CLOCK_HZ: Final = 48_000_000
BYTES_PER_PIXEL: Final = 2
STRINGS: Final = {1: "srvs bench", 2: "Simulated camera", 3: "SIM0001"}

_YUY2: Final = bytes.fromhex("5955593200001000800000aa00389b71")
_DEVICE, _CONFIG, _STRING, _INTERFACE, _ENDPOINT, _ASSOCIATION, _CLASS = 1, 2, 3, 4, 5, 11, 0x24
_VIDEO, _CONTROL, _STREAMING = 0x0E, 1, 2


def _descriptor(kind: int, layout: str, *values: int, tail: bytes = b"") -> bytes:
    body = struct.pack("<" + layout, *values) + tail
    return bytes([len(body) + 2, kind]) + body


def string_descriptor(number: int) -> bytes:
    """Return string ``number``; 0 is the list of languages."""
    text = struct.pack("<H", 0x0409) if number == 0 else STRINGS.get(number, "?").encode("utf-16-le")
    return _descriptor(_STRING, "", tail=text)


def device_descriptor() -> bytes:
    """Return the device: USB 2.0, several interfaces that belong together, vendor Linux Foundation."""
    return _descriptor(_DEVICE, "H4B3H4B", 0x0200, 0xEF, 2, 1, 64, 0x1D6B, 0x0102, 0x0100, 1, 2, 3, 1)


def configuration_descriptor() -> bytes:
    """Return the configuration: a control interface with exposure, gain and brightness, and a streaming interface."""
    camera = _descriptor(_CLASS, "BBHBBHHHB", 2, 1, 0x0201, 0, 0, 0, 0, 0, 3, tail=b"\x0a\0\0")
    processing = _descriptor(_CLASS, "BBBHB", 5, 2, 1, 0, 2, tail=b"\x01\x02\0\0")
    output = _descriptor(_CLASS, "BBHBBB", 3, 3, 0x0101, 0, 2, 0)
    units = camera + processing + output
    control = _descriptor(_CLASS, "BHHIBB", 1, 0x0110, 13 + len(units), CLOCK_HZ, 1, 1) + units
    frames = b"".join(_frame(number + 1, *size) for number, size in enumerate(SIZES_PX))
    formats = _descriptor(_CLASS, "BBB", 4, 1, len(SIZES_PX), tail=_YUY2 + bytes([16, 1, 0, 0, 0, 0])) + frames
    streaming = _descriptor(_CLASS, "BBHBBBBBBBB", 1, 1, 14 + len(formats), 0x81, 0, 3, 0, 0, 0, 1, 0) + formats
    body = (
        _descriptor(_ASSOCIATION, "6B", 0, 2, _VIDEO, 3, 0, 2)
        + _descriptor(_INTERFACE, "7B", 0, 0, 0, _VIDEO, _CONTROL, 0, 2)
        + control
        + _descriptor(_INTERFACE, "7B", 1, 0, 1, _VIDEO, _STREAMING, 0, 0)
        + streaming
        + _descriptor(_ENDPOINT, "BBHB", 0x81, 2, 512, 0)
    )
    return _descriptor(_CONFIG, "HBBBBB", 9 + len(body), 2, 1, 0, 0x80, 250) + body


def _frame(number: int, width: int, height: int) -> bytes:
    size = width * height * BYTES_PER_PIXEL
    slowest, fastest = (size * 8 * 10_000_000 // INTERVALS_100NS[index] for index in (-1, 0))
    intervals = struct.pack(f"<{len(INTERVALS_100NS)}I", *INTERVALS_100NS)
    return _descriptor(
        _CLASS, "BBBHHIIIIB", 5, number, 0, width, height, slowest, fastest, size,
        INTERVALS_100NS[0], len(INTERVALS_100NS), tail=intervals,
    )  # fmt: skip
