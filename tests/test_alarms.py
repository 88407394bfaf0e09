"""The alarm registry."""

from srvs_cell.alarms import Alarm, AlarmError


def test_codes_are_unique_and_found_again() -> None:
    assert len({alarm.code for alarm in Alarm}) == len(Alarm)
    assert all(Alarm.from_code(alarm.code) is alarm for alarm in Alarm)


def test_every_alarm_says_cause_and_remedy() -> None:
    for alarm in Alarm:
        assert alarm.value.cause.endswith("."), alarm
        assert alarm.value.remedy.endswith("."), alarm


def test_the_message_names_code_detail_cause_and_remedy() -> None:
    text = str(AlarmError(Alarm.GRIP_EMPTY, "Workpiece 3 was not there."))
    assert text.startswith("[2101 GRIP_EMPTY] Workpiece 3 was not there. Cause: ")
    assert "Remedy: " in text
