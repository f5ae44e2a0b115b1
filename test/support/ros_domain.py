"""A ROS domain that nobody else on this machine has, for processes that must hear no other's nodes."""

from __future__ import annotations

import itertools
import os
import socket

# workers have neighbouring process ids: begin far apart
_domains = itertools.cycle([1 + (37 * os.getpid() + i) % 101 for i in range(101)])


def claim_ros_domain() -> tuple[int, socket.socket]:
    """Take a ROS domain that no other test process of this machine holds, of this run or of another.

    An abstract socket is the claim: the kernel lets one process bind the name, and frees it however that process ends.
    Domains above 101 would use ports that Linux hands out to others; 0 is where a user's own nodes are. The next claim
    looks beyond the last one: in a domain just left, the participants of killed processes live on for a while.
    """
    for domain in itertools.islice(_domains, 101):
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f"\0flatsat_ros test in ROS domain {domain}")
        except OSError:
            claim.close()
        else:
            return domain, claim
    raise RuntimeError("all ROS domains from 1 to 101 are taken by running tests")
