"""Conversations of driver and double, recorded once and replayed byte by byte to each of them."""

import pytest

pytest.register_assert_rewrite("tests.drivers.recordings.conversation")
