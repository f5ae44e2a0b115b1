"""One tick of N drones: estimate, reference, law, flight mode, command. Numpy only."""
