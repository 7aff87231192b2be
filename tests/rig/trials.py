"""What the rig does to the computer, one trial after another. Each returns one sentence for the table, and raises RigError where
something is not as it should be.
"""

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tests.rig.bench import Bench
from tests.rig.machine import Machine, RigError
from tests.rig.page import PAGE, booted

RECORDINGS = "/var/lib/sideslip/recordings"
UP_LIMIT_S = 240.0
_IN_REAL_TIME = {"timing", "clock", "attitude"}
"""Checks of which an emulated processor on a busy machine says nothing."""
_NEWEST = f"ls -1t {RECORDINGS} | head -1"
_SCANS = "systemctl show -P StatusText sideslip"


@dataclass(frozen=True, slots=True)
class Power:
    """A computer that is switched on, and what hangs on it."""

    machine: Machine
    bench: Bench

    def wait_for_scans(self, scans: int = 8, limit_s: float = UP_LIMIT_S) -> str:
        """Until the service records and has read the IMU so often since; the session's name."""
        self.machine.wait_until("systemctl -q is-active sideslip", limit_s)
        before, deadline = len(self.bench.readings), time.monotonic() + limit_s
        while len(self.bench.readings) < before + scans:
            if time.monotonic() > deadline:
                raise RigError(f"the service is active, but its scans stand still\n{self.journal()}")
            time.sleep(0.2)
        return self.session()

    def session(self) -> str:
        """The newest session on the card."""
        return self.machine.run(_NEWEST).text.strip()

    def journal(self, lines: int = 15) -> str:
        """The last lines of the service's journal."""
        return self.machine.run(f"journalctl --no-pager -u sideslip -n {lines}").text

    def new_session(self) -> str:
        """End the session in order and begin another."""
        self.machine.run("systemctl restart sideslip")
        return self.wait_for_scans()


def recipe(power: Power) -> str:
    """The page's last section, as it stands."""
    power.wait_for_scans()
    said = {command: power.machine.run(command, check=False).text for command in booted(PAGE)}
    expected = {
        "is-active": "active",
        "FSTYPE": "overlay",
        "SOURCE": "/dev/vdb",
        "i2cdetect": "i2c-tiny-usb",
        "preflight": "all fitted|go  imu",
        "journalctl": "Started sideslip",
    }
    for word, answer in expected.items():
        text = next(t for c, t in said.items() if word in c)
        if not re.search(answer, text):
            raise RigError(f"the page's command with {word} says:\n{text}")
    table = next(t for c, t in said.items() if "preflight" in c)
    verdicts = re.findall(r"^ *(go|caution|no-go)  (\w+) +(.*)", table, flags=re.MULTILINE)
    wrong = {name for verdict, name, text in verdicts if verdict == "no-go" and "ran out of time" not in text}
    if not verdicts or wrong - _IN_REAL_TIME:
        raise RigError(f"preflight:\n{table}")
    power.wait_for_scans()
    well = sum(v == "go" for v, _, _ in verdicts)
    return f"{len(said)} commands of the page do what it says; preflight: {well} of {len(verdicts)} checks go"


def flight(power: Power, wait_s: float = 45.0) -> str:
    """A scenario is flown, the session ended in order."""
    session = power.new_session()
    power.bench.truth.release()
    if not power.bench.truth.flown.wait(wait_s):
        raise RigError(f"the flight was not over after {wait_s:.0f} s")
    power.machine.run("systemctl stop sideslip")
    said = [line for line in power.journal().splitlines() if "scans written" in line]
    power.machine.run("systemctl start sideslip")
    return f"{session}: {said[-1].rpartition(': ')[2] if said else 'no word at the end'}"


def bus_lost(power: Power) -> str:
    """The sensors' adapter is pulled; another one takes its number before it comes back."""
    power.new_session()
    name = "readlink -f /dev/i2c-sensors"
    was = power.machine.run(name).text.strip()
    power.bench.plug("sensors", False)
    time.sleep(6.0)
    gone = power.machine.run(f"test -e {was}", check=False).status != 0
    power.bench.plug("spare", True)
    power.machine.wait_until(f"test -e {was}", 60.0)
    power.bench.plug("sensors", True)
    # Both adapters have the same name for udev: the one that came last has it.
    is_now = power.machine.wait_until(f"[ $({name}) != {was} ] && {name}", 60.0)
    power.wait_for_scans()
    well = power.machine.wait_until(f"{_SCANS} | grep 'all fitted sensors are well'", 90.0)
    power.bench.plug("spare", False)
    if not gone:
        raise RigError(f"{was} was still there 6 s after its plug was pulled: somebody holds it")
    return f"{was} came back as {is_now}; {well}"


