"""`sideslip doctor`, `help`, `completion`: the installation, help on verbs, and completion for shells."""

import os
import platform
import shutil
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

import click

from daq.utilities.errors import UserError
from daq.utilities.options import json_option
from daq.utilities.outputs import write_json
from daq.utilities.packages import EXTRAS, installed


@click.command(epilog="Example: sideslip doctor --json doctor.json")
@json_option()
def doctor(json_path: Path | None) -> int:
    """What is installed here: versions, extras and what each lacks, cores, serial ports and whether they may be opened."""
    facts = installation()
    if json_path is not None:
        write_json(facts, json_path)
    click.echo(f"sideslip {facts['sideslip']}, Python {facts['python']} on {facts['system']}")
    click.echo(f"{facts['cores']} cores, {facts['free_gb']:.0f} GB free in {Path.cwd()}")
    click.echo(f"C compiler: {facts['compiler'] or 'none; models are integrated without one, more slowly'}")
    for extra, lacking in facts["extras"].items():
        present = [f"{m} {v}" for m in EXTRAS[extra] if (v := facts["versions"].get(m))]
        state = f"lacks {', '.join(lacking)}; pip install 'sideslip[{extra}]'" if lacking else "installed"
        state = state if lacking or not present else f"installed: {', '.join(present)}"
        click.echo(f"  {extra:<12} {state}")
    for port in facts["ports"]:
        click.echo(f"  {port['name']:<12} {port['what']}: {'may be opened' if port['allowed'] else NOT_ALLOWED}")
    if not facts["ports"]:
        click.echo("  no serial port")
    return 0


NOT_ALLOWED = "may not be opened by you; on Linux: sudo usermod -aG dialout $USER, then log in anew"


def installation() -> dict[str, Any]:
    """The content of `doctor --json`: versions, extras, cores, disk, compiler, serial ports."""
    from serial.tools import list_ports

    try:
        sideslip_version = version("sideslip")
    except PackageNotFoundError:
        sideslip_version = "unknown (run from a bare tree)"
    distributions = packages_distributions()
    affinity = getattr(os, "sched_getaffinity", None)  # Linux alone has it
    return {
        "sideslip": sideslip_version,
        "python": platform.python_version(),
        "system": platform.platform(terse=True),
        "executable": sys.executable,
        "cores": len(affinity(0)) if affinity else os.cpu_count() or 1,
        "free_gb": shutil.disk_usage(Path.cwd()).free / 1e9,
        "compiler": shutil.which("gcc") or shutil.which("cc") or "",
        "versions": {m: v for modules in EXTRAS.values() for m in modules if (v := _version_of(m, distributions))},
        "extras": {extra: [m for m in modules if not installed([m])] for extra, modules in EXTRAS.items()},
        "ports": [
            {
                "name": p.device,
                "what": p.description if p.description != "n/a" else "serial port",
                "allowed": os.access(p.device, os.R_OK | os.W_OK) or os.name == "nt",
            }
            for p in list_ports.comports()
        ],
    }


def _version_of(module: str, distributions: Mapping[str, list[str]]) -> str:
    """Version of the package of a module (rerun is from rerun-sdk); empty where it is not installed."""
    for name in (*distributions.get(module, ()), module, module.replace("_", "-")):
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""


@click.command(name="help", epilog="Example: sideslip help estimate")
@click.argument("verb", required=False)
@click.pass_context
def help_(context: click.Context, verb: str | None) -> int:
    """What a VERB does, with its options and an example; without one, the list of verbs."""
    parent = context.parent
    assert parent is not None
    group = parent.command
    assert isinstance(group, click.Group)
    if verb is None:
        click.echo(parent.get_help())
        return 0
    _, command, _ = group.resolve_command(parent, [verb])
    assert command is not None
    with command.make_context(verb, [], parent=parent, resilient_parsing=True) as of_verb:
        click.echo(command.get_help(of_verb))
    return 0


@click.command(epilog='Example: eval "$(sideslip completion bash)"')
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> int:
    """Print the script with which a SHELL completes verbs, options and files: for ~/.bashrc, ~/.zshrc or
    ~/.config/fish/config.fish."""
    from click.shell_completion import get_completion_class

    completion_class = get_completion_class(shell)
    if completion_class is None:
        raise UserError(f"completion: this click knows no shell {shell}")
    root = context.find_root().command
    script = completion_class(root, {}, "sideslip", "_SIDESLIP_COMPLETE")
    # not `script.source()`: its version check starts the shell, which may not be installed
    click.echo(script.source_template % script.source_vars())
    return 0
