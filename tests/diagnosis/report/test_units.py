"""Numbers are written in the units that a person reads, with as many digits as their interval supports."""

from __future__ import annotations

import numpy as np

from tossid.diagnosis.findings import Interval
from tossid.diagnosis.report.units import (
    in_units,
    listed,
    parameter,
    percent,
    percent_span,
    place_of,
    quantity,
    short,
    size_of_change,
    span,
)


def test_units_are_a_persons() -> None:
    assert quantity("x_m", 0.0015) == "1.5 mm"
    assert quantity("g_ms2", 9.81) == "9.81 m/s²"
    assert quantity("mu", 0.18) == "0.18"
    assert quantity("stiffness_npm", 33000.0) == "33\u202f000 N/m"
    assert quantity("delay_s", 0.003) == "3 ms"
    assert in_units("y_rad", Interval(np.pi / 180, np.pi / 360, np.pi / 120)) == "1.0 deg (0.5 to 1.5)"
    assert in_units("mu", Interval(0.29867, 0.29698, 0.30036)) == "0.2987 (0.2970 to 0.3004)"
    assert in_units("e", Interval(0.25, 0.2, 0.3), level="95 %: ") == "0.25 (95 %: 0.20 to 0.30)"
    assert percent(-0.001) == "0 %"


def test_what_rounding_leaves_of_zero_is_zero() -> None:
    assert quantity("x_m", -3.6e-15) == "0 mm"
    assert short(-3.6e-15) == "0"
    assert span(Interval(-3.6e-15, -0.1, 0.1)) == "0.00 (−0.10 to 0.10)"


def test_an_interval_of_one_value_or_without_ends_is_left_out() -> None:
    assert span(Interval(7.1, 7.1, 7.1)) == "7.10"
    assert span(Interval(7.1, 7.1 - 1e-12, 7.1)) == "7.10"
    assert span(Interval(7.1, -np.inf, np.inf)) == "7.10"
    assert percent_span(Interval(0.0, 0.0, 0.0)) == "0 %"


def test_names_lose_their_units() -> None:
    assert parameter("x_m") == "x"
    assert parameter("static_mu") == "static mu"
    assert parameter("e") == "e"


def test_changes_of_relative_parameters_are_in_percent() -> None:
    assert size_of_change("scale_rel", 0.031) == "3.1 %"
    assert size_of_change("x_m", 0.001) == "1.0 mm"


def test_numbers_without_a_finite_value_are_unknown() -> None:
    assert short(float("nan")) == percent(float("inf")) == "unknown"
    assert short(1.5e-7) == "1.50e−07"


def test_intervals_and_shares() -> None:
    assert span(Interval(0.3, 0.25, 0.35), "N") == "0.30 N (0.25 to 0.35)"
    assert percent_span(Interval(0.7, 0.65, 0.75)) == "70 % (65 % to 75 %)"
    assert percent_span(Interval(1.2, 0.9, 1.4)) == "100 % (90 % to 100 %)"  # no more than all of it is closed


def test_words_and_places() -> None:
    assert listed([]) == ""
    assert listed(["a", "b", "c"], "or") == "a, b or c"
    assert place_of((0.0524, -0.0524, 0.0)) == "(+52, −52, 0) mm"
