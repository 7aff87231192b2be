import numpy as np
import pytest

from groundstation.calibration import conversions
from groundstation.calibration.schema import CalibrationError
from groundstation.flight import atmosphere

NVM = bytes.fromhex("b66c0f4af66a1c0f170601564b465b03fa6f0f06f5")


def test_standard_atmosphere_table() -> None:
    """ICAO Doc 7488/3, table I: geopotential height, pressure, density."""
    for height, pressure, density, temperature in (
        (0.0, 101325.0, 1.22500, 288.150),
        (1000.0, 89874.6, 1.11164, 281.650),
        (5000.0, 54019.9, 0.736116, 255.650),
    ):
        assert conversions.pressure_altitude(np.array([pressure]))[0] == pytest.approx(height, abs=0.1)
        assert atmosphere.density(np.array([pressure]), np.array([temperature]))[0] == pytest.approx(density, rel=1e-5)


def test_calibrated_airspeed_of_a_published_impact_pressure() -> None:
    """100 knots calibrated is an impact pressure of 0.4814 inHg (Gracey, NASA RP-1046, table A2: 34.0 lb/ft2 = 1629.7 Pa)."""
    speed = conversions.calibrated_airspeed(np.array([1629.7]))[0]
    assert speed * 3600 / 1852 == pytest.approx(100.0, abs=0.1)


def test_low_speed_limit_is_bernoulli() -> None:
    pressure, warmth = np.array([100_000.0]), np.array([290.0])
    rho = atmosphere.density(pressure, warmth)
    for q in (1.0, 130.0, 400.0):
        bernoulli = np.sqrt(2 * q / rho)
        assert conversions.true_airspeed(np.array([q]), pressure, warmth)[0] == pytest.approx(bernoulli[0], rel=1.5e-3)


def test_impact_pressure_is_the_inverse() -> None:
    for speed in (3.0, 15.0, 100.0):
        q = conversions.impact_pressure(speed, 95_000.0, 280.0)
        back = conversions.true_airspeed(np.array([q]), np.array([95_000.0]), np.array([280.0]))
        assert back[0] == pytest.approx(speed, rel=1e-12)


def test_no_speed_without_impact_pressure() -> None:
    speed = conversions.true_airspeed(np.array([-5.0, 0.0]), np.full(2, 1e5), np.full(2, 288.0))
    np.testing.assert_array_equal(speed, [0.0, 0.0])


def test_bmp390_against_the_datasheet_written_out() -> None:
    """The formulas of BST-BMP390-DS002-07, 8.5 and 8.6, term by term as printed, for one pair of readings."""
    raw_p, raw_t = 6_946_816.0, 8_398_608.0
    par = np.frombuffer(NVM, dtype=np.dtype("<u2,<u2,i1,<i2,<i2,i1,i1,<u2,<u2,i1,i1,<i2,i1,i1"))[0]
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = (float(v) for v in par)
    partial1 = raw_t - t1 / 2**-8
    partial2 = partial1 * (t2 / 2**30)
    t_lin = partial2 + partial1 * partial1 * (t3 / 2**48)
    out1 = p5 / 2**-3 + p6 / 2**6 * t_lin + p7 / 2**8 * t_lin**2 + p8 / 2**15 * t_lin**3
    out2 = raw_p * ((p1 - 2**14) / 2**20 + (p2 - 2**14) / 2**29 * t_lin + p3 / 2**32 * t_lin**2 + p4 / 2**37 * t_lin**3)
    data3 = raw_p**2 * (p9 / 2**48 + p10 / 2**48 * t_lin) + raw_p**3 * (p11 / 2**65)
    pressure, warmth = conversions.Bmp390Compensation.from_nvm(NVM).compensate(np.array([raw_p]), np.array([raw_t]))
    assert pressure[0] == pytest.approx(out1 + out2 + data3, rel=1e-12)
    assert warmth[0] == pytest.approx(t_lin + 273.15, rel=1e-12)
    assert 9e4 < pressure[0] < 1.05e5


@pytest.mark.parametrize("nvm", [b"", bytes(21), b"\xff" * 21, NVM[:-1]])
def test_blank_coefficients_are_refused(nvm: bytes) -> None:
    with pytest.raises(CalibrationError, match="coefficients"):
        conversions.Bmp390Compensation.from_nvm(nvm)
