"""Aircraft files in Python: the functions behind `aircraft new` and `aircraft check`."""

from pathlib import Path

from estimation.answers.files import FileAnswer


def new_aircraft(name: str, output: str | Path | None = None) -> Path:
    """Write a commented aircraft file, every key explained; gives its path.

    Args:
        name: of the aircraft.
        output: the file; by default NAME.toml.

    Raises:
        AircraftError: a name that is not one word, or a file that exists.

    Example::

        ss.new_aircraft("glider")
    """
    from daq.utilities.outputs import check_file, write_text
    from estimation.aircraft.template import template
    from estimation.errors import AircraftError

    if not name.strip() or not name.isprintable() or any(c in name for c in "/\\"):
        raise AircraftError(f"aircraft name {name!r}: give one word, like glider")
    target = Path(output or f"{name}.toml")
    if target.suffix != ".toml":
        raise AircraftError(f"--output {target}: an aircraft is written as TOML; end the name in .toml")
    if target.exists():
        raise AircraftError(f"{target} is there already; remove it, or give -o another name")
    check_file("--output", target)
    write_text(template(name, str(target)), target)
    return target


def check_aircraft(file: str | Path) -> FileAnswer:
    """What is missing or doubtful in an aircraft file, and the methods for which it is enough.

    Args:
        file: the file, or a built-in name.

    `passed` is False where a value is impossible, or the file is not enough for any model.

    Example::

        print(ss.check_aircraft("glider.toml").summary())
    """
    from estimation.aircraft import load_aircraft
    from estimation.session.aircraft_review import review_aircraft

    aircraft = load_aircraft(str(file))
    notes = review_aircraft(aircraft)
    impossible = any(n.verdict == "fail" and not n.check.startswith("model ") for n in notes)
    usable = any(n.verdict != "fail" for n in notes if n.check.startswith("model "))
    passed = usable and not impossible
    content = {"version": 1, "aircraft": aircraft.name, "ok": passed, "notes": [n.to_json() for n in notes]}
    title = f"aircraft {aircraft.name}{': ' + aircraft.title if aircraft.title else ''}"
    return FileAnswer(content, (title, *(f"  {n.verdict:<5}{n.check}: {n.text}" for n in notes)), passed)
