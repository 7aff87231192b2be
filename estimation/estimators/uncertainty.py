"""Bounds of estimates, Cramer-Rao and corrected for coloured residuals and input errors, and identifiability with reasons.

The corrected covariance is M^-1 B M^-1 with M the information and B the covariance of the score: the sum of the parts due to
the outputs' noise (`estimation.estimators.coloured`) and to input errors (`estimation.estimators.input_error`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import RADIAN
from estimation.estimators.coloured import (
    ResidualSegment,
    Spectrum,
    autocovariance,
    filtered_covariance,
    measured_part,
    measured_rows_of,
    noise_spectrum,
    non_empty_pieces,
    without_nuisance,
)
from estimation.estimators.input_error import (
    Disturbed,
    InputErrorEvidence,
    common_error,
    disturbed_outputs,
    edge_size,
    input_error_evidence,
)
from estimation.estimators.likelihood import LikelihoodPoint, OutputErrorProblem, whiten_all
from estimation.estimators.normal_equations import FlightBlocks, pseudo_inverse
from estimation.estimators.result import Estimate, correlation_matrix
from estimation.estimators.together import gearing_text, moving_together
from estimation.models.base import Model, Parameter
from estimation.models.expressions import products_in
from estimation.prepare.flight_data import FlightData

Array = NDArray[np.float64]

COLLINEAR = 0.95  # correlation from which two estimates are called collinear
LISTED = 0.9  # correlation from which a pair is listed
TIED = 1e-3  # share in a direction the data does not see, in scaled coordinates: such a parameter is undetermined
RESOLUTION = 0.01  # of the motion of an output: a parameter whose bound moves no output by more is identifiable
USEFUL = 0.3  # of a believed value: a wider bound tells nothing new
BEYOND_DOUBT = 0.2  # of the estimate: a bound this narrow, five times below it, is useful whatever was believed
STILL = 3.0  # times its noise: an input that moves less has not moved


@dataclass(frozen=True)
class Uncertainty:
    """Covariances of the shared parameters and of each flight's local ones, Cramer-Rao and corrected; undetermined: (shared,)
    which the data does not see."""

    covariance: Array
    coloured: Array
    local_covariance: list[Array]
    local_coloured: list[Array]
    undetermined: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ParameterEffect:
    """Effect of one unit of a parameter on the output that it moves most. share: of the rms motion of that output about its mean
    [1/unit of the parameter]."""

    output: str
    share: float


def effects_of(problem: OutputErrorProblem, point: LikelihoodPoint) -> dict[str, ParameterEffect]:
    """Effect of each free parameter at a point evaluated with derivatives."""
    n = len(problem.free)
    effect_squares, motion = np.zeros((problem.ny, n)), np.zeros(problem.ny)
    for flight, motions in zip(problem.flights, point.motions, strict=True):
        for segment, simulated in zip(flight.segments, motions, strict=True):
            assert simulated.dy is not None
            measured = np.isfinite(segment.z)
            effect_squares += np.sum(np.where(measured[:, :, None], simulated.dy[:, :, :n], 0.0) ** 2, axis=0)
            z = np.where(measured, segment.z, 0.0)
            mean = z.sum(axis=0) / np.maximum(measured.sum(axis=0), 1)
            motion += np.sum(np.where(measured, z - mean, 0.0) ** 2, axis=0)
    share = np.sqrt(
        np.divide(effect_squares, motion[:, None], out=np.zeros_like(effect_squares), where=motion[:, None] > 0.0)
    )
    strongest = np.argmax(share, axis=0)
    names = problem.model.output_names
    return {
        name: ParameterEffect(names[strongest[k]], float(share[strongest[k], k])) for k, name in enumerate(problem.free)
    }


def bounds_at_optimum(problem: OutputErrorProblem, unknowns: Array, point: LikelihoodPoint) -> Uncertainty:
    """Both bounds at an optimum evaluated with derivatives."""
    blocks = [problem.flight_blocks(unknowns, point, i) for i in range(len(problem.flights))]
    information, _ = problem.shared_information(unknowns, blocks)
    covariance, blind = pseudo_inverse(information)
    undetermined = np.any(np.abs(blind) > TIED, axis=1)
    scores = [flight_score(problem, unknowns, point, i, covariance, block) for i, block in enumerate(blocks)]
    reduced = [reduction(problem, block) for block in blocks]
    change = covariance @ np.sum([r @ s.common for r, s in zip(reduced, scores, strict=True)], axis=0)
    evidence = [s.evidence for s in scores]
    edges = edge_size(evidence)
    common = common_error(evidence, edges)
    middle = np.diag(problem.prior_weight[problem.shared])
    middle += sum(r @ s.covariance(edges) @ r.T for r, s in zip(reduced, scores, strict=True))
    coloured = covariance @ middle @ covariance + change @ common @ change.T
    local_covariance, local_coloured = [], []
    for block, score in zip(blocks, scores, strict=True):
        local_covariance.append(with_shared(block, block.ll_inverse, covariance))
        independent = score.covariance(edges)[np.ix_(problem.local, problem.local)]
        by_common = score.common[problem.local]
        given_shared = block.ll_inverse @ (independent + by_common @ common @ by_common.T) @ block.ll_inverse
        local_coloured.append(with_shared(block, given_shared, coloured))
    return Uncertainty(covariance, coloured, local_covariance, local_coloured, undetermined)


def reduction(problem: OutputErrorProblem, block: FlightBlocks) -> Array:
    """(shared, n) from a flight's score to that of the shared parameters with the local ones eliminated."""
    reduce = np.zeros((len(problem.shared), len(problem.free)))
    reduce[:, problem.shared] = np.eye(len(problem.shared))
    if len(problem.local):
        reduce[:, problem.local] = -block.sl @ block.ll_inverse
    return reduce