def clock_step(power: Power) -> str:
    """The computer's clock jumps by an hour, as when network time comes."""
    session = power.new_session()
    power.machine.run("date -s '+1 hour'")
    time.sleep(5.0)
    power.machine.run("date -s '-2 hours'")
    power.wait_for_scans()
    if power.session() != session:
        raise RigError("the clock's step began a new session")
    power.machine.run("date -s '+1 hour'")
    return f"{session}: scans go on through +1 h and -2 h"


def card_full(power: Power) -> str:
    """Somebody else fills the card, and makes room again."""
    power.new_session()
    power.machine.run("dd if=/dev/zero of=/var/lib/sideslip/filler bs=64k; sync", check=False)
    time.sleep(15.0)
    full = power.machine.run("df --output=avail /var/lib/sideslip | tail -1").text.strip()
    power.machine.run("rm /var/lib/sideslip/filler")
    time.sleep(12.0)
    power.wait_for_scans()
    power.machine.run("systemctl stop sideslip")
    said = [line for line in power.journal().splitlines() if "scans written" in line][-1]
    power.machine.run("systemctl start sideslip")
    if " 0 lost" not in said:
        raise RigError(f"a card that was full for 15 s cost scans: {said}")
    return f"{full} KiB left for 15 s; {said.rpartition(': ')[2]}"


def hung_loop(power: Power) -> str:
    """The scan loop hangs: the watchdog bites and a new session begins."""
    before = power.new_session()
    bites = "journalctl --no-pager -u sideslip | grep -c 'Watchdog timeout'"
    earlier = power.machine.run(bites, check=False).text.strip()
    started = time.monotonic()
    power.machine.run("kill -STOP $(systemctl show -P MainPID sideslip)")
    power.machine.wait_until(f"[ $({bites}) != {earlier} ]", 120.0)
    bite_s = time.monotonic() - started
    power.machine.wait_until(f"[ $({_NEWEST}) != {before} ]", UP_LIMIT_S)
    after = power.wait_for_scans()
    return f"bitten after {bite_s:.0f} s; {after} records {time.monotonic() - started:.0f} s after it hung"


def mute_adapter(power: Power) -> str:
    """The adapter takes messages and answers none for 20 s, as firmware does that waits for a line held low."""
    before = power.new_session()
    power.bench.adapter.mute = True
    time.sleep(20.0)
    power.bench.adapter.mute = False
    after = power.wait_for_scans()
    power.machine.wait_until(f"{_SCANS} | grep 'all fitted sensors are well'", 120.0)
    return "the session went on" if before == after else f"the watchdog began a new session, {after}"


def dead_kernel(power: Power) -> str:
    """The kernel dies: the computer's own watchdog starts it again."""
    power.wait_for_scans()
    before, started = power.session(), time.monotonic()
    power.machine.crash()
    power.machine.wait_for_agent()
    # the service is active, and reads the sensors, before its session is there
    power.machine.wait_until(f"[ $({_NEWEST}) != {before} ]", UP_LIMIT_S)
    after = power.wait_for_scans()
    return f"{after} records {time.monotonic() - started:.0f} s after the kernel died"


def no_room(power: Power) -> str:
    """There is a card that cannot be written, or none: the service runs all the same, and the radio sends."""
    power.machine.wait_until("systemctl -q is-active sideslip", UP_LIMIT_S)
    before = len(power.bench.heard)
    time.sleep(10.0)
    sent = len(power.bench.heard) - before
    if sent < 1000:
        raise RigError(f"the radio sent {sent} bytes in 10 s\n{power.journal()}")
    mount = power.machine.run("findmnt -no FSTYPE,OPTIONS /var/lib/sideslip", check=False).text.strip() or "no card"
    return f"{mount}: the radio sent {sent} bytes in 10 s"


ONE_BOOT: Mapping[str, Callable[[Power], str]] = {
    "recipe followed": recipe,
    "flight": flight,
    "bus pulled, back under a new number": bus_lost,
    "adapter mute for 20 s": mute_adapter,
    "clock steps": clock_step,
    "card full for 15 s": card_full,
    "scan loop hangs": hung_loop,
    "kernel dies": dead_kernel,
}
"""Trials that follow one another on one computer."""
