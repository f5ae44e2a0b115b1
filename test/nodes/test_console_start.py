"""The console while it starts: a page that waited for it sees something at once."""

from __future__ import annotations

import http.client
import time
from contextlib import closing

import pytest
import rclpy
from rclpy.experimental import EventsExecutor

from flatsat_ros.nodes.console import Console

pytestmark = pytest.mark.in_process


def test_a_page_that_connects_before_the_first_callback_is_shown_what_happens() -> None:
    rclpy.init(args=["--ros-args", "-p", "port:=0"])
    console = Console()
    executor = EventsExecutor()
    try:
        with closing(http.client.HTTPConnection(console._server.address.removeprefix("http://"), timeout=20.0)) as page:
            page.request("GET", "/events")
            time.sleep(0.2)  # whatever answers too early has done so
            executor.add_node(console)
            end = time.monotonic() + 20.0
            while console._picture_timer is None:
                assert time.monotonic() < end, "nobody has told the node that a page is there"
                executor.spin_once(timeout_sec=0.05)
            assert page.getresponse().status == 200
    finally:
        console.finish()
        executor.shutdown()
        console.destroy_node()
        rclpy.shutdown()
