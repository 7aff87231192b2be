"""`sideslip check`: data compatibility (flight-path reconstruction) and data quality."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.compatibility.result import Compatibility, Factor
    from groundstation.flight import Flight
    from groundstation.flight.quality.report import Finding

EXAMPLE = (
    "Example: sideslip check ld1.mcap ld2.mcap --factors +K_alpha,dalpha --figure compatibility.png --json check.json"
)


@click.command(epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--factors",
    "factors_text",
    help="Factors to estimate, comma-separated; with a leading + they "
    "are added to the standard ones (dax day daz dp dq dr K_beta dbeta). Also K_alpha dalpha K_V dV dphi dtheta, "
    "x_imu y_imu z_imu, x_vane y_vane z_vane, delays tau_beta tau_alpha tau_V tau_phi tau_theta tau_psi.",
)
@click.option(
    "--aircraft",
    help="Built-in aircraft or an AIRCRAFT.toml: its derivatives predict what the flight can tell"
    "  [default: the one each flight carries or names; without one nothing is predicted].",
)
@click.option("--joint", is_flag=True, help="Also one set of factors shared by all flights.")
@click.option("--keep-held", is_flag=True, help="Take the repeated values of slow and stuck sensors for measurements.")
@click.option("--segments", help="Use only these stretches, each with initial states of its own: 2:12,15:25 [s].")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the results as JSON.")
@click.option(
    "--figure", "figure_path", type=click.Path(path_type=Path), help="Write measured and reconstructed motion."
)
@click.option(
    "--report",
    "report_folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write an HTML report: factors beside published ones, motion, quality.",
)
@click.option(
    "--write", "folder", type=click.Path(path_type=Path, file_okay=False), help="Write corrected flights here."
)
def check(
    flights: tuple[Path, ...],
    factors_text: str | None,
    aircraft: str | None,
    joint: bool,
    keep_held: bool,
    segments: str | None,
    json_path: Path | None,
    figure_path: Path | None,
    report_folder: Path | None,
    folder: Path | None,
) -> int:
    """Check that accelerations, rates, attitude and air data of each FLIGHT tell the same story."""
    from estimation.commands.outputs import check_outputs, write_json
    from estimation.commands.progress import Progress
    from estimation.compatibility.correct import corrected
    from estimation.compatibility.left_out import left_out_findings, measurements
    from estimation.compatibility.reconstruction import compatibility
    from estimation.models.kinematic import STANDARD_FACTORS
    from estimation.report.compatibility_tables import factor_lines, published_lines, write_figure
    from estimation.report.published import is_of
    from estimation.session.flights import select_segments, unique_names
    from groundstation.flight import read_flight, write_flight
    from groundstation.flight.quality.report import quality_report, worst

    factors, known = wanted_factors(factors_text)
    check_outputs(json=json_path, figure=figure_path, report=report_folder, write=folder)
    read = unique_names([select_segments(read_flight(path), segments) for path in flights])
    quality = [
        (
            *quality_report(f),
            *left_out_findings(measurements(f, keep_held=keep_held)[1]),
            *_excitation(f, aircraft),
        )
        for f in read
    ]
    results = []
    several = len(read) > 1  # one flight takes a second or two
    with Progress("checking") as progress:
        for i, f in enumerate(read):
            if several:
                progress(f"checking {f.name}", i / len(read))
            results.append((f.name, compatibility(f, factors, known=known, keep_held=keep_held)))
        if joint and several:
            progress("checking all together")
            results.append(("joint", compatibility(read, factors, known=known, keep_held=keep_held)))
    for line in factor_lines(results):
        click.echo(line)
    if all(is_of(f.provenance.aircraft) for f in read) and set(STANDARD_FACTORS) <= set(factors):
        click.echo()
        for line in published_lines():
            click.echo(line)
    for flight, findings in zip(read, quality, strict=True):
        click.echo(f"\nquality of {flight.name}")
        for finding in findings:
            click.echo(f"  {finding.verdict:<5}{finding.check}: {finding.text}")
    if json_path is not None:
        write_json(_as_json(read, quality, results), json_path)
    if figure_path is not None:
        write_figure([r.flights[0] for (_, r), _ in zip(results, read, strict=False)], figure_path)
        click.echo(f"\nfigure: {figure_path}")
    if report_folder is not None:
        from estimation.report.check_page import write_check_report

        click.echo(f"\nreport: {write_check_report(read, quality, results, report_folder)}")
    if folder is not None:
        for flight, (_, result) in zip(read, results, strict=False):
            target = folder / f"{flight.name}.mcap"
            write_flight(corrected(flight, result), target)
            click.echo(f"corrected flight: {target}")
    failed = any(worst(findings) == "fail" for findings in quality) or not all(r.converged for _, r in results)
    return 1 if failed else 0


def _excitation(flight: "Flight", aircraft: str | None) -> "tuple[Finding, ...]":
    """What the flight can tell of its aircraft's derivatives; one finding that says why not where it names none."""
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.compatibility.excitation import CHECK, excitation_findings, predicted_bounds
    from groundstation.flight.quality.report import Finding

    if aircraft is None and not flight.provenance.aircraft:
        why = "not predicted, for the flight names no aircraft; give one with --aircraft NAME or FILE"
        return (Finding(CHECK, "ok", why),)
    return tuple(excitation_findings(predicted_bounds(flight, aircraft_of([flight], aircraft))))


