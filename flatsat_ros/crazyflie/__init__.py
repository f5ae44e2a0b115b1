"""The vehicle as the radio sees it: profiles, wire units, crazyflies.yaml, link addresses and queues."""
