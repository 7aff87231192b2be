import numpy as np
import pytest

from groundstation.calibration import curves
from groundstation.calibration.schema import CalibrationCurve, CalibrationError


def polynomial(*coefficients: float, centre: float = 0.0, **more: object) -> CalibrationCurve:
    return CalibrationCurve(
        kind="polynomial",
        input_unit="V",
        output_unit="rad",
        centre=centre,
        coefficients=coefficients,
        valid=(-1, 1),
        **more,
    )


def test_polynomial_is_horner_about_its_centre() -> None:
    curve = polynomial(1.0, 2.0, -3.0, centre=0.5)
    x = np.array([0.5, 1.5, -0.5])
    np.testing.assert_allclose(curves.evaluate(curve, x), [1.0, 1 + 2 - 3, 1 - 2 - 3])


def test_table_is_linear_and_continues_its_end_segments() -> None:
    curve = CalibrationCurve(
        kind="table", input_unit="V", output_unit="N", inputs=(0.0, 1.0, 3.0), outputs=(0.0, 2.0, 4.0), valid=(0.0, 3.0)
    )
    np.testing.assert_allclose(curves.evaluate(curve, [0.25, 2.0, 4.0, -1.0]), [0.5, 3.0, 5.0, -2.0])
    np.testing.assert_array_equal(curves.extrapolated(curve, [0.0, 3.0, 3.1, -0.1]), [False, False, True, True])


def test_not_measured_stays_not_measured() -> None:
    assert np.isnan(curves.evaluate(polynomial(4.0), [np.nan])[0])
    assert not curves.extrapolated(polynomial(4.0), [np.nan])[0]


def test_fit_gives_back_the_truth_within_its_stated_bounds(rng: np.random.Generator) -> None:
    """Over many benches the coefficients scatter as their covariance says: chi-square of 3 coefficients."""
    truth = np.array([0.02, 0.8, -0.05])
    chi2 = []
    for _ in range(200):
        volts = np.linspace(-1, 1, 13)
        angle = truth[0] + truth[1] * volts + truth[2] * volts**2
        reading = volts + 1e-4 * rng.standard_normal(13)
        reference = angle + 2e-3 * rng.standard_normal(13)
        curve = curves.fit_polynomial(
            reading, reference, 2, reading_std=1e-4, reference_std=2e-3, input_unit="V", output_unit="rad"
        )
        # the fit's own centre: compare values at three inputs instead of coefficients
        at = np.array([-0.7, 0.1, 0.8])
        error = curves.evaluate(curve, at) - (truth[0] + truth[1] * at + truth[2] * at**2)
        powers = np.stack([(at - curve.centre) ** k for k in range(3)], axis=1)
        covariance = powers @ np.array(curve.covariance) @ powers.T
        chi2.append(error @ np.linalg.solve(covariance, error))
    assert 2.2 < np.mean(chi2) < 3.3  # inflation by the residuals is one-sided: slightly below 3
    assert np.mean(np.array(chi2) > 11.34) < 0.04  # 1 % tail of chi-square with 3


def test_residuals_larger_than_stated_enlarge_the_bounds(rng: np.random.Generator) -> None:
    x = np.linspace(0, 1, 30)
    y = 2 * x + 0.1 * rng.standard_normal(30)
    curve = curves.fit_polynomial(x, y, 1, reference_std=0.001, input_unit="V", output_unit="rad")
    # mean of 30 points with scatter 0.1
    assert curves.standard_deviation(curve, [0.5])[0] == pytest.approx(0.1 / np.sqrt(30), rel=0.35)


def test_common_error_of_the_references_is_a_floor() -> None:
    assert curves.standard_deviation(polynomial(0.0, 1.0, uncertainty=0.01, covariance=((1e-4, 0), (0, 0))), [0.0])[
        0
    ] == (pytest.approx(np.hypot(0.01, 0.01)))


@pytest.mark.parametrize(
    ("x", "degree", "words"), [([1.0, 2.0, 3.0], 2, "at least 4"), ([1.0, 1.0, 1.0, 1.0], 1, "same reading")]
)
def test_benches_that_cannot_be_fitted_say_why(x: list[float], degree: int, words: str) -> None:
    with pytest.raises(CalibrationError, match=words):
        curves.fit_polynomial(x, x, degree, input_unit="V", output_unit="rad")
