"""Units by name."""

from __future__ import annotations

import math

import pytest

from edtorch.transitions.units import conversion


@pytest.mark.parametrize(
    ("source", "target", "factor"),
    [
        ("deg", "rad", math.pi / 180),
        ("deg/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("mm", "m", 1e-3),
        ("km/h", "m/s", 1 / 3.6),
        ("mm/s^2", "m/s²", 1e-3),
        ("mN m", "Nm", 1e-3),
        ("kg m/s/s", "g m/s2", 1e3),
        ("%", "", 0.01),
        ("1/s", "Hz", 1.0),
        ("furlong", "furlong", 1.0),
    ],
)
def test_factors(source: str, target: str, factor: float) -> None:
    assert conversion(source, target) == pytest.approx(factor, rel=1e-15)
    assert conversion(target, source) == pytest.approx(1 / factor, rel=1e-15)


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("deg", "m", "cannot convert 'deg' to 'm'"),
        ("deg", "", "cannot convert"),
        ("m", "m/s", "cannot convert"),
        ("furlong", "m", "unknown unit 'furlong'; known are"),
        ("m/", "m", "unknown unit"),
        ("m^", "m", r"unknown unit 'm\^'"),
    ],
)
def test_what_has_no_factor(source: str, target: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        conversion(source, target)
