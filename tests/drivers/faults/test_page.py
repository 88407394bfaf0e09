"""The page is made of the table that the tests are run from."""

from tests.drivers.faults import page, strikes, table


def test_the_page_is_current() -> None:
    assert page.PAGE.read_text(encoding="utf-8") == page.page(), "run python -m tests.drivers.faults.page"


def test_every_strike_is_in_the_table() -> None:
    assert {fault.strike for fault in table.TABLE} == set(strikes.STRIKES)
