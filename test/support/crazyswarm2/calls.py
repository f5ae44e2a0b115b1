"""A user's script with the calls of crazyflie_py that no script of crazyswarm2 makes; it prints what they return."""

from __future__ import annotations

from collections.abc import Callable

from crazyflie_py import Crazyswarm

swarm = Crazyswarm()
helper, everybody = swarm.timeHelper, swarm.allcfs
first, second = (everybody.crazyfliesByName[name] for name in ("cf231", "cf5"))
print(f"numbers = {sorted(everybody.crazyfliesById)}")


def stream(seconds: float, send: Callable[[], None]) -> None:
    """Send set-points for some time, 20 a second."""
    end = helper.time() + seconds
    while helper.time() < end and not helper.isShutdown():
        send()
        helper.sleepForRate(20)


first.setGroupMask(4)
print(f"mask = {first.getParam('hlCommander.groupmask')}")
everybody.arm(True)
everybody.takeoff(targetHeight=0.5, duration=2.0)
helper.sleep(2.5)
first.goTo([0.3, 0.0, 0.0], 0.0, 2.0, relative=True)
helper.sleep(2.5)
print(f"position = {[round(value, 1) for value in first.get_position()]}")
print(f"pose = {round(first.get_pose()['position'].z, 1)}, battery = {round(first.get_status()['battery'], 1)}")
stream(3.0, lambda: first.cmdPosition([0.0, 0.5, 0.9], yaw=0.0))
stream(2.0, lambda: first.cmdHover(0.3, 0.0, 0.0, 0.9))
first.notifySetpointsStop()
first.goTo([0.8, 0.5, 0.5], 0.0, 2.0)
helper.sleep(2.5)
first.land(targetHeight=0.02, duration=2.0)
helper.sleep(2.5)
second.emergency()
helper.sleep(1.0)
everybody.takeoff(targetHeight=0.5, duration=2.0)
helper.sleep(2.5)
print(f"heights = {[round(cf.get_position()[2], 1) for cf in (first, second)]}")
everybody.emergency()
helper.sleep(1.0)
