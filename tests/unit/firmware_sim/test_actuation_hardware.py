"""The simulated servo driver, monostable, multiplexer and cockpit, against their data sheets and each other."""

from pathlib import Path

import pytest

from firmware_sim.hardware.cockpit import (
    MONOSTABLE_NS,
    SEL_LOST_NS,
    Cockpit,
    CockpitTable,
    Monostable,
    Multiplexer,
    switch_for,
)
from firmware_sim.hardware.registers.pca9685 import ALLCALL_ADDRESS, AllCall, Pca9685Chip
from firmware_sim.physics.plant import Commands
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.tables import ScenarioError, checked
from firmware_sim.world.scenario import load_scenario

MS = 1_000_000
AWAKE = bytes([0x00, 0x20])


def registers(chip: Pca9685Chip, first: int, count: int) -> list[int]:
    chip.write(bytes([first]), 0)
    return list(chip.read(count, 0))


def pulse(channel: int, steps: int) -> bytes:
    return bytes([6 + 4 * channel, 0, 0, steps & 255, steps >> 8])


def awake(now_ns: int = 0) -> Pca9685Chip:
    chip = Pca9685Chip()
    chip.write(bytes([0xFE, 121]), now_ns)
    chip.write(AWAKE, now_ns)
    return chip


class TestPca9685:
    def test_reset_values(self) -> None:
        chip = Pca9685Chip()
        assert registers(chip, 0x00, 1) == [0x11]
        assert registers(chip, 0x01, 1) == [0x04]
        assert [registers(chip, r, 1)[0] for r in (2, 3, 4, 5)] == [0xE2, 0xE4, 0xE8, 0xE0]
        assert [registers(chip, r, 1)[0] for r in (6, 7, 8, 9)] == [0, 0, 0, 0x10]
        assert registers(chip, 0xFE, 1) == [0x1E]

    def test_without_auto_increment_the_pointer_stays(self) -> None:
        chip = Pca9685Chip()
        chip.write(bytes([6, 1, 2, 3]), 0)
        assert registers(chip, 6, 3) == [3, 3, 3]
        chip.write(AWAKE, 0)
        chip.write(bytes([6, 1, 2, 3]), 0)
        assert registers(chip, 6, 3) == [1, 2, 3]

    def test_prescale_changes_in_sleep_only_and_is_at_least_3(self) -> None:
        chip = Pca9685Chip()
        chip.write(bytes([0xFE, 1]), 0)
        assert registers(chip, 0xFE, 1) == [3]
        chip.write(AWAKE, 0)
        chip.write(bytes([0xFE, 121]), 0)
        assert registers(chip, 0xFE, 1) == [3]

    def test_values_act_at_the_end_of_the_cycle(self) -> None:
        chip = awake()
        chip.write(pulse(0, 205), 0)
        begin, period = 500_000, round(chip.period_ns)
        assert period == pytest.approx(19.99e6, rel=1e-3)
        assert chip.width_us(0, begin - 1) == 0.0
        assert chip.width_us(0, begin + period // 2) == pytest.approx(1000.4)
        chip.write(pulse(0, 410), begin + period // 2)
        assert chip.width_us(0, begin + period - 2) == pytest.approx(1000.4)
        assert chip.width_us(0, begin + period + 2) == pytest.approx(2000.8)

    def test_it_repeats_its_last_pulses_for_ever(self) -> None:
        """The chip has no watchdog."""
        chip = awake()
        chip.write(pulse(5, 307), 0)
        assert chip.width_us(5, 3600 * 1000 * MS) == pytest.approx(1498.2, abs=0.1)

    def test_full_off_wins_over_full_on(self) -> None:
        chip = awake()
        chip.write(bytes([6, 0, 0x10, 0, 0]), 0)
        assert chip.width_us(0, 30 * MS) == pytest.approx(19_988, abs=1)
        chip.write(bytes([6, 0, 0x10, 0, 0x10]), 30 * MS)
        assert chip.width_us(0, 60 * MS) == 0.0

    def test_sleep_stops_and_restart_goes_on(self) -> None:
        chip = awake()
        chip.write(pulse(0, 307), 0)
        chip.write(bytes([0x00, 0x30]), 50 * MS)
        assert chip.width_us(0, 51 * MS) == 0.0
        assert registers(chip, 0x00, 1) == [0xB0]
        chip.write(AWAKE, 60 * MS)
        assert chip.width_us(0, 90 * MS) == 0.0
        chip.write(bytes([0x00, 0xA0]), 90 * MS)
        assert chip.width_us(0, 91 * MS) > 0.0
        assert registers(chip, 0x00, 1) == [0x20]

    def test_writing_a_pulse_clears_restart_too(self) -> None:
        chip = awake()
        chip.write(pulse(0, 307), 0)
        chip.write(bytes([0x00, 0x30]), 50 * MS)
        chip.write(AWAKE, 60 * MS)
        chip.write(pulse(0, 205), 90 * MS)
        assert registers(chip, 0x00, 1) == [0x20]
        assert chip.width_us(0, 120 * MS) == pytest.approx(1000.4)

    def test_all_call_answers_until_it_is_turned_off(self) -> None:
        chip = Pca9685Chip()
        everybody = AllCall(chip)
        assert ALLCALL_ADDRESS == 0x70
        assert everybody.answers(0)
        everybody.write(bytes([0x00, 0x20]), 0)
        assert not everybody.answers(0)

    def test_software_reset_and_power(self) -> None:
        chip = awake()
        chip.general_call(b"\x06", 0)
        assert registers(chip, 0x00, 1) == [0x11]
        chip = awake()
        chip.write(pulse(0, 307), 0)
        chip.set_power(False, 40 * MS)
        assert not chip.answers(40 * MS)
        assert chip.width_us(0, 41 * MS) == 0.0
        chip.set_power(True, 50 * MS)
        assert registers(chip, 0xFE, 1) == [0x1E]
        assert chip.width_us(0, 80 * MS) == 0.0

    def test_oe_and_the_oscillator(self) -> None:
        chip = Pca9685Chip(0.05, lambda time_ns: time_ns < 30 * MS)
        chip.write(bytes([0xFE, 121]), 0)
        chip.write(AWAKE, 0)
        chip.write(pulse(0, 307), 0)
        assert chip.width_us(0, 29 * MS) == pytest.approx(1498.2 / 1.05, abs=0.1)
        assert chip.width_us(0, 30 * MS) == 0.0


class TestGate:
    def test_monostable(self) -> None:
        now = [0]
        mono = Monostable(lambda: now[0])
        assert not mono.up(0)
        mono.beat()
        assert mono.up(MONOSTABLE_NS - 1)
        assert not mono.up(MONOSTABLE_NS)
        now[0] = 40 * MS
        mono.beat()
        assert mono.up(40 * MS + MONOSTABLE_NS - 1)
        now[0] = 50 * MS
        mono.release()
        assert mono.up(49 * MS)
        assert not mono.up(50 * MS)
        now[0] = 60 * MS
        mono.beat()
        assert mono.up(60 * MS)

    def test_multiplexer_goes_by_sel_alone(self) -> None:
        width = {"us": 2000.0}
        gate = {"up": True}
        mux = Multiplexer(lambda time_ns: width["us"], lambda time_ns: gate["up"])
        assert mux.selects_second(1000 * MS)
        width["us"] = 1500.0
        assert not mux.selects_second(1000 * MS)
        width["us"] = 2000.0
        gate["up"] = False
        assert not mux.selects_second(1000 * MS)
        width["us"] = 0.0
        gate["up"] = True
        assert not mux.selects_second(1000 * MS)

    def test_a_dead_host_is_passed_over_within_a_tenth_of_a_second(self) -> None:
        """Whenever in the SEL frame the last beat falls."""
        assert MONOSTABLE_NS + SEL_LOST_NS < 100 * MS
        for offset in range(0, 20 * MS, MS // 2):
            last = 500 * MS + offset
            mono = Monostable(lambda: last)  # noqa: B023
            mono.beat()
            mux = Multiplexer(lambda time_ns: 2000.0, mono.up)
            assert mux.selects_second(last + 20 * MS)
            assert not any(mux.selects_second(last + 100 * MS + k * MS) for k in range(100))

    def test_the_switch_takes_over_within_an_output_period(self) -> None:
        for at in range(500 * MS, 520 * MS, MS // 2):
            mux = Multiplexer(lambda time_ns: 1000.0 if time_ns >= at else 2000.0, lambda time_ns: True)  # noqa: B023
            assert not any(mux.selects_second(at + 20 * MS + k * MS) for k in range(50))


class TestCockpit:
    def cockpit(self, **table: object) -> tuple[Cockpit, list[int]]:
        now = [0]
        mono = Monostable(lambda: now[0])
        made = Cockpit(CockpitTable.model_validate({"switch": [[0.0, "go"]], **table}), mono, 0.0)
        return made, now

    def test_servos_without_pulses_stay_where_they_are(self) -> None:
        cockpit, _ = self.cockpit()
        cockpit.monostable.beat()
        kept = cockpit.route(-0.02, Commands(0.1, 0.1, 0.1, 0.5))
        held = cockpit.route(0.02, Commands(0.3, 0.3, 0.3, 0.6))
        assert (held.left, held.right, held.rudder) == (kept.left, kept.right, kept.rudder)
        assert held.throttle == 0.6  # the throttle is never the driver's

    def test_hands_are_still_while_the_driver_flies_unless_he_takes_over(self) -> None:
        cockpit, _ = self.cockpit(take_over_s=0.05)
        cockpit.monostable.beat()
        assert cockpit.hands_still(0.03)
        assert not cockpit.hands_still(0.05)
        assert not cockpit.hands_still(0.2)

    def test_a_silent_receiver(self) -> None:
        cockpit, _ = self.cockpit(receiver_lost_s=1.0)
        cockpit.route(0.0, Commands(0.0, 0.0, 0.0, 0.5))
        assert cockpit.receiver(500 * MS)[4] == pytest.approx(2000e-6)
        assert cockpit.receiver(1000 * MS)[:5] == (0.0,) * 5

    def test_mistakes_in_a_scenario_are_named(self) -> None:
        with pytest.raises(ScenarioError, match=r"sequencer\.switch"):
            checked(CockpitTable, {"switch": [[0.0, "on"]]}, "mine", "sequencer")
        with pytest.raises(ScenarioError, match=r"raise flight\.duration_s"):
            switch_for(load_scenario("quiet"), 60.0)


def test_a_fault_of_what_is_not_fitted_is_refused(tmp_path: Path) -> None:
    faulty = load_scenario("quiet").altered(faults=[{"kind": "absent", "device": "servo_driver", "start_s": 1.0}])
    with pytest.raises(ScenarioError, match="only with a table"):
        prepare_flight(faulty, tmp_path)
