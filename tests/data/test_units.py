"""Units as people write them, and the SI units that records have."""

import numpy as np
import pytest

from tustinnet.data.units import convert, convert_to_si


@pytest.mark.parametrize(
    ("unit", "factor", "si"),
    [
        ("deg/s", np.pi / 180, "rad/s"),
        ("rev/min", 2 * np.pi / 60, "rad/s"),
        ("rpm", 2 * np.pi / 60, "rad/s"),
        ("rad / s^2", 1.0, "rad/s**2"),
        ("m/s**2", 1.0, "m/s**2"),
        ("m*s^-2", 1.0, "m/s**2"),
        ("N m", 1.0, "m*N"),
        ("N·m", 1.0, "m*N"),
        ("Nm", 1.0, "m*N"),
        ("mNm", 1e-3, "m*N"),
        ("N*m*s/rad", 1.0, "m*N*s/rad"),
        ("kg m^2", 1.0, "kg*m**2"),
        ("g*cm^2", 1e-7, "kg*m**2"),
        ("1/min", 1 / 60, "1/s"),
        ("m/m", 1.0, "1"),
        ("µm", 1e-6, "m"),
        ("μA", 1e-6, "A"),
        ("kV", 1e3, "V"),
        ("millivolts", 1e-3, "V"),
        ("kΩ", 1e3, "ohm"),
        ("hPa", 100.0, "Pa"),
        ("inches", 0.0254, "m"),
        ("lbf*ft", 1.3558179483314004, "m*N"),
        ("hp", 745.6998715822702, "W"),
        ("l/min", 1e-3 / 60, "m**3/s"),
        ("pixel", 1.0, "pixel"),
    ],
)
def test_a_unit_is_a_factor_and_an_si_unit_which_is_itself_known(unit, factor, si):
    assert convert_to_si(unit) == (pytest.approx(factor, rel=1e-12), si)
    assert convert_to_si(si) == (1.0, si)


@pytest.mark.parametrize(
    ("unit", "told"),
    [
        ("degC", "has a zero or a scale of its own"),
        ("dB", "has a zero or a scale of its own"),
        ("knots/foo", "'knots/foo' is not known"),
        ("µmm", "is not known, e.g. mm, µm"),
        ("kkm", "is not known"),
        ("mdeg", "is not known"),
        ("", "is none"),
        ("m/", "is none"),
        ("m^12", "is none"),
        ("m^0", "is none"),
        ("2 m", "is none"),
        ("m" * 61, "is none"),
    ],
)
def test_what_is_no_unit_is_refused(unit, told):
    with pytest.raises(ValueError, match=told):
        convert_to_si(unit)


def test_units_of_one_quantity_are_converted():
    assert convert("mNm", "N cm") == pytest.approx(0.1)
    with pytest.raises(ValueError, match="'deg' is not a unit of a quantity in m"):
        convert("deg", "m")
