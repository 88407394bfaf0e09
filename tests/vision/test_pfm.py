"""The portable float map."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.vision import encode_pfm


def test_the_bottom_row_comes_first_and_nan_stays() -> None:
    image = np.array([[1.0, 2.0, np.nan], [4.0, 5.0, 6.0]], dtype=np.float32)
    data = encode_pfm(image)
    assert data[:10] == b"Pf\n3 2\n-1\n"
    values = np.frombuffer(data[10:], dtype="<f4").reshape(2, 3)
    assert np.array_equal(values, image[::-1], equal_nan=True)


def test_another_reader_reads_it() -> None:
    image = np.arange(12, dtype=np.float32).reshape(3, 4)
    decoded = cv2.imdecode(np.frombuffer(encode_pfm(image), dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert decoded is not None
    assert np.array_equal(decoded, image)


def test_three_dimensions_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        encode_pfm(np.zeros((2, 2, 3)))