def with_shared(block: FlightBlocks, given_shared: Array, shared: Array) -> Array:
    """(local, local) covariance of a flight's local parameters, from that given the shared ones and that of the shared ones."""
    lever = block.ll_inverse @ block.sl.T
    return given_shared + lever @ shared @ lever.T


@dataclass(frozen=True)
class FlightScore:
    """Parts of the score of one flight about the free parameters, initial states projected out.

    noise: (n, n) covariance due to the outputs' noise; inputs, edges: (n, draws) and common: (n, errors) scores due to input
    errors; evidence: determines the sizes of the last two; spectrum: of the outputs' noise, in units of R.
    """

    noise: Array
    inputs: Array
    edges: Array
    common: Array
    evidence: InputErrorEvidence
    spectrum: Spectrum

    def covariance(self, edges: float) -> Array:
        """(n, n) covariance of the parts that are independent from flight to flight. edges: factor on the variance of edges."""
        inputs = self.inputs @ self.inputs.T / max(self.inputs.shape[1], 1)
        return self.noise + inputs + edges / max(self.edges.shape[1], 1) * (self.edges @ self.edges.T)


def flight_score(
    problem: OutputErrorProblem,
    unknowns: Array,
    point: LikelihoodPoint,
    index: int,
    covariance: Array,
    blocks: FlightBlocks,
) -> FlightScore:
    """Parts of the score of one flight due to the outputs' noise, coloured as residuals show it, and to input errors.

    covariance: of the shared parameters; blocks: of this flight.
    """
    pieces = segments_in_noise(problem, point, index)
    nuisance_inverse = [b.xx_inverse for b in point.blocks[index]]
    inverse = free_covariance(problem, covariance, blocks)
    responses = disturbed_outputs(problem, unknowns, index)
    noise, edges = responses[0].noise, responses[0].edges
    white = white_responses(pieces, nuisance_inverse, responses, point)
    white = [measured_rows_of(p, w) for p, w in zip(pieces, white, strict=True)]
    measured_pieces = [measured_part(p) for p in pieces]
    pieces, white = non_empty_pieces(measured_pieces, white)
    nuisance_inverse = non_empty_pieces(measured_pieces, nuisance_inverse)[1]
    projected = without_nuisance(pieces, nuisance_inverse)
    columns = np.sum([J.T @ w for J, w in zip(projected, white, strict=True)], axis=0)
    lags = input_lags(pieces, projected, [w[:, :noise] for w in white], inverse @ columns[:, :noise])
    spectrum = noise_spectrum(pieces, projected, inverse, nuisance_inverse, lags)
    inputs, edge, common = np.split(columns, [noise, noise + edges], axis=1)
    from_noise = filtered_covariance(pieces, projected, spectrum)
    evidence = input_error_evidence(pieces, white, spectrum, responses[0])
    return FlightScore(from_noise, inputs, edge, common, evidence, spectrum)


