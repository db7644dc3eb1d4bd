"""Units of long times: what is chosen, and how it is said."""

from simulation.time_unit import DAYS, HOURS, SECONDS, period_text


def test_periods_and_moments_are_said_in_their_unit():
    assert period_text((0.0, 10.0)) == "days 0 to 10"
    assert period_text((0.0, SECONDS.to_days(10))) == "0 to 10 s"
    assert period_text((0.125, 0.375)) == "3 to 9 h"
    assert (DAYS.moment(8.0), HOURS.moment(0.5)) == ("day 8", "12 h")
