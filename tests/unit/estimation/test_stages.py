"""Stages of an analysis: done once, again when anything that goes into them has changed, or a file of theirs is gone."""

from pathlib import Path

from estimation.analysis.stages import Stages


def test_a_stage_is_done_again_only_when_what_goes_into_it_has_changed(tmp_path: Path) -> None:
    done: list[str] = []
    file = tmp_path / "made"

    def work(name: str) -> dict[str, str]:
        done.append(name)
        file.write_text(name)
        return {"name": name}

    stages = Stages(tmp_path, "1.0")
    first = stages.run("a", {"x": 1}, lambda: work("first"), file)
    assert first.repeated
    again = stages.run("a", {"x": 1}, lambda: work("again"), file)
    assert (again.content, again.repeated, again.key) == ({"name": "first"}, False, first.key)
    assert stages.run("a", {"x": 2}, lambda: work("changed"), file).content == {"name": "changed"}
    assert Stages(tmp_path, "1.1").run("a", {"x": 2}, lambda: work("newer program"), file).repeated
    file.unlink()
    assert Stages(tmp_path, "1.1").run("a", {"x": 2}, lambda: work("file gone"), file).repeated
    stages.path("a.json").write_text("{ cut off")
    assert Stages(tmp_path, "1.1").run("a", {"x": 2}, lambda: work("damaged"), file).repeated
    assert done == ["first", "changed", "newer program", "file gone", "damaged"]