def wanted_factors(text: str | None) -> tuple[tuple[str, ...], dict[str, float]]:
    """The factors that --factors asks for, the standard ones where it is not given; and those it gives a value."""
    from estimation.errors import EstimationError
    from estimation.models.kinematic import STANDARD_FACTORS

    if text is None:
        return STANDARD_FACTORS, {}
    words = [n.strip() for n in text.strip().removeprefix("+").split(",") if n.strip()]
    if not words:
        raise EstimationError(f"--factors {text!r} names none; write names like K_beta,dbeta or leave the option out")
    known: dict[str, float] = {}
    for word in [w for w in words if "=" in w]:
        name, _, value = word.partition("=")
        try:
            known[name.strip()] = float(value)
        except ValueError:
            raise EstimationError(f"--factors {word}: {value!r} is not a number; write it like x_imu=0.06") from None
        if not math.isfinite(known[name.strip()]):
            raise EstimationError(f"--factors {word}: not a finite number")
    names = tuple(w for w in words if "=" not in w)
    if text.strip().startswith("+") or not names:
        names = (*STANDARD_FACTORS, *names)
    free = tuple(n for n in dict.fromkeys(names) if n not in known)
    if not free:
        raise EstimationError(f"--factors {text}: every factor is given a value, none is left to estimate")
    return free, known


def _as_json(
    flights: "Sequence[Flight]",
    quality: "Sequence[Sequence[Finding]]",
    results: "Sequence[tuple[str, Compatibility]]",
) -> dict[str, object]:
    """As in the interface: one entry a flight, and the joint factors where there are any."""
    from estimation.report.compatibility_tables import fit_of
    from groundstation.flight.contradictions import contradictions

    entries, contradicted = [], []
    for flight, findings, (_, result) in zip(flights, quality, results, strict=False):
        contradicted += [{"flight": flight.name, **c.to_json()} for c in contradictions(flight)]
        entries.append(
            {
                "name": flight.name,
                "converged": result.converged,
                "status": result.text,
                "factors": {n: _factor_json(f) for n, f in result.factors.items()},
                "fit": fit_of(result.flights[0]),
                "notes": list(result.flights[0].notes),
                "quality": [f.to_json() for f in findings],
            }
        )
    data: dict[str, object] = {"version": 1, "flights": entries, "contradictions": contradicted}
    if len(results) > len(flights):
        data["joint"] = {n: _factor_json(f) for n, f in results[-1][1].factors.items()}
    return data


def _factor_json(factor: "Factor") -> dict[str, object]:
    """NaN, where the channel is not measured, is null."""
    told = {"estimate": factor.estimate, "std": factor.std, "std_coloured": factor.std_coloured}
    data: dict[str, object] = {
        **{k: v if math.isfinite(v) else None for k, v in told.items()},
        "unit": factor.unit,
        "identifiable": factor.identifiable,
    }
    return data if factor.identifiable else {**data, "why": factor.why}
