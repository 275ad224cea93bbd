"""Words that findings are told in."""

import math

import pytest

from lightstage.counting import counted
from lightstage.findings import accepted_in_words, two_digits


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.0, "0"),
        (5.0, "5"),
        (10.0, "10"),
        (99.96, "100"),
        (300.4, "300"),
        (1.2e9, "1200000000"),
        (0.0123, "0.012"),
        (-0.5, "-0.5"),
        (-1e-12, "0"),
        (math.inf, "inf"),
        (math.nan, "nan"),
    ],
)
def test_numbers_are_written_in_plain_figures_without_a_power_of_ten(value, message):
    assert two_digits(value) == message


def test_a_number_that_misses_its_limit_is_not_written_as_the_limit():
    assert two_digits(4.96, 5) == "4.96"
    assert two_digits(0.10004, 0.1) == "0.10004"
    assert two_digits(5.0, 5) == "5"
    assert two_digits(4.94, 5) == "4.9"


def test_one_is_one_and_two_are_several():
    assert (counted(1, "warning"), counted(2, "warning")) == ("1 warning", "2 warnings")
    assert [counted(n, "patch", "patches") for n in (0, 1)] == ["0 patches", "1 patch"]
    assert accepted_in_words(1, 2) == "1 pattern accepted by the operator with 2 findings"