def white_responses(
    pieces: list[ResidualSegment], nuisance_inverse: list[Array], responses: list[Disturbed], point: LikelihoodPoint
) -> list[Array]:
    """Responses (N ny, columns) of each piece in units of the noise, initial states projected out."""
    white = []
    for response, p, state_covariance in zip(responses, pieces, nuisance_inverse, strict=True):
        w = whiten_all(response.values, np.where(p.known, 0.0, np.nan), point.R)[0]
        white.append(w - p.nuisance @ (state_covariance @ (p.nuisance.T @ w)))
    return white


def input_lags(
    pieces: list[ResidualSegment], projected: list[Array], white: list[Array], change: Array
) -> Array | None:
    """Autocovariance that the noise of the inputs gives the residuals of a fit, or None without draws of it.

    white: (N ny, draws) of each piece; change: (n, draws) of the parameters.
    """
    if not change.shape[1]:
        return None
    series = [(w - J @ change).reshape(*p.residual.shape, -1) for p, J, w in zip(pieces, projected, white, strict=True)]
    return autocovariance(series, [p.known for p in pieces])


def noise_spectra(problem: OutputErrorProblem, unknowns: Array, point: LikelihoodPoint) -> list[Spectrum]:
    """Spectrum of each flight's output noise in units of R, as in the corrected bound."""
    blocks = [problem.flight_blocks(unknowns, point, i) for i in range(len(problem.flights))]
    covariance, _ = pseudo_inverse(problem.shared_information(unknowns, blocks)[0])
    return [flight_score(problem, unknowns, point, i, covariance, b).spectrum for i, b in enumerate(blocks)]


def free_covariance(problem: OutputErrorProblem, covariance: Array, blocks: FlightBlocks) -> Array:
    """(n, n) covariance of the free parameters of one flight, without that between shared and local ones. covariance: shared."""
    inverse = np.zeros((len(problem.free), len(problem.free)))
    inverse[np.ix_(problem.shared, problem.shared)] = covariance
    inverse[np.ix_(problem.local, problem.local)] = blocks.ll_inverse
    return inverse


def segments_in_noise(problem: OutputErrorProblem, point: LikelihoodPoint, index: int) -> list[ResidualSegment]:
    """Residuals and sensitivities of the segments of one flight in units of the noise."""
    n = len(problem.free)
    keep = np.concatenate([np.arange(n), n + problem.free_states])
    pieces = []
    for motion, residual in zip(point.motions[index], point.residuals[index], strict=True):
        assert motion.dy is not None
        J, r = whiten_all(motion.dy[:, :, keep], residual, point.R)
        pieces.append(ResidualSegment(r.reshape(residual.shape), J[:, :n], J[:, n:], np.isfinite(residual)))
    return pieces


# ------------------------------------------------------------------------------------------------ identifiability


