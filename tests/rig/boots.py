"""The computer started many times, with bus, GNSS and radio there, absent, late, or pulled and back: is what was there recorded?

One card for all starts; each ends in order. The orders are those of `tests.studies.boots`, on a booted Linux: USB adapters come
and go by their plugs, udev gives them their names, systemd starts the logger.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.rig.bench import Bench
from tests.rig.judge import mounted, sessions
from tests.rig.machine import SERIAL_ADAPTERS, Image, Machine, RigError, adapter
from tests.rig.page import PAGE, make_card
from tests.rig.trials import UP_LIMIT_S
from tests.studies.boots import SECONDS, Boot, boots, misheld

CARD_MB = 512
PLUGS = {"bus": "sensors", "gnss": "gps", "radio": "radio"}
"""Part -> the adapter that it hangs on."""
DEVICES = {"bus": "/dev/i2c-sensors", "gnss": adapter("gps"), "radio": adapter("radio")}
_TICK_S = 0.1


def start_often(
    image: Image, folder: Path, count: int, seed: int, note: Callable[[str, bool, str, float], None]
) -> None:
    """`count` starts; `note` is called with each."""
    card = make_card(PAGE, folder / "card.img", CARD_MB)
    before: set[str] = set()
    for boot in boots(count, seed):
        began = time.monotonic()
        with Bench(folder) as bench:
            looked_s, output = _start(image, folder, card, bench, boot)
            heard = len(bench.heard)
        with mounted(card) as root:
            new = sorted(sessions(root).keys() - before)
            wrong = [f"{len(new)} sessions"] if len(new) != 1 else []
            for name in new:
                wrong += misheld(boot, root / "recordings" / name, output, heard, DEVICES, looked_s)
        before.update(new)
        note(f"start {boot.number + 1}", not wrong, "; ".join([*wrong, _words(boot)]), time.monotonic() - began)


def _start(image: Image, folder: Path, card: Path, bench: Bench, boot: Boot) -> tuple[float, str]:
    """One start, ended in order; when the service was active on the spans' clock [s], and what it printed."""
    there = {part: boot.there(part, 0.0) for part in PLUGS}
    bench.plug("sensors", there["bus"])
    absent = [line for part, line in PLUGS.items() if line in SERIAL_ADAPTERS and not there[part]]
    with Machine(image, folder, card, lean=True, absent=absent) as machine:
        machine.wait_for_agent()
        begin, looked_s = time.monotonic(), None
        while looked_s is None or time.monotonic() - begin < looked_s + SECONDS:
            at_s = time.monotonic() - begin
            for part in _changed(boot, there, at_s):
                if PLUGS[part] in SERIAL_ADAPTERS:
                    machine.plug(PLUGS[part], there[part])
                else:
                    bench.plug(PLUGS[part], there[part])
            if looked_s is None and machine.run("systemctl -q is-active sideslip", check=False).status == 0:
                looked_s = at_s
            elif looked_s is None and at_s > UP_LIMIT_S:
                raise RigError(f"the service is not active\n{machine.run('journalctl --no-pager -u sideslip').text}")
            time.sleep(_TICK_S)
        machine.run("systemctl stop sideslip; sync")
        return looked_s, machine.run("journalctl --no-pager -u sideslip").text


def _changed(boot: Boot, there: dict[str, bool], at_s: float) -> Iterator[str]:
    for part in PLUGS:
        if boot.there(part, at_s) != there[part]:
            there[part] = not there[part]
            yield part


def _words(boot: Boot) -> str:
    def ways(part: str) -> str:
        spans = ((a, b) for a, b in boot.spans[part])
        return ", ".join(f"{a:.1f} to {'end' if b >= SECONDS else f'{b:.1f} s'}" for a, b in spans) or "never"

    return "; ".join(f"{part} {ways(part)}" for part in PLUGS)
