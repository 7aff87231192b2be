"""The recipe that the rig follows is what the page says, and all of it."""

from tests.cli.docs.blocks import commands_of, files_of
from tests.rig.page import PAGE, booted, card_commands, installing


def test_every_command_of_the_page_is_carried_out_once() -> None:
    followed = [*installing(PAGE), *card_commands(PAGE), *booted(PAGE)]
    assert sorted(followed) == sorted(commands_of(PAGE))
    assert len(followed) > 20


def test_the_restart_comes_between() -> None:
    assert any("systemctl enable" in c for c in installing(PAGE))
    assert booted(PAGE)[0] == "systemctl is-active sideslip"


def test_only_the_file_system_is_made_on_the_card_itself() -> None:
    (command,) = card_commands(PAGE)
    assert command.startswith("sudo mkfs.ext4 ")


def test_files_of_the_page_are_the_systems() -> None:
    assert set(files_of(PAGE)) == {
        "/etc/udev/rules.d/70-i2c-sensors.rules",
        "/etc/systemd/system.conf.d/watchdog.conf",
    }
