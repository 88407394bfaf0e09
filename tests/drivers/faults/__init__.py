"""One table of faults, and what each must end in on each wire."""

import pytest

pytest.register_assert_rewrite("tests.drivers.faults.judge")
