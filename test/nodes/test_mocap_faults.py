"""Whatever is wrong with the poses of motion capture, the controller survives it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from faulty_recording import LEVEL_TIME, faulty_recording, write_csv

from flatsat_ros.flight.modes import Mode
from flatsat_ros.nodes.ros import interfaces

if TYPE_CHECKING:
    from conftest import Lab

    Column = Any


def test_the_controller_survives_every_fault(lab: Lab, tmp_path: Path, column: Column) -> None:
    commands, telemetry = lab.watch(interfaces.COMMAND, "cf1"), lab.watch(interfaces.TELEMETRY, "cf1")
    status = lab.watch_diagnostics("flatsat_controller: cf1")
    controller = lab.fly("cf1", level_time=LEVEL_TIME, pose_timeout=0.3)
    lab.go_to("cf1", (0.5, 0.0, 1.0), linked=False)
    player = lab.start("mocap_player", file=write_csv(tmp_path / "recording.csv", faulty_recording()))
    player.expected = True
    lab.wait(lambda: player.returncode is not None, "the end of the recording")
    assert player.returncode == 0
    ends = len(status)
    lab.wait(lambda: len(status) > ends and telemetry, "a last report")
    lab.wait(lambda: column(telemetry[-1:], "mode")[0] == Mode.CUT, "the end of the descent")
    # the gap levels the drone, the hole lets it sink until the motors stop, and without a new goal they rest
    modes = [Mode(int(mode)) for mode in column(telemetry, "mode")]
    changes = [mode for before, mode in zip([None, *modes], modes, strict=False) if mode is not before]
    assert changes[-2:] == [Mode.DESCEND, Mode.CUT]
    assert changes.count(Mode.FLY) >= 2
    assert Mode.UNLOCK not in changes
    assert int({pair.key: pair.value for pair in status[-1].values}["poses refused"]) >= 4
    assert controller.stop() == 0
    lab.require_within_limits(commands)
    assert "Traceback" not in controller.output