def judge_estimates(
    model: Model,
    names: tuple[str, ...],
    values: Array,
    covariance: Array,
    coloured: Array,
    undetermined: NDArray[np.bool_],
    flights: list[FlightData],
    effects: Mapping[str, ParameterEffect] = MappingProxyType({}),
) -> tuple[dict[str, Estimate], tuple[tuple[str, str, float], ...]]:
    """Estimates with bounds and a verdict on each, and the strongly correlated pairs.

    effects: parameter -> the output it moves most; a parameter whose bound moves none by more than RESOLUTION is identifiable.
    """
    std = np.where(undetermined, np.inf, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    std_coloured = np.where(undetermined, np.inf, np.sqrt(np.maximum(np.diag(coloured), 0.0)))
    std_coloured = np.maximum(std, std_coloured)
    rho = correlation_matrix(covariance)
    diagonal = np.diag(covariance)  # zero where the data holds no information at all
    movement = input_movement(model, flights)
    gearing = moving_together(model, flights)
    result = {}
    for i, name in enumerate(names):
        parameter = model.parameter(name)
        size = (float(values[i]), float(std_coloured[i]))
        reason = next((t for c in sorted(inputs_beside(model, name)) if (t := gearing_text(c, gearing))), "")
        reason = reason or _why_not(model, parameter, *size, rho[i], names, i, movement, effects.get(name))
        if not reason and undetermined[i] and diagonal[i] <= 0.0:
            reason = "has no effect on any output in this data"
        if not reason and undetermined[i]:
            partners = ", ".join(n for j, n in enumerate(names) if undetermined[j] and j != i) or "nothing else"
            reason = f"tied exactly to {partners}: only a combination can be told; held at its start value"
        result[name] = Estimate(
            name, float(values[i]), float(std[i]), float(std_coloured[i]), not reason, reason, parameter.unit,
            parameter.reference, parameter.reference_source, parameter.local,
        )  # fmt: skip
    rho[undetermined] = rho[:, undetermined] = 0.0
    return result, correlated_pairs(names, rho)


def correlated_pairs(names: Sequence[str], rho: Array) -> tuple[tuple[str, str, float], ...]:
    """Pairs of names with a correlation of LISTED or more in rho (n, n), the strongest first."""
    pairs = [
        (names[i], names[j], round(float(rho[i, j]), 4))
        for i in range(len(names))
        for j in range(i)
        if abs(rho[i, j]) >= LISTED
    ]
    return tuple(sorted(pairs, key=lambda p: -abs(p[2])))


def _why_not(
    model: Model,
    parameter: Parameter,
    value: float,
    std: float,
    rho: Array,
    names: tuple[str, ...],
    index: int,
    movement: dict[str, tuple[float, float]],
    effect: ParameterEffect | None,
) -> str:
    """Why a parameter is not identifiable, empty where it is. movement: as of `input_movement`; index: of it in `names`."""
    for name in sorted(inputs_beside(model, parameter.name)):
        if name in movement:
            movement_rms, noise = movement[name]
            if movement_rms <= max(STILL * noise, 1e-12):
                unit, factor = _shown_unit(model, name)
                return (
                    f"{name} moved only {movement_rms * factor:.2g} {unit} rms"
                    + (f" against {noise * factor:.2g} {unit} of sensor noise" if noise else "")
                    + ": this data cannot tell; move it on purpose (doublet or 3-2-1-1)"
                )
    if value in (parameter.lower, parameter.upper):
        return f"rests on its limit {value:g}: the data would have it beyond; widen the limit or fix the parameter"
    if not np.isfinite(std):
        return ""
    limit = _useful_bound(parameter, value)
    if std <= limit or (effect is not None and std * effect.share <= RESOLUTION):
        return ""
    collinear = [(abs(rho[j]), names[j]) for j in range(len(names)) if j != index and abs(rho[j]) >= COLLINEAR]
    if collinear:
        r, partner = max(collinear)
        return f"collinear with {partner} (correlation {r:.3f}): this data cannot tell them apart"
    effect_text = "" if effect is None else f", and moves {effect.output} by {std * effect.share:.0%} of its motion"
    return f"bound {std:.2g} is wider than {_limit_text(parameter, limit)}{effect_text}: this data cannot tell"


def _limit_text(parameter: Parameter, limit: float) -> str:
    has_belief = parameter.reference or parameter.reference_std is not None
    return f"{limit:.2g}, too wide to be of use" if has_belief else "the estimate itself"


def _useful_bound(parameter: Parameter, value: float) -> float:
    """The widest bound that still tells something new about a parameter, estimated as `value`."""
    share_of_value = BEYOND_DOUBT * abs(value)
    if parameter.reference:
        return max(USEFUL * abs(parameter.reference), share_of_value)
    if parameter.reference_std is not None:
        return max(parameter.reference_std, share_of_value)
    return np.inf if parameter.reference == 0.0 else abs(value)


def _shown_unit(model: Model, name: str) -> tuple[str, float]:
    """Unit in which a person reads an input, and the factor to it."""
    unit = next((s.unit for s in model.inputs if s.name == name), "")
    return ("deg", RADIAN) if unit == "rad" else (unit, 1.0)


def input_movement(model: Model, flights: list[FlightData]) -> dict[str, tuple[float, float]]:
    """Control -> (rms movement about its median, noise), over all flights."""
    result = {}
    for i, signal in enumerate(model.inputs):
        if not signal.control:
            continue
        squares, count = 0.0, 0
        for flight in flights:
            for segment in flight.segments:
                u = segment.u[:, i]
                squares += float(np.sum((u - np.median(u)) ** 2))
                count += u.size
        noise = max((f.noise.get(signal.name, (0.0, 0.0))[0] for f in flights), default=0.0)
        result[signal.name] = (float(np.sqrt(squares / max(count, 1))), noise)
    return result


def inputs_beside(model: Model, parameter: str) -> frozenset[str]:
    """Inputs that stand in a product with the parameter in some line of the model."""
    inputs = set(model.input_names)
    products = (names for line in model.definitions.values() for names in products_in(line) if parameter in names)
    return frozenset(name for names in products for name in names if name in inputs)
